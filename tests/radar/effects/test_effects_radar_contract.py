"""What holds for every effect of radar: identity, place, parameters, saving, batches, gradients, export."""

from __future__ import annotations

import math
from collections.abc import Collection
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
import yaml
from torch import Tensor

from tests.fake_trace import as_exported, traced_shapes
from tests.radar.effects.radar_effect_scene import (
    ACTIVE,
    APPENDING,
    RATE_MM_PER_H,
    SENSOR,
    TARGETS,
    active,
    assert_same_state,
    begin,
    detections,
    known,
    own_noise,
    rain,
    states,
)
from torchweather.atmosphere.weather import Mixture, Rain, Snow
from torchweather.export import draw_feed, to_onnx
from torchweather.export.radar_graph import traceable_radar
from torchweather.recipes import load_recipe, save_recipe
from torchweather.stages import EFFECTS, Chain, PointKind, effect_from_dict, with_effects
from torchweather.transforms import RadarAttenuation

# The names and identities of the catalogue; None where a parameter says only where or how.
CATALOGUE: dict[str, dict[str, float | None]] = {
    "radar.wet_radome": {"loss_db": 0.0, "film_db": 0.0, "film_exponent": None, "drying_min": None},
    "radar.volume_clutter": {"share": 0.0},
    "radar.noise_floor": {"shift_db": 0.0},
    "radar.cfar_shift": {"shift_db": 0.0},
    "radar.path_loss_scale": {"factor": 1.0},
    "radar.multipath": {"amplitude": 0.0, "delay_m": None},
    "radar.doppler_spread": {"std_m_per_s": 0.0},
    "radar.wet_rcs": {"gain_db": 0.0},
    "radar.interference": {"probability": 0.0, "level_db": None},
    "radar.range_migration": {"m_per_frame": 0.0},
    "radar.pattern_tilt": {"angle_rad": 0.0},
    "radar.fluctuation": {"log_std_db": 0.0},
    "radar.detection_limit": {"max_count": math.inf},
    "radar.road_spray": {
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
RADAR = [name for name in EFFECTS if name.startswith("radar.")]
every_effect = pytest.mark.parametrize("name", RADAR)
# A graph learns neither classes nor frame numbers, nor what falls.
NOT_IN_A_GRAPH = {"radar.wet_rcs", "radar.range_migration", "radar.volume_clutter"}


@pytest.fixture(scope="module")
def transform() -> RadarAttenuation:
    return rain()


# ---- declaration -------------------------------------------------------------------------------------------------


def test_the_catalogue_is_complete_and_in_order() -> None:
    assert list(CATALOGUE) == RADAR
    assert {name: {p.name: p.identity for p in EFFECTS[name].arguments} for name in RADAR} == CATALOGUE


@every_effect
def test_an_effect_declares_itself(name: str, transform: RadarAttenuation) -> None:
    effect = EFFECTS[name]
    assert effect.after in transform.chain.stages
    assert effect.default_name == name.removeprefix("radar.")
    words = effect.default_name.split("_")
    assert effect.__name__ == "Radar" + "".join(word.capitalize() for word in words)
    assert effect.title
    assert effect.term
    assert effect.axes
    assert set(effect.confusable_with) <= set(RADAR) - {name}
    assert all(len(by) > 10 for by in effect.confusable_with.values())
    for parameter in effect.arguments:
        assert parameter.low <= parameter.value <= parameter.high
        assert 0 < parameter.scale < math.inf
        assert parameter.unit
    assert bool(effect().at_identity)
    assert not bool(active(name).at_identity)


def test_titles_of_the_cause_tree_are_named_in_the_notice() -> None:
    titles = [EFFECTS[name].percollect for name in RADAR]
    assert sum(title is not None for title in titles) == 7
    assert "RadarRami" in (Path(__file__).parents[3] / "NOTICE").read_text(encoding="utf-8")


def test_effects_of_one_place_stand_by_rank_and_then_in_the_order_of_the_catalogue() -> None:
    """Floors before what is detected by them, echoes after the powers they follow, the list's limit on all of them."""
    effects = [EFFECTS[name]() for name in reversed(RADAR)]
    assert list(rain(effects=effects, clutter=True).chain.stages) == [
        "path_attenuation",
        "noise_floor",
        "interference",
        "cfar_shift",
        "path_loss_scale",
        "wet_radome",
        "doppler_spread",
        "wet_rcs",
        "pattern_tilt",
        "fluctuation",
        "multipath",
        "volume_clutter",
        "road_spray",
        "rain_clutter",
        "radar_detection",
        "detection_limit",
        "to_radar_points",
        "range_migration",
    ]


def test_the_cover_of_the_transform_stands_before_the_effects_and_is_not_given_twice() -> None:
    stages = list(rain(effects=[active("radar.multipath")], radome_loss_db=1.0).chain.stages)
    assert stages[:3] == ["path_attenuation", "wet_radome", "multipath"]
    with pytest.raises(ValueError, match=r"are what radar.wet_radome has as loss_db and film_db, .* Give one"):
        rain(effects=[active("radar.wet_radome")], radome_loss_db=1.0)


def test_a_plain_transform_has_the_stages_it_had() -> None:
    stages = list(rain(radome_film_db=1.0, clutter=True).chain.stages)
    assert stages == ["path_attenuation", "wet_radome", "rain_clutter", "radar_detection", "to_radar_points"]


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
        with pytest.raises(ValueError, match=r"must be one number.*; got \(1, 1, 1\)"):
            effect(**{parameter.name: torch.full((1, 1, 1), parameter.value)})
    with pytest.raises(TypeError, match=f"{effect.__name__}: its parameters are {effect.arguments[0].name} "):
        effect(loss=1.0)


@pytest.mark.parametrize(("name", "missing"), [("wet_rcs", "target_class"), ("range_migration", "frame_number")])
def test_a_list_without_what_an_effect_needs_is_refused(name: str, missing: str) -> None:
    transform = rain(effects=[active(f"radar.{name}")])
    with pytest.raises(ValueError, match=f"expected a state with {missing}; this one has none"):
        transform(detections())
    assert transform(detections(), **known()).shape == detections().shape


def test_what_is_known_is_checked() -> None:
    with pytest.raises(TypeError, match=r"unexpected keyword target_clas; besides points .* target_class, "):
        rain()(detections(), target_clas=torch.zeros(TARGETS))
    with pytest.raises(RuntimeError, match="expand"):
        rain()(detections(), target_class=torch.zeros(TARGETS + 1))


# ---- identity ----------------------------------------------------------------------------------------------------


@every_effect
def test_at_identity_nothing_changes_bit_for_bit(name: str, transform: RadarAttenuation) -> None:
    state = begin(transform)
    chain = with_effects(transform.chain, [EFFECTS[name]()])
    noise = chain.draw(state, seed=3)
    plain, after = states(transform.chain, state, noise), states(chain, state, noise)
    for stage, wanted in plain.items():
        assert_same_state(wanted, after[stage])
    found = rain(effects=[EFFECTS[name]()])(detections(), noise, **known())
    assert isinstance(found, Tensor)
    assert torch.equal(found, transform(detections(), noise))


@every_effect
@pytest.mark.parametrize("clutter", [False, True])
def test_a_sample_at_identity_stays_beside_one_that_is_not(name: str, clutter: bool) -> None:
    transform = rain(clutter=clutter)
    state = begin(transform)
    values: dict[str, Tensor] = {}
    for p in EFFECTS[name].arguments:
        if p.identity is not None:
            given = torch.tensor(ACTIVE[name][p.name])
            values[p.name] = torch.stack([torch.full_like(given, p.value), given, torch.full_like(given, p.value)])
    if name == "radar.range_migration":
        state = begin(transform)  # frame 0 of sample 1 would not drift
        state.scene.frame_number.fill_(4.0)
    chain = rain(clutter=clutter, effects=[active(name, **values)]).chain
    noise = chain.draw(state, seed=3)
    plain, after = states(transform.chain, state, noise), states(chain, state, noise)
    last = "to_radar_points"
    for sample in (0, 2):
        if clutter and name in APPENDING:  # their rows stand before those of the transform's clutter
            count = plain[last].returns.points.shape[1] - TARGETS
            assert torch.equal(
                plain[last].returns.points[sample, TARGETS:], after[last].returns.points[sample, -count:]
            )
            assert torch.equal(
                plain[last].returns.points[sample, :TARGETS], after[last].returns.points[sample, :TARGETS]
            )
            continue
        for stage, wanted in plain.items():
            if stage in after:
                assert_same_state(wanted, after[stage], sample)
    ends = list(after.values())[-1]
    assert ends.returns.points is not None
    assert plain[last].returns.points is not None
    assert ends.returns.points.shape != plain[last].returns.points.shape or not torch.equal(
        ends.returns.points[1], plain[last].returns.points[1]
    )


def test_all_effects_at_identity_change_nothing(transform: RadarAttenuation) -> None:
    state = begin(transform)
    chain = with_effects(transform.chain, [EFFECTS[name]() for name in RADAR])
    noise = chain.draw(state, seed=4)
    assert_same_state(transform.chain(state, noise), chain(state, noise))


@pytest.mark.parametrize("name", APPENDING)
def test_an_effect_built_at_its_identity_does_not_silently_stay_there(name: str, transform: RadarAttenuation) -> None:
    effect = EFFECTS[name]()
    assert effect.variates() == ()
    parameter = effect.arguments[0].name
    state = transform.chain.stages["path_attenuation"](begin(transform), {})
    with pytest.raises(ValueError, match="it was built at its identity and so draws nothing"):
        torch.func.functional_call(effect, {parameter: torch.tensor(0.5)}, (state, {}))
    assert EFFECTS[name](**{parameter: torch.tensor(0.0, requires_grad=True)}).variates()


# ---- batches and seeds -------------------------------------------------------------------------------------------


def spread(name: str, batch: int = 3) -> dict[str, Tensor]:
    """A parameter of its own for each sample, towards the middle of what is allowed."""
    return {
        p.name: torch.stack([torch.tensor(ACTIVE[name][p.name]) * (1.0 - 0.25 * row) for row in range(batch)])
        for p in EFFECTS[name].arguments
    }


@every_effect
def test_a_batch_with_parameters_of_its_own_equals_its_samples(name: str, transform: RadarAttenuation) -> None:
    values, own = spread(name), known()
    whole = rain(effects=[EFFECTS[name](**values)])
    noise = whole.draw(detections(), seed=3)
    together = whole(detections(), noise, **own)
    for row in range(3):
        alone = rain(effects=[EFFECTS[name](**{key: value[row] for key, value in values.items()})])
        one = {key: value[row : row + 1] for key, value in noise.items()}
        given = own | {"frame_number": own["frame_number"][row : row + 1]}
        found = alone(detections()[row : row + 1], one, **given)
        # Fused multiplications differ with the shape: a few roundings of single precision.
        torch.testing.assert_close(found[0], together[row], rtol=3e-6, atol=1e-5)


@every_effect
def test_the_same_seed_gives_the_same_and_another_one_another(name: str) -> None:
    transform = rain(effects=[active(name, **({"probability": 0.5} if name == "radar.interference" else {}))])
    seeds = {seed: transform.draw(detections(), seed=seed) for seed in (3, 8)}
    again = transform.draw(detections(), seed=3)
    once, twice = (transform(detections(), noise, **known()) for noise in (seeds[3], again))
    assert isinstance(once, Tensor)
    assert torch.equal(once, twice)
    effect = transform.chain.stages[name.removeprefix("radar.")]
    draws = own_noise(seeds[3], effect.default_name)
    assert set(draws) == {variate.name for variate in effect.variates()}
    for key, values in draws.items():
        assert not torch.equal(values[0], values[1])
        assert not torch.equal(values, own_noise(seeds[8], effect.default_name)[key])


# ---- gradients ---------------------------------------------------------------------------------------------------

# Parameters on which the outcome depends smoothly, and a step that single precision holds exactly.
SMOOTH = {
    "radar.wet_radome": dict.fromkeys(("loss_db", "film_db", "film_exponent", "drying_min"), 2.0 ** (-7)),
    "radar.volume_clutter": {"share": 2.0**-14},  # small: a detection jumps to the next patch of the view
    "radar.noise_floor": {"shift_db": 2.0**-7},
    "radar.cfar_shift": {"shift_db": 2.0**-7},
    "radar.path_loss_scale": {"factor": 2.0**-7},
    "radar.multipath": {"amplitude": 2.0**-10, "delay_m": 2.0**-10},
    "radar.doppler_spread": {"std_m_per_s": 2.0**-10},
    "radar.wet_rcs": {"gain_db": 2.0**-7},
    "radar.interference": {"level_db": 2.0**-7},
    "radar.range_migration": {"m_per_frame": 2.0**-10},
    "radar.pattern_tilt": {"angle_rad": 2.0**-12},
    "radar.fluctuation": {"log_std_db": 2.0**-7},
}
CASES = [(name, key) for name, keys in SMOOTH.items() for key in keys]


def response(name: str, state: Any, noise: Any, **values: Any) -> Tensor:
    """A smooth number of what the effect alone changes."""
    changed = active(name, **values)(state, noise)
    weight = torch.linspace(0.5, 1.5, TARGETS, dtype=torch.float64)
    total = (weight * changed.returns.gain_db).sum() + (weight[:, None] * changed.scene.points_in).sum()
    for field in (
        "noise_shift_db",
        "threshold_shift_db",
        "attenuation_db_per_km",
        "cover_loss_db",
        "clutter",
        "points",
    ):
        value = changed.field(field)
        if value is not None:
            total = total + value.double().sum()
    return total


@pytest.mark.parametrize(("name", "key"), CASES)
def test_gradients_are_those_of_finite_differences(name: str, key: str, transform: RadarAttenuation) -> None:
    effect, step = active(name), SMOOTH[name][key]
    state = begin(transform, dtype=torch.float64)
    chain = with_effects(transform.chain, [effect])
    noise = {k: v.double() for k, v in chain.draw(state, seed=3).items()}
    before = states(transform.chain, state, noise)[effect.after]
    own = own_noise(noise, effect.default_name)
    value = torch.tensor(ACTIVE[name][key])
    parameter = value.clone().requires_grad_()
    response(name, before, own, **{key: parameter}).backward()
    assert parameter.grad is not None
    ends = [float(response(name, before, own, **{key: value + shift})) for shift in (step, -step)]
    slope = (ends[0] - ends[1]) / (2.0 * step)
    assert slope != 0.0
    assert float(parameter.grad.sum()) == pytest.approx(slope, rel=2e-3)


def test_a_gradient_reaches_the_parameter_through_the_whole_chain() -> None:
    loss = torch.tensor([1.0, 0.0, 2.0], requires_grad=True)
    transform = rain(effects=[EFFECTS["radar.wet_radome"](loss_db=loss)])
    out = transform(detections(), transform.draw(detections(), seed=1))
    out[..., 4].sum().backward()
    assert loss.grad is not None
    # Each of the 35 targets of a list loses as many decibels.
    assert loss.grad.tolist() == [-35.0, -35.0, -35.0]


# ---- saving ------------------------------------------------------------------------------------------------------


@every_effect
def test_an_effect_comes_back_from_its_dictionary_and_its_chain_from_a_file(
    name: str, transform: RadarAttenuation, tmp_path: Path
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


def test_a_transform_takes_effects_and_its_recipe_holds_them(tmp_path: Path) -> None:
    effects = [active("radar.fluctuation"), {"effect": "radar.wet_rcs", "gain_db": [1.0, 2.0]}]
    transform = rain(effects=effects, clutter=True)
    assert {"fluctuation", "wet_rcs"} <= set(transform.chain.stages)
    save_recipe(transform, tmp_path / "rain.yaml", title="rain on wet targets")
    again = load_recipe(tmp_path / "rain.yaml")
    assert isinstance(again, RadarAttenuation)
    noise = transform.draw(detections(), seed=2)
    assert torch.equal(again(detections(), noise, **known()), transform(detections(), noise, **known()))


def test_a_transform_refuses_what_is_no_effect_of_radar() -> None:
    with pytest.raises(ValueError, match=r"Did you mean 'radar.wet_radome'"):
        rain(effects=[{"effect": "radar.wet_radom"}])
    with pytest.raises(ValueError, match="stage must be one of path_attenuation"):
        rain(effects=[EFFECTS["lidar.window_loss"]()])


def test_lost_targets_may_be_left_out_with_all_effects() -> None:
    effects = [active(name) for name in RADAR]
    kept = rain(effects=effects, lost="drop")
    noise = kept.draw(detections(), seed=2)
    lists = kept(detections(), noise, **known())
    result = rain(effects=effects).run(detections(), noise, **known())
    assert isinstance(result.kind, Tensor)
    assert [len(one) for one in lists] == (result.kind != PointKind.LOST).sum(-1).tolist() == [12, 12, 12]


# ---- export ------------------------------------------------------------------------------------------------------


# Reads what it derives of the sensor's frequency, which the exporter knows and a tensor without numbers does not.
READS_A_CONSTANT = {"radar.road_spray"}


def with_all_effects_of_a_graph(without: Collection[str] = ()) -> RadarAttenuation:
    settings: dict[str, dict[str, float]] = {
        "radar.detection_limit": {"max_count": 30.0},
        "radar.interference": {"level_db": 2.0},
        "radar.road_spray": {"water_g_per_m": 40.0},  # through which targets are seen
    }
    effects = [active(name, **settings.get(name, {})) for name in RADAR if name not in {*NOT_IN_A_GRAPH, *without}]
    return rain(effects=effects)


def test_no_effect_looks_at_a_value_while_it_is_traced() -> None:
    """The module that `to_onnx` hands over, with every effect that a graph can hold, on shapes alone."""
    transform = with_all_effects_of_a_graph(without=READS_A_CONSTANT)
    shapes = traced_shapes(traceable_radar(transform, points=23, columns=7))
    rows = shapes[0][1]
    assert rows > 23  # clutter
    assert shapes == [(2, rows, 7), (2, rows), (2, rows), (2, rows)]


@pytest.mark.parametrize("all_effects", [True, False])
def test_the_branches_of_an_export_give_the_same_list(all_effects: bool) -> None:
    transform = with_all_effects_of_a_graph() if all_effects else lower_threshold()
    noise = transform.draw(detections(), seed=5)
    wanted = transform.run(detections(), noise)
    with as_exported():
        found = transform.run(detections(), noise)
    for name in ("points", "kind", "snr_db"):
        torch.testing.assert_close(getattr(found, name), getattr(wanted, name), rtol=0.0, atol=1e-4)


def lower_threshold() -> RadarAttenuation:
    return rain(effects=[EFFECTS["radar.cfar_shift"](shift_db=-4.0)])


@pytest.mark.long
@pytest.mark.filterwarnings("ignore::DeprecationWarning")
def test_effects_are_exported_with_the_chain(tmp_path: Path) -> None:
    """One graph with every effect that a graph can hold, at settings that show; more targets than were traced."""
    onnxruntime = pytest.importorskip("onnxruntime")
    pytest.importorskip("onnxscript")
    transform = with_all_effects_of_a_graph()
    to_onnx(transform, tmp_path / "rain.onnx", points=23, columns=7)
    session = onnxruntime.InferenceSession(tmp_path / "rain.onnx", providers=["CPUExecutionProvider"])
    points = detections()
    feed = draw_feed(session, points=TARGETS, seed=[5, 6, 7])
    intensities = {"rate_mm_per_h": np.full(3, RATE_MM_PER_H, np.float32)}
    got = session.run(["detections", "kind", "snr_db"], {"points": points.numpy(), **intensities, **feed})
    wanted = transform.run(points, {key: torch.from_numpy(value) for key, value in feed.items()})
    for value in (wanted.kind, wanted.points, wanted.snr_db):
        assert isinstance(value, Tensor)
    assert set(wanted.kind.unique().tolist()) == {0, 1, 2}  # type: ignore[union-attr]
    assert np.array_equal(got[1], wanted.kind.numpy())  # type: ignore[union-attr]
    # Powers near -120 dB have float32 steps of 8e-6, and several sums round them.
    np.testing.assert_allclose(got[0], wanted.points.numpy(), atol=1e-4)  # type: ignore[union-attr]
    np.testing.assert_allclose(got[2], wanted.snr_db.numpy(), atol=1e-4)  # type: ignore[union-attr]


@pytest.mark.long
@pytest.mark.filterwarnings("ignore::DeprecationWarning")
def test_a_graph_lists_the_noise_of_a_lower_threshold(tmp_path: Path) -> None:
    pytest.importorskip("onnxscript")
    onnxruntime = pytest.importorskip("onnxruntime")
    transform = lower_threshold()
    to_onnx(transform, tmp_path / "rain.onnx", points=TARGETS + 5, columns=7)
    session = onnxruntime.InferenceSession(tmp_path / "rain.onnx")
    points = detections()
    feed = draw_feed(session, points=TARGETS, seed=[5, 6, 7])
    intensities = {"rate_mm_per_h": np.full(3, RATE_MM_PER_H, np.float32)}
    got = session.run(["detections", "kind"], {"points": points.numpy(), **intensities, **feed})
    wanted = transform.run(points, {key: torch.from_numpy(value) for key, value in feed.items()})
    assert isinstance(wanted.points, Tensor)
    assert isinstance(wanted.kind, Tensor)
    assert int((wanted.kind[:, TARGETS:] == 1).sum()) > 100
    assert np.array_equal(got[1], wanted.kind.numpy())
    np.testing.assert_allclose(got[0], wanted.points.numpy(), atol=1e-3)  # metres of a direction's rounding


@pytest.mark.parametrize("name", sorted(NOT_IN_A_GRAPH))
def test_what_a_graph_cannot_hold_is_refused_and_nothing_is_written(name: str, tmp_path: Path) -> None:
    pytest.importorskip("onnxscript")
    with pytest.raises(Exception, match=r"expected a state with|no graph can hold it"):
        to_onnx(rain(effects=[active(name)]), tmp_path / "rain.onnx", points=23, columns=7)
    assert not list(tmp_path.iterdir())


# ---- devices and weathers ----------------------------------------------------------------------------------------


def test_all_effects_work_in_a_mixture_and_in_double_precision() -> None:
    transform = RadarAttenuation(Mixture(Rain(20.0), Snow(2.0)), SENSOR, effects=[active(name) for name in RADAR])
    result = transform.run(detections().double(), transform.draw(detections(), seed=1), **known())
    assert isinstance(result.points, Tensor)
    assert result.points.dtype == torch.float64
    assert result.points.shape[-2] == 2 * TARGETS + 2 * 256 + 1  # the last is the spray


@pytest.mark.gpu
@pytest.mark.skipif(not torch.cuda.is_available(), reason="needs a CUDA device")
@every_effect
def test_effects_run_on_cuda(name: str) -> None:
    transform = rain(effects=[active(name)])
    noise = transform.draw(detections(), seed=3)
    wanted = transform.run(detections(), noise, **known())
    there = transform.to("cuda")
    cuda = {key: value.cuda() for key, value in noise.items()}
    got = there.run(detections().cuda(), cuda, **{key: value.cuda() for key, value in known().items()})
    assert isinstance(got.points, Tensor)
    assert isinstance(wanted.points, Tensor)
    near = torch.isclose(got.points.cpu(), wanted.points, rtol=1e-4, atol=1e-3).all(-1)
    # Roundings differ between devices, and a comparison at its limit may fall to the other side.
    assert float(near.float().mean()) >= 1.0 - 2e-2
