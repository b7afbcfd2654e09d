"""What holds for every effect: identity, place, parameters, saving, batches, gradients, export."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import pytest
import torch
import yaml
from torch import Tensor

from tests.fake_trace import as_exported, traced_shapes
from tests.lidar.effects.effect_scene import (
    ACTIVE,
    BEAMS,
    active,
    assert_same_state,
    begin,
    cloud,
    directions,
    own_noise,
    rain,
    scan_sensor,
    states,
)
from torchweather.atmosphere.weather import Rain
from torchweather.export import draw_feed, to_onnx
from torchweather.export.lidar_graph import traceable_lidar
from torchweather.recipes import load_recipe, save_recipe
from torchweather.stages import (
    EFFECTS,
    Chain,
    Effect,
    Parameter,
    PointKind,
    effect_from_dict,
    register_effect,
    with_effects,
)
from torchweather.transforms import LidarRain, LidarWeather

# The names and identities of the catalogue; None where a parameter says only where or how.
CATALOGUE: dict[str, dict[str, float | None]] = {
    "lidar.beam_divergence": {"extra_mrad": 0.0},
    "lidar.isolated_return_filter": {"probability": 0.0, "radius_m": None},
    "lidar.threshold_shift": {"shift_db": 0.0},
    "lidar.window_loss": {"loss_db": 0.0},
    "lidar.extinction_scale": {"factor": 1.0},
    "lidar.wet_target": {"share": 0.0},
    "lidar.blind_zone": {"range_m": 0.0, "loss_db": None},
    "lidar.range_noise": {"std_m": 0.0},
    "lidar.range_bias": {"offset_m": 0.0, "walk_m_per_decade": 0.0},
    "lidar.limited_extent": {"extent_m": math.inf},
    "lidar.last_return": {"probability": 0.0},
    "lidar.static_structure": {"azimuth_rad": None, "range_m": None, "width_rad": 0.0},
    "lidar.intensity_compression": {"exponent": 1.0, "saturation": math.inf},
    "lidar.range_stretch": {"m_per_optical_depth": 0.0},
    "lidar.crosstalk": {"probability": 0.0},
    "lidar.particle_backscatter": {"gain_db": 0.0},
    "lidar.sector_loss": {"azimuth_rad": None, "width_rad": None, "loss_db": 0.0},
    "lidar.patchy_weather": {"log_std": 0.0},
    "lidar.spray": {"strength": 0.0, "azimuth_rad": None, "width_rad": None},
    "lidar.ring_gain": {"db_per_ring": 0.0},
    "lidar.particle_density_azimuth": {
        "amplitude": 0.0,
        "azimuth_rad": None,
        "width_rad": None,
        "wind_amplitude": 0.0,
        "wind_azimuth_rad": None,
    },
    "lidar.particle_density_elevation": {
        "amplitude": 0.0,
        "elevation_rad": None,
        "width_rad": None,
        "steepness": None,
    },
    "lidar.particle_sizes": {"factor_1mm": 1.0, "factor_2mm": 1.0, "factor_4mm": 1.0, "factor_8mm": 1.0},
    "lidar.shared_particles": {"share": 0.0, "width_factor": None},
    "lidar.near_response": {"full_m": None, "power": 0.0},
    "lidar.snow_cover": {"depth_mm": 0.0, "reflectivity": None, "uneven": None},
    "lidar.road_spray": {
        "water_g_per_m": 0.0,
        "drop_mm": None,
        "distance_m": None,
        "lateral_m": None,
        "length_m": None,
        "height_m": None,
        "uneven": None,
        "sensor_height_m": None,
    },
}
LIDAR = [name for name in EFFECTS if name.startswith("lidar.")]
every_effect = pytest.mark.parametrize("name", LIDAR)
# They look at the rows of the scan or the beam beside, draw one number for the whole frame, or give each beam a density
# of its own, which is put together for whole clouds alone.
BEAMS_TOGETHER = {
    "lidar.particle_density_azimuth",
    "lidar.particle_density_elevation",
    "lidar.isolated_return_filter",
    "lidar.ring_gain",
    "lidar.patchy_weather",
    "lidar.shared_particles",
    "lidar.snow_cover",
    "lidar.road_spray",
}
# They know the scan's rows; an exported graph takes any number of points and so has none.
NOT_IN_A_GRAPH = {"lidar.isolated_return_filter", "lidar.ring_gain"}


@pytest.fixture(scope="module")
def transform() -> LidarWeather:
    return rain()


# ---- declaration -------------------------------------------------------------------------------------------------


def test_the_catalogue_is_complete_and_in_order() -> None:
    assert list(CATALOGUE) == LIDAR
    found = {name: {p.name: p.identity for p in EFFECTS[name].arguments} for name in LIDAR}
    assert found == CATALOGUE


@every_effect
def test_an_effect_declares_itself(name: str, transform: LidarWeather) -> None:
    effect = EFFECTS[name]
    assert effect.after in transform.chain.stages
    assert effect.default_name == name.removeprefix("lidar.")
    assert effect.title
    assert effect.term
    assert effect.axes
    assert set(effect.confusable_with) <= set(EFFECTS) - {name}
    assert any(parameter.identity is not None for parameter in effect.arguments)
    for parameter in effect.arguments:
        assert parameter.low <= parameter.value <= parameter.high
        assert 0 < parameter.scale < math.inf
        assert parameter.unit
    assert bool(effect().at_identity)
    assert not bool(active(name).at_identity)


def test_what_is_confusable_is_so_from_both_sides_where_the_other_says_so() -> None:
    for name in LIDAR:
        for other, separated_by in EFFECTS[name].confusable_with.items():
            assert len(separated_by) > 10, (name, other)


def test_titles_of_the_cause_tree_are_named_in_the_notice() -> None:
    titles = [EFFECTS[name].percollect for name in LIDAR]
    assert sum(title is not None for title in titles) == 16
    assert "PerCollECT" in (Path(__file__).parents[3] / "NOTICE").read_text(encoding="utf-8")


def test_effects_of_one_place_stand_by_rank_and_then_in_the_order_of_the_catalogue(transform: LidarWeather) -> None:
    effects = [EFFECTS[name]() for name in reversed(LIDAR)]
    assert list(with_effects(transform.chain, effects).stages) == [
        "to_energy",
        "static_structure",
        "patchy_weather",
        "particle_density_azimuth",
        "particle_density_elevation",
        "extinction",
        "beam_divergence",
        "extinction_scale",
        "wet_target",
        "limited_extent",
        "particle_sizes",
        "near_response",
        "snow_cover",
        "particle_returns",
        "shared_particles",
        "threshold_shift",
        "particle_backscatter",
        "spray",
        "road_spray",
        "window_loss",
        "sector_loss",
        "ring_gain",
        "blind_zone",
        "last_return",
        "detection",
        "range_noise",
        "range_bias",
        "intensity_compression",
        "range_stretch",
        "crosstalk",
        "isolated_return_filter",
        "to_points",
    ]


def test_an_effect_is_put_in_once(transform: LidarWeather) -> None:
    with pytest.raises(ValueError, match="'window_loss' is there already"):
        with_effects(transform.chain, [active("lidar.window_loss"), active("lidar.window_loss")])


def test_an_effect_outside_the_catalogue_has_no_place_in_its_order(transform: LidarWeather) -> None:
    class MyLoss(Effect):
        id: ClassVar[str] = "lidar.my_loss"
        arguments: ClassVar[tuple[Parameter, ...]] = ()
        after: ClassVar[str] = "detection"

    with pytest.raises(ValueError, match=r"with_effects: MyLoss not in the catalogue.*use register_effect"):
        with_effects(transform.chain, [MyLoss()])


def test_another_class_cannot_take_an_id_of_the_catalogue() -> None:
    class MyLoss(Effect):
        id: ClassVar[str] = "lidar.window_loss"

    with pytest.raises(ValueError, match=r"'lidar.window_loss' is there already"):
        register_effect(MyLoss)


# ---- parameters --------------------------------------------------------------------------------------------------


@every_effect
def test_parameters_out_of_bounds_and_unknown_ones_are_refused_with_their_unit(name: str) -> None:
    effect = EFFECTS[name]
    for parameter in effect.arguments:
        unit = "" if parameter.unit == "1" else f" {parameter.unit}"
        outside = [math.nan, parameter.low - 1.0, *([] if math.isinf(parameter.high) else [parameter.high + 1.0])]
        for value in outside:
            with pytest.raises(ValueError, match=f"{effect.__name__}: {parameter.name} must lie in .*{unit}; got"):
                effect(**{parameter.name: value})
            with pytest.raises(ValueError, match=f"{effect.__name__}: {parameter.name} must lie in"):
                effect(**{parameter.name: torch.tensor([parameter.value, value])})
        for value in (parameter.low, parameter.high):
            assert float(getattr(effect(**{parameter.name: value}), parameter.name)) == pytest.approx(value)
        with pytest.raises(ValueError, match=r"one number or one for each sample, \(B,\); got \(1, 1\)"):
            effect(**{parameter.name: torch.full((1, 1), parameter.value)})
    with pytest.raises(TypeError, match=f"{effect.__name__}: its parameters are {effect.arguments[0].name} "):
        effect(loss=1.0)


def test_a_state_without_what_an_effect_needs_is_refused(transform: LidarWeather) -> None:
    state = begin(transform).changed(grid=None)
    chain = with_effects(transform.chain, [active("lidar.ring_gain")])
    with pytest.raises(ValueError, match="LidarRingGain: expected a state with grid; this one has none"):
        chain(state, chain.draw(state, seed=1))


def test_a_parameter_says_what_its_default_is() -> None:
    assert Parameter("x", "1", 0.0, 1.0, 0.5, identity=1.0).value == 1.0
    assert Parameter("x", "1", 0.5, 1.0, 0.5).value == 0.5
    assert Parameter("x", "1", 0.0, 1.0, 0.5, default=0.25).value == 0.25


# ---- identity ----------------------------------------------------------------------------------------------------


@every_effect
def test_at_identity_nothing_changes_bit_for_bit(name: str, transform: LidarWeather) -> None:
    state = begin(transform)
    chain = with_effects(transform.chain, [EFFECTS[name]()])
    noise = chain.draw(state, seed=3)
    plain, after = states(transform.chain, state, noise), states(chain, state, noise)
    for stage, wanted in plain.items():
        assert_same_state(wanted, after[stage])
    assert torch.equal(rain(effects=[EFFECTS[name]()])(cloud(), noise), transform(cloud(), noise))


@every_effect
def test_a_sample_at_identity_stays_beside_one_that_is_not(name: str, transform: LidarWeather) -> None:
    state = begin(transform)
    values = {
        p.name: torch.tensor([p.value, ACTIVE[name][p.name], p.value])
        for p in EFFECTS[name].arguments
        if p.identity is not None
    }
    chain = with_effects(transform.chain, [active(name, **values)])
    noise = chain.draw(state, seed=3)
    plain, after = states(transform.chain, state, noise), states(chain, state, noise)
    for stage, wanted in plain.items():
        for sample in (0, 2):
            assert_same_state(wanted, after[stage], sample)
    wanted_points, got = plain["to_points"].returns.points, after["to_points"].returns.points
    assert wanted_points is not None
    assert got is not None
    assert not torch.equal(wanted_points[1], got[1])


def test_all_effects_at_identity_change_nothing(transform: LidarWeather) -> None:
    effects = [EFFECTS[name]() for name in LIDAR]
    state = begin(transform)
    chain = with_effects(transform.chain, effects)
    noise = chain.draw(state, seed=4)
    assert_same_state(transform.chain(state, noise), chain(state, noise))


# ---- batches and seeds -------------------------------------------------------------------------------------------


def spread(name: str, batch: int = 3) -> dict[str, Tensor]:
    """A parameter of its own for each sample, towards the middle of what is allowed."""
    found = {}
    for parameter in EFFECTS[name].arguments:
        value = ACTIVE[name][parameter.name]
        found[parameter.name] = torch.tensor([value * (1.0 - 0.25 * row) for row in range(batch)])
    return found


@every_effect
def test_a_batch_with_parameters_of_its_own_equals_its_samples(name: str, transform: LidarWeather) -> None:
    state, values = begin(transform), spread(name)
    chain = with_effects(transform.chain, [EFFECTS[name](**values)])
    noise = chain.draw(state, seed=3)
    together = chain(state, noise).returns.points
    for row in range(3):
        alone = with_effects(transform.chain, [EFFECTS[name](**{key: float(v[row]) for key, v in values.items()})])
        one = transform.state_of(cloud()[row : row + 1], directions())
        one = one.changed(cos_incidence=state.scene.cos_incidence, up=state.scene.up)
        found = alone(one, {key: value[row : row + 1] for key, value in noise.items()}).returns.points
        # Fused multiplications differ with the shape: a few roundings of single precision.
        torch.testing.assert_close(found[0], together[row], rtol=2e-6, atol=1e-6)


@every_effect
def test_the_same_seed_gives_the_same_and_another_one_another(name: str, transform: LidarWeather) -> None:
    state = begin(transform)
    chain = with_effects(transform.chain, [active(name)])
    once, again, other = (chain(state, chain.draw(state, seed=seed)).returns.points for seed in (3, 3, 8))
    assert torch.equal(once, again)
    assert not torch.equal(once, other)
    draws = own_noise(chain.draw(state, seed=3), EFFECTS[name].default_name)
    assert set(draws) == {variate.name for variate in active(name).variates()}
    for values in draws.values():
        assert not torch.equal(values[0], values[1])


@every_effect
def test_beams_are_alone_where_the_effect_says_so(name: str, transform: LidarWeather) -> None:
    assert EFFECTS[name].each_beam_alone == (name not in BEAMS_TOGETHER)
    if name in BEAMS_TOGETHER:
        return
    state = begin(transform)
    chain = with_effects(transform.chain, [active(name)])
    noise = chain.draw(state, seed=3)
    part = slice(100, 300)
    whole = chain(state, noise).returns.points
    found = chain(state.of_beams(part), {key: value[..., part] for key, value in noise.items()}).returns.points
    torch.testing.assert_close(found, whole[:, part], rtol=2e-6, atol=1e-6)


# ---- gradients ---------------------------------------------------------------------------------------------------

# Parameters on which the outcome depends smoothly, and a step that single precision holds exactly.
SMOOTH = {
    "lidar.beam_divergence": {"extra_mrad": 2.0**-7},
    "lidar.threshold_shift": {"shift_db": 2.0**-7},
    "lidar.window_loss": {"loss_db": 2.0**-7},
    "lidar.extinction_scale": {"factor": 2.0**-7},
    "lidar.wet_target": {"share": 2.0**-7},
    "lidar.range_noise": {"std_m": 2.0**-10},
    "lidar.range_bias": {"offset_m": 2.0**-7, "walk_m_per_decade": 2.0**-7},
    "lidar.limited_extent": {"extent_m": 2.0**-10},
    "lidar.static_structure": {"range_m": 2.0**-12},
    "lidar.intensity_compression": {"exponent": 2.0**-7, "saturation": 2.0**-12},
    "lidar.range_stretch": {"m_per_optical_depth": 2.0**-7},
    "lidar.particle_backscatter": {"gain_db": 2.0**-7},
    "lidar.sector_loss": {"loss_db": 2.0**-7},
    "lidar.patchy_weather": {"log_std": 2.0**-12},
    "lidar.spray": {"strength": 2.0**-12},
    "lidar.ring_gain": {"db_per_ring": 2.0**-7},
    "lidar.particle_density_azimuth": {
        "amplitude": 2.0**-7,
        "azimuth_rad": 2.0**-10,
        "width_rad": 2.0**-10,
        "wind_amplitude": 2.0**-7,
        "wind_azimuth_rad": 2.0**-10,
    },
    "lidar.particle_density_elevation": {
        "amplitude": 2.0**-7,
        "elevation_rad": 2.0**-12,
        "width_rad": 2.0**-12,
        "steepness": 2.0**-7,
    },
    "lidar.near_response": {"full_m": 2.0**-7, "power": 2.0**-7},
    "lidar.particle_sizes": {"factor_1mm": 2.0**-7, "factor_8mm": 2.0**-7},
}
CASES = [(name, key) for name, keys in SMOOTH.items() for key in keys]


def response(name: str, state: Any, noise: Any, **values: Any) -> Tensor:
    """A smooth number of what the effect alone changes."""
    effect = active(name, **values)
    changed = effect(state, noise)
    weight = torch.linspace(0.5, 1.5, BEAMS, dtype=torch.float64)[None, :, None]
    total = (weight * changed.returns.signal).sum() / 1e-4 + (weight * changed.returns.range_m).sum()
    fields = "density_scale threshold_scale extra_divergence_rad extra_near_full_m extra_near_power beam_density"
    for field in (*fields.split(), "size_factors"):
        value = changed.field(field)
        if value is not None:
            each = weight[..., 0] if value.shape[-1] == BEAMS else 1.0
            total = total + (each * value.double()).sum()
    return total


@pytest.mark.parametrize(("name", "key"), CASES)
def test_gradients_are_those_of_finite_differences(name: str, key: str, transform: LidarWeather) -> None:
    effect, step = active(name), SMOOTH[name][key]
    state = begin(transform, dtype=torch.float64)
    chain = with_effects(transform.chain, [effect])
    noise = {k: v.double() for k, v in chain.draw(state, seed=3).items()}
    before = states(transform.chain, state, noise)[effect.after]
    own = own_noise(noise, effect.default_name)
    identity = next(p.identity for p in effect.arguments if p.name == key)
    at = [ACTIVE[name][key]]
    # At the identity too, from inside of the bounds, where the departure is smooth there.
    if identity is not None and math.isfinite(identity) and name != "lidar.spray" and len(effect.arguments) == 1:
        at.append(identity)
    for value in at:
        parameter = torch.tensor(value, requires_grad=True)
        response(name, before, own, **{key: parameter}).backward()
        assert parameter.grad is not None
        below = 0.0 if value == identity else step
        ends = [response(name, before, own, **{key: value + shift}) for shift in (step, -below)]
        slope = float(ends[0] - ends[1]) / (step + below)
        assert slope != 0.0
        # Differences: the second derivative over one step, on one side at the identity.
        assert float(parameter.grad) == pytest.approx(slope, rel=2e-2 if value == identity else 2e-3)


def test_a_gradient_reaches_the_parameter_through_the_whole_chain() -> None:
    loss = torch.tensor([1.0, 0.0, 2.0], requires_grad=True)
    transform = rain(effects=[EFFECTS["lidar.window_loss"](loss_db=loss)])
    out = transform(cloud(), transform.draw(cloud(), seed=1))
    out[..., 3].sum().backward()
    assert loss.grad is not None
    assert (loss.grad < 0).all()


# ---- saving ------------------------------------------------------------------------------------------------------


@every_effect
def test_an_effect_comes_back_from_its_dictionary_and_its_chain_from_a_file(
    name: str, transform: LidarWeather, tmp_path: Path
) -> None:
    state = begin(transform)
    for values in (ACTIVE[name], spread(name)):
        effect = EFFECTS[name](**values)
        again = effect_from_dict(yaml.safe_load(yaml.safe_dump(effect.to_dict())))
        assert type(again) is type(effect)
        assert all(torch.equal(getattr(again, key), getattr(effect, key)) for key in values)
        chain = with_effects(transform.chain, [effect])
        chain.save(tmp_path / "chain.zip")
        loaded = Chain.load(tmp_path / "chain.zip")
        assert loaded.to_dict() == chain.to_dict()
        noise = chain.draw(state, seed=3)
        assert torch.equal(loaded(state, noise).returns.points, chain(state, noise).returns.points)


@pytest.mark.parametrize("name", list(EFFECTS))
def test_a_bound_that_float32_rounds_outwards_comes_back_from_the_dictionary(name: str) -> None:
    """Of every sensor: -pi as float32 lies below -pi."""
    effect = EFFECTS[name]
    for parameter in effect.arguments:
        for bound in (parameter.low, parameter.high):
            for value in (bound, [bound, parameter.value]):
                own = effect(**{parameter.name: value})
                again = effect_from_dict(yaml.safe_load(yaml.safe_dump(own.to_dict())))
                assert again.to_dict() == own.to_dict()
                assert torch.equal(getattr(again, parameter.name), getattr(own, parameter.name))


def test_a_chain_holds_what_fitting_made_of_a_parameter(transform: LidarWeather, tmp_path: Path) -> None:
    chain = with_effects(transform.chain, [active("lidar.window_loss")])
    chain.stages["window_loss"].loss_db.fill_(1.25)
    chain.save(tmp_path / "chain.zip")
    assert float(Chain.load(tmp_path / "chain.zip").stages["window_loss"].loss_db) == 1.25


def test_a_transform_takes_effects_and_its_recipe_holds_them(tmp_path: Path) -> None:
    effects = [active("lidar.crosstalk"), {"effect": "lidar.window_loss", "loss_db": 2.0}]
    transform = LidarRain(Rain(50.0), scan_sensor(), effects=effects)
    assert {"crosstalk", "window_loss"} <= set(transform.chain.stages)
    save_recipe(transform, tmp_path / "rain.yaml", title="rain on a wet window")
    again = load_recipe(tmp_path / "rain.yaml")
    noise = transform.draw(cloud(), seed=2)
    assert torch.equal(again(cloud(), noise), transform(cloud(), noise))


def test_a_transform_refuses_what_is_no_effect() -> None:
    with pytest.raises(
        ValueError, match=r"effect must be one of lidar.beam_divergence.*Did you mean 'lidar.window_loss'"
    ):
        rain(effects=[{"effect": "lidar.window_los"}])
    with pytest.raises(TypeError, match="values must be a mapping; got 3"):
        rain(effects=[3])


def test_the_smooth_expectation_does_not_pass_over_an_effect() -> None:
    with pytest.raises(ValueError, match=r"expected is for the plain chain, without lidar.window_loss"):
        rain(effects=[active("lidar.window_loss")]).expected(cloud())


def test_a_large_batch_in_portions_is_the_same_as_whole(monkeypatch: pytest.MonkeyPatch) -> None:
    transform = rain(effects=[active(name) for name in LIDAR if name not in BEAMS_TOGETHER])
    points, noise = cloud(), None
    noise = transform.draw(points, seed=2)
    whole = transform.run(points, noise, directions=directions())
    monkeypatch.setattr("torchweather.lidar.transform.BEAMS_AT_ONCE", 300)
    parts = transform.run(points, noise, directions=directions())
    for name in ("points", "kind", "transmission"):
        torch.testing.assert_close(getattr(parts, name), getattr(whole, name), rtol=2e-6, atol=1e-6)
    assert torch.equal(parts.empty_beams, whole.empty_beams)


def test_the_reported_transmission_is_that_of_the_effects() -> None:
    points = cloud()
    range_m = points[..., :3].norm(dim=-1)
    transform = rain(effects=[active("lidar.extinction_scale"), active("lidar.limited_extent")])
    result = transform.run(points, transform.draw(points, seed=2))
    wanted = torch.exp(-2.0 * 3.0 * rain().extinction_per_m * range_m.clamp_max(10.0))
    torch.testing.assert_close(result.transmission, wanted, rtol=1e-6, atol=0.0)


# ---- export ------------------------------------------------------------------------------------------------------


def with_all_effects_of_a_graph() -> LidarRain:
    effects = [active(name) for name in LIDAR if name not in NOT_IN_A_GRAPH]
    return LidarRain(Rain(50.0), scan_sensor(), effects=effects, beam_ends="max_range")


def test_no_effect_looks_at_a_value_while_it_is_traced() -> None:
    """The module that `to_onnx` hands over, with every effect that a graph can hold, on shapes alone."""
    shapes = traced_shapes(traceable_lidar(with_all_effects_of_a_graph(), points=100, columns=4, directions=True))
    assert shapes == [(2, 100, 4), (2, 100)]


def test_the_branches_of_an_export_give_the_same_points() -> None:
    transform = with_all_effects_of_a_graph()
    noise = transform.draw(cloud(), seed=5)
    wanted = transform.run(cloud(), noise, directions=directions())
    with as_exported():
        found = transform.run(cloud(), noise, directions=directions())
    assert isinstance(wanted.kind, Tensor)
    assert isinstance(wanted.points, Tensor)
    assert isinstance(found.points, Tensor)
    same = found.kind == wanted.kind
    assert float(same.float().mean()) >= 1.0 - 1e-3  # as the graph below
    assert float(((found.points - wanted.points).abs().amax(-1)[same] <= 1e-3).float().mean()) >= 1.0 - 2e-3


@pytest.mark.long
@pytest.mark.filterwarnings("ignore::DeprecationWarning")
def test_effects_are_exported_with_the_chain(tmp_path: Path) -> None:
    """One graph with every effect that a graph can hold, at settings that show."""
    onnxruntime = pytest.importorskip("onnxruntime")
    pytest.importorskip("onnxscript")
    transform = with_all_effects_of_a_graph()
    to_onnx(transform, tmp_path / "rain.onnx", points=100, directions=True)
    session = onnxruntime.InferenceSession(tmp_path / "rain.onnx", providers=["CPUExecutionProvider"])
    points = cloud()
    feed = draw_feed(session, points=BEAMS, seed=[5, 6, 7])
    intensities = {"rate_mm_per_h": np.full(3, 50.0, np.float32)}
    got = session.run(
        ["cloud", "kind"], {"points": points.numpy(), "directions": directions().numpy(), **intensities, **feed}
    )
    noise = {key: torch.from_numpy(value) for key, value in feed.items()}
    wanted = transform.run(points, noise, directions=directions())
    assert isinstance(wanted.kind, Tensor)
    assert isinstance(wanted.points, Tensor)
    same = got[1] == wanted.kind.numpy()
    # A comparison at its limit may fall to the other side by a rounding: in one beam of a thousand at most.
    assert same.mean() >= 1.0 - 1e-3
    assert len(set(wanted.kind.unique().tolist()) & set(PointKind)) == 3
    off = np.abs(got[0] - wanted.points.numpy()).max(-1)[same]
    # Relative to 100 m; rounding through the tables, as in the tests of the plain chain, plus the beams at a limit.
    assert (off <= 1e-3).mean() >= 1.0 - 2e-3


@pytest.mark.parametrize("name", sorted(NOT_IN_A_GRAPH))
def test_effects_that_know_the_scans_rows_refuse_what_the_exporter_traces(name: str) -> None:
    """The module and the arguments that `to_onnx` hands over, run once, as the exporter does."""
    transform = LidarRain(Rain(50.0), scan_sensor(), effects=[active(name)])
    traced = traceable_lidar(transform, points=100, columns=4, directions=True)
    with pytest.raises(ValueError, match="expected a state with grid"):
        traced.module(*traced.arguments)


@pytest.mark.long  # beside the radar's, whose exporter is the same
def test_an_effect_that_cannot_be_exported_says_so_and_nothing_is_written(tmp_path: Path) -> None:
    pytest.importorskip("onnxscript")
    transform = LidarRain(Rain(50.0), scan_sensor(), effects=[active(sorted(NOT_IN_A_GRAPH)[0])])
    with pytest.raises(Exception, match="expected a state with grid"):
        to_onnx(transform, tmp_path / "rain.onnx", points=100, directions=True)
    assert not list(tmp_path.iterdir())


# ---- devices -----------------------------------------------------------------------------------------------------


@pytest.mark.gpu
@pytest.mark.skipif(not torch.cuda.is_available(), reason="needs a CUDA device")
@every_effect
def test_effects_run_on_cuda(name: str) -> None:
    transform = rain(effects=[active(name)])
    noise = transform.draw(cloud(), seed=3)
    wanted = transform.run(cloud(), noise, directions=directions())
    there = transform.to("cuda")
    got = there.run(cloud().cuda(), {key: value.cuda() for key, value in noise.items()}, directions=directions().cuda())
    assert isinstance(got.points, Tensor)
    assert isinstance(wanted.points, Tensor)
    near = torch.isclose(got.points.cpu(), wanted.points, rtol=1e-4, atol=1e-4).all(-1)
    # Roundings differ between devices, and a comparison at its limit may fall to the other side.
    assert float(near.float().mean()) >= 1.0 - 5e-3
