"""The empirical stage: a measured curve comes out as it went in, and does nothing where it was not measured."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from torch import Tensor

from tests.lidar.effects.effect_scene import (
    BEAMS,
    assert_same_state,
    begin,
    cloud,
    directions,
    own_noise,
    rain,
    scan_sensor,
    states,
)
from torchweather.lidar.effects.empirical import AXES, KINDS, Empirical
from torchweather.stages import Chain, LidarState, PointKind
from torchweather.transforms import LidarWeather

OBJECT, PARTICLE, LOST = (int(kind) for kind in (PointKind.OBJECT, PointKind.PARTICLE, PointKind.LOST))
PLACES: dict[str, Any] = {"places_m": [1.0, 3.0, 9.0], "shares": [0.25, 0.75]}
# One setting of each kind over an axis of the surface, of the beam, of the return.
CURVES: dict[str, dict[str, Any]] = {
    "intensity": {"axis": "range_m", "at": [10.0, 30.0], "value": [-0.2, 0.4], "measured_from": 5, "measured_to": 40},
    "intensity_noise": {"axis": "log_intensity", "at": [-1.0], "value": [0.3], "measured_from": -3, "measured_to": 0},
    "loss": {"axis": "up", "at": [-0.5, 0.5], "value": [-0.4, 0.6], "measured_from": -1, "measured_to": 1},
    "range": {"axis": "elevation_rad", "at": [-0.1, 0.1], "value": [0.1, -0.2], "measured_from": -1, "measured_to": 1},
    "range_noise": {"axis": "margin_db", "at": [3.0], "value": [0.2], "measured_from": 0.0, "measured_to": 20.0},
    "returns": {
        "axis": "azimuth_rad",
        "at": [0.0],
        "value": [0.5],
        "measured_from": -1.0,
        "measured_to": 1.0,
        **PLACES,
    },
}
every_kind = pytest.mark.parametrize("kind", KINDS)


def stage(kind: str, **more: Any) -> Empirical:
    return Empirical(kind, **{**CURVES[kind], **more})


def detected(transform: LidarWeather | None = None) -> LidarState:
    """Reported returns in rain, with what the chain knows of them."""
    transform = transform or rain()
    state = begin(transform)
    return states(transform.chain, state, transform.chain.draw(state, seed=1))["detection"]


def drawn(one: Empirical, state: LidarState, seed: int = 3) -> dict[str, Tensor]:
    return one.draw(state, seed=[seed + number for number in range(state.batch)])


@every_kind
def test_a_curve_of_zero_leaves_every_bit(kind: str) -> None:
    given = CURVES[kind]
    state = detected()
    nothing = stage(kind, value=[0.0] * len(given["value"]))
    assert_same_state(state, nothing(state, drawn(nothing, state)))


@every_kind
def test_outside_the_measured_range_it_does_nothing(kind: str) -> None:
    state, one = detected(), stage(kind)
    after = one(state, drawn(one, state))
    coordinate = one._coordinate(state).expand_as(state.scene.clear_range_m)
    outside = (coordinate < one.measured_from) | (coordinate > one.measured_to)
    if kind in ("loss", "range"):
        assert not outside.any()  # the curve of this kind covers the scene
        assert not torch.equal(after.returns.range_m, state.returns.range_m)
        return
    assert 0.05 < float(outside.float().mean()) < 0.95
    for name in ("range_m", "signal", "kind"):
        assert torch.equal(after.field(name)[outside], state.field(name)[outside]), name
    changed = (after.returns.signal != state.returns.signal) | (after.returns.range_m != state.returns.range_m)
    assert changed[~outside].any()


def test_the_curve_is_straight_between_nodes_and_level_up_to_the_ends() -> None:
    one = Empirical("intensity", "range_m", [10.0, 30.0], [1.0, 3.0], 5.0, 40.0)
    x = torch.tensor([4.9, 5.0, 8.0, 10.0, 20.0, 30.0, 39.0, 40.0, 40.1])
    assert one.curve(x).tolist() == [0.0, 1.0, 1.0, 1.0, 2.0, 3.0, 3.0, 3.0, 0.0]


def test_intensities_of_surfaces_are_multiplied_and_those_of_particles_left() -> None:
    transform = rain()
    one = stage("intensity")
    plain = transform.run(cloud(), transform.draw(cloud(), seed=1), directions=directions())
    transform.chain = transform.chain.insert(one, before="to_points")
    result = transform.run(cloud(), transform.draw(cloud(), seed=1), directions=directions())
    range_m = cloud()[..., :3].norm(dim=-1)
    wanted = torch.from_numpy(np.interp(range_m, [10.0, 30.0], [-0.2, 0.4])).float()
    wanted = torch.where((range_m >= 5) & (range_m <= 40), wanted, 0.0)
    assert isinstance(result.kind, Tensor)
    assert isinstance(result.points, Tensor)
    assert isinstance(plain.points, Tensor)
    assert isinstance(plain.kind, Tensor)
    assert torch.equal(result.kind, plain.kind)
    surface = result.kind == OBJECT
    ratio = (result.points[..., 3] / plain.points[..., 3])[surface].log()
    torch.testing.assert_close(ratio, wanted[surface], rtol=0.0, atol=1e-5)
    assert (plain.kind == PARTICLE).any()
    assert torch.equal(result.points[~surface], plain.points[~surface])


def test_intensities_of_particles_follow_their_own_range() -> None:
    state = detected()
    one = Empirical("intensity", "particle_range_m", [1.0, 2.0], [0.5, 1.0], 0.0, 8.0, of="particle")
    after = one(state, {})
    particle = (state.returns.kind == PARTICLE) & (state.returns.range_m <= 8.0)
    wanted = torch.from_numpy(np.interp(state.returns.range_m[particle], [1.0, 2.0], [0.5, 1.0])).float()
    torch.testing.assert_close(
        (after.returns.signal / state.returns.signal)[particle].log(), wanted, rtol=0.0, atol=1e-5
    )
    assert torch.equal(after.returns.signal[~particle], state.returns.signal[~particle])


def many(kind: int, count: int = 20_000) -> LidarState:
    """Beams that report one thing: a surface at 20 m, or nothing although it stands there."""
    transform = rain()
    given = torch.tensor([20.0, 0.0, 0.0, 0.3]).expand(1, count, 4).contiguous()
    state = transform.state_of(given)
    noise = transform.chain.draw(state, seed=1)
    clear = transform.chain.stages["to_energy"](state, own_noise(noise, "to_energy"))
    kinds = torch.full_like(clear.returns.kind, kind)
    gone = kinds == LOST
    return clear.changed(
        kind=kinds,
        range_m=torch.where(gone, 0.0, clear.returns.range_m),
        signal=torch.where(gone, 0.0, clear.returns.signal),
    )


@pytest.mark.parametrize(("before", "value", "after"), [(OBJECT, 0.3, LOST), (LOST, -0.3, OBJECT)])
def test_so_many_returns_are_lost_or_come_back(before: int, value: float, after: int) -> None:
    state = many(before)
    one = Empirical("loss", "every_beam", [0.0], [value], 0.0, 0.0)
    out = one(state, drawn(one, state))
    changed = out.returns.kind == after
    # 5 standard deviations of 20,000 tosses.
    assert float(changed.float().mean()) == pytest.approx(0.3, abs=5 * math.sqrt(0.3 * 0.7 / 20_000))
    if after == LOST:
        assert (out.returns.range_m[changed] == 0).all()
        assert (out.returns.signal[changed] == 0).all()
    else:
        assert (out.returns.range_m[changed] == 20.0).all()
        assert (out.returns.signal[changed] == state.receiver.threshold).all()
    opposite = Empirical("loss", "every_beam", [0.0], [-value], 0.0, 0.0)
    assert_same_state(state, opposite(state, drawn(opposite, state)))


@pytest.mark.parametrize(("kind", "sd"), [("range_noise", 0.2), ("intensity_noise", 0.3)])
def test_noise_has_the_stated_spread_and_no_mean(kind: str, sd: float) -> None:
    state = many(OBJECT)
    one = Empirical(kind, "every_beam", [0.0], [sd], 0.0, 0.0)
    out = one(state, drawn(one, state))
    apart = (
        out.returns.range_m - state.returns.range_m
        if kind == "range_noise"
        else (out.returns.signal / state.returns.signal).log()
    )
    # 5 standard deviations of the mean and of the spread of 20,000 draws.
    assert float(apart.mean()) == pytest.approx(0.0, abs=5 * sd / math.sqrt(20_000))
    assert float(apart.std()) == pytest.approx(sd, rel=5 / math.sqrt(40_000))


def test_ranges_are_moved_by_the_curve() -> None:
    state = many(OBJECT, 10)
    one = Empirical("range", "range_m", [10.0, 30.0], [0.0, 0.5], 10.0, 30.0)
    torch.testing.assert_close(one(state, {}).returns.range_m, torch.full_like(state.returns.range_m, 20.25))


def test_added_returns_fall_where_the_histogram_says() -> None:
    state = many(OBJECT)
    one = Empirical("returns", "every_beam", [0.0], [0.4], 0.0, 0.0, places_m=[1.0, 3.0, 9.0, 40.0], shares=[1, 2, 5])
    out = one(state, drawn(one, state))
    added = out.returns.kind == PARTICLE
    share = [
        float((added & (out.returns.range_m > a) & (out.returns.range_m <= b)).float().mean())
        for a, b in ((1, 3), (3, 9))
    ]
    # 5 standard deviations; of the rest those behind the surface at 20 m are not added.
    assert share == pytest.approx([0.05, 0.1], abs=5 * math.sqrt(0.1 * 0.9 / 20_000))
    assert float(out.returns.range_m[added].max()) < 20.0
    behind = float((added & (out.returns.range_m > 9)).float().mean())
    assert behind == pytest.approx(0.4 * 5 / 8 * 11 / 31, abs=5 * math.sqrt(0.09 * 0.91 / 20_000))
    assert (out.returns.signal[added] >= state.receiver.threshold).all()
    untouched = ~added
    assert torch.equal(out.returns.range_m[untouched], state.returns.range_m[untouched])


def test_returns_of_empty_beams_need_a_direction() -> None:
    state = detected()
    one = stage("returns", of="empty", axis="every_beam", measured_from=0.0, measured_to=0.0, value=[1.0])
    empty = state.scene.clear_range_m == 0
    out = one(state, drawn(one, state))
    assert (out.returns.kind[..., 0][empty] == PARTICLE).all()
    assert torch.equal(out.returns.kind[~empty], state.returns.kind[~empty])
    unknown = state.changed(empty_direction=None)
    assert_same_state(unknown, one(unknown, drawn(one, unknown)))


@pytest.mark.parametrize("axis", [axis for axis in AXES if axis not in ("particle_range_m", "every_beam")])
def test_each_axis_is_the_quantity_of_its_name(axis: str) -> None:
    state = detected()
    found = (
        Empirical("intensity", axis, [0.0], [0.1], -1.0, 1.0)._coordinate(state).expand_as(state.scene.clear_range_m)
    )
    known = state.scene.clear_range_m > 0
    x, y, z = directions().double().unbind(-1)
    wanted: dict[str, Any] = {
        "range_m": state.scene.clear_range_m,
        "azimuth_rad": torch.atan2(y, x),
        "elevation_rad": torch.asin(z),
        "cos_incidence": state.scene.cos_incidence,
        "up": state.scene.up,
        "margin_db": 10.0 * torch.log10(state.scene.clear_signal / state.receiver.threshold),
        "log_intensity": cloud()[..., 3].log(),
    }
    torch.testing.assert_close(
        found[known].double(), wanted[axis].expand_as(found)[known].double(), rtol=1e-5, atol=1e-5
    )


@pytest.mark.parametrize("axis", ["cos_incidence", "up"])
def test_a_state_without_the_axis_is_refused(axis: str) -> None:
    one = Empirical("intensity", axis, [0.0], [0.1], -1.0, 1.0)
    with pytest.raises(ValueError, match=f"Empirical: expected a state with {axis}, over which the curve was measured"):
        one(detected().changed(cos_incidence=None, up=None), {})


@every_kind
def test_a_chain_with_it_is_saved_and_loads_into_an_equal_one(kind: str, tmp_path: Path) -> None:
    chain = rain().chain.insert(stage(kind), before="to_points")
    chain.save(tmp_path / "chain.zip")
    again = Chain.load(tmp_path / "chain.zip")
    assert again.to_dict() == chain.to_dict()
    state = begin(rain())
    noise = chain.draw(state, seed=4)
    assert_same_state(chain(state, noise), again(state, again.draw(state, seed=4)))
    assert_same_state(
        states(chain, state, noise)["empirical"],
        chain.stages["empirical"](states(chain, state, noise)["detection"], own_noise(noise, "empirical")),
    )


@every_kind
def test_a_batch_is_its_samples(kind: str) -> None:
    chain = rain().chain.insert(stage(kind), before="to_points")
    state = begin(rain())
    noise = chain.draw(state, seed=torch.tensor([7, 8, 9]))
    whole = chain(state, noise)
    for number in range(3):
        one = state.changed(
            **{
                name: state.field(name)[number : number + 1]
                for name in (
                    "points_in",
                    "zero_intensity",
                    "clear_range_m",
                    "clear_signal",
                    "range_m",
                    "signal",
                    "kind",
                    "reach_m",
                    "integral",
                )
            },
        )
        alone = chain(one, chain.draw(one, seed=torch.tensor([7 + number])))
        torch.testing.assert_close(alone.returns.points[0], whole.returns.points[number], rtol=0.0, atol=0.0)


def test_the_curve_can_be_fitted() -> None:
    state = detected()
    one = stage("intensity")
    value = one.value.clone().requires_grad_()
    out = torch.func.functional_call(one, {"value": value}, (state, {}))
    out.returns.signal.sum().backward()
    assert value.grad is not None
    assert (value.grad[1:-1] != 0).all()


@pytest.mark.parametrize(
    ("more", "said"),
    [
        ({"kind": "loudness"}, "kind must be one of intensity, "),
        ({"axis": "height_m"}, "axis must be one of range_m, "),
        ({"of": "empty"}, "of must be one of object, particle; got 'empty'"),
        ({"axis": "particle_range_m"}, "expected of='particle'"),
        ({"at": [30.0, 10.0]}, "at must be finite and rise"),
        ({"at": [1.0, 10.0]}, "at must be finite and rise, within measured_from"),
        ({"at": [10.0, math.inf]}, "at must be finite and rise"),
        ({"at": [10.0]}, "one value for each node, one or more; got 1, 2"),
        ({"value": [0.0, math.inf]}, "value must be finite"),
        ({"value": [0.0, math.nan]}, "value of intensity must lie in"),
        (PLACES, "belong to kind 'returns'"),
        ({**CURVES["loss"], "kind": "loss", "value": [0.0, 1.1]}, r"value of loss must lie in -1..1; got 1.1"),
        ({**CURVES["returns"], "kind": "returns", "value": [-0.1]}, r"value of returns must lie in 0..1"),
        ({**CURVES["returns"], "kind": "returns", "shares": [0.0, 0.0]}, "shares must be 0 or more, and not all 0"),
        ({**CURVES["returns"], "kind": "returns", "shares": [1.0]}, "one more than shares"),
        ({**CURVES["returns"], "kind": "returns", "shares": []}, "which needs both"),
        ({**CURVES["returns"], "kind": "returns", "places_m": [3.0, 1.0, 9.0]}, "places_m must be finite and rise"),
    ],
)
def test_what_makes_no_curve_is_refused(more: dict[str, Any], said: str) -> None:
    with pytest.raises(ValueError, match=f"Empirical: .*{said}"):
        Empirical(**{"kind": "intensity", **CURVES["intensity"], **more})


class InTurn(torch.nn.Module):
    """A factor, losses and added returns in turn, on surfaces that were all reported; plain tensors in and out."""

    def __init__(self) -> None:
        super().__init__()
        kinds = {kind: stage(kind) for kind in ("intensity", "returns")}
        kinds["loss"] = Empirical("loss", "range_m", [10.0, 30.0], [0.5, -0.5], 5.0, 40.0)
        self.chain = Chain(kinds)
        self.sensor = scan_sensor()

    def begin(self, points: Tensor, signal: Tensor) -> LidarState:
        range_m = points[..., :3].norm(dim=-1)
        return LidarState.of(
            points_in=points,
            empty_direction=None,
            clear_range_m=range_m,
            clear_signal=signal,
            range_m=range_m[..., None],
            signal=signal[..., None],
            kind=torch.where(range_m > 0, OBJECT, LOST).to(torch.int8)[..., None],
            reach_m=range_m,
            threshold=points.new_tensor(self.sensor.threshold_per_m2_sr),
            integral=torch.zeros_like(points[..., :1, 0], dtype=torch.bool),
        )

    def forward(self, noise: dict[str, Tensor], points: Tensor, signal: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        out = self.chain(self.begin(points, signal), noise)
        return out.range_m, out.signal, out.kind


@pytest.mark.filterwarnings("ignore::DeprecationWarning", "ignore::FutureWarning")
def test_it_is_exported() -> None:
    pytest.importorskip("onnxruntime")
    pytest.importorskip("onnxscript")
    module, points = InTurn().eval(), cloud(1)
    signal = 1e-3 * (points[..., 3] > 0) * torch.rand(1, BEAMS, generator=torch.Generator().manual_seed(1))
    noise = module.chain.draw(module.begin(points, signal), seed=2)
    given = (noise, points, signal)
    program = torch.onnx.export(module, given, dynamo=True, verbose=False)
    assert program is not None
    for got, wanted in zip(program(*given), module(*given), strict=True):
        # Rounding of exp and of arc tangents; one beam of a hundred may fall to the other side of a comparison.
        near = torch.isclose(torch.as_tensor(got).float(), wanted.float(), rtol=1e-5, atol=1e-5)
        assert float(near.float().mean()) >= 0.99
