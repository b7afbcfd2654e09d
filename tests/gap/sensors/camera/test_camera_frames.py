"""Camera frames for the search: sums against plain loops, what effects move, small studies of the library's own."""

from __future__ import annotations

import math
import re
from collections.abc import Callable
from dataclasses import fields, replace
from functools import lru_cache

import numpy as np
import pytest
import torch
from torch import Tensor

from tests.gap.tiny_camera_study import CAMERA, CLEAR, ELECTRONS, HEIGHT, SPLITS, WEATHERS, WIDTH, values_of, view
from torchweather.atmosphere.weather import Fog, Rain
from torchweather.camera.effects.all import EFFECTS
from torchweather.camera.state import CameraState
from torchweather.core.errors import TorchweatherError
from torchweather.evaluation.fit import fit_weather
from torchweather.evaluation.validation.run import validate
from torchweather.gap import Study, find_gap
from torchweather.gap.inference.simulated_distribution import FrameModel
from torchweather.gap.sensors.camera.edges import SHARED_CELLS, lag_name
from torchweather.gap.sensors.camera.frames import CameraFrames
from torchweather.gap.sensors.camera.particles import LEAST_STEP, REACH_STEP, Rendered
from torchweather.gap.sensors.camera.scene import (
    DARKEST,
    DEPTH_CLASSES_M,
    DEPTH_M,
    CameraScene,
    cell_colours,
    in_blocks,
)
from torchweather.gap.sensors.camera.scene_change import with_parts_ignored
from torchweather.gap.sensors.camera.sums import MAP_BLOCKS
from torchweather.gap.sensors.camera.tails import ASIDE, TAILS_SD
from torchweather.gap.statistics.frame_statistics import Pool, Reduced
from torchweather.stages import ParticleVeil
from torchweather.transforms import BayerWeather


@pytest.fixture(scope="module")
def study() -> Study:
    return Study.from_arrays(**values_of())


@pytest.fixture(scope="module")
def model(study: Study) -> CameraFrames:
    return CameraFrames(study)


@pytest.fixture(scope="module")
def models(model: CameraFrames) -> dict[str, CameraFrames]:
    return {
        "fog": model,
        "rain": CameraFrames(Study.from_arrays(**values_of(kind="rain"))),
        "snow": CameraFrames(Study.from_arrays(**values_of(kind="snow"))),
    }


def group(model: CameraFrames, frames: Reduced, statistic: str, axis: str, what: str = "value") -> np.ndarray:
    """Sums ``(F, bins)`` of one group."""
    for one, part in zip(model.layout.binned, model.layout.slices, strict=False):
        if (one.statistic, one.axis) == (statistic, axis):
            return np.asarray(getattr(frames, what)[:, part])
    raise AssertionError(f"no {statistic} along {axis}")


# ---- what a frame is compared with -----------------------------------------------------------------------------------


def test_it_is_a_model_of_frames(model: CameraFrames) -> None:
    checked: FrameModel = model
    assert len(checked.catalogue) == 19
    assert [one.split for one in (*checked.fit, *checked.holdout)] == list(SPLITS)


def test_references_leave_one_clear_frame_out(study: Study, model: CameraFrames) -> None:
    clear = np.stack([frame["bayer"] for frame in study.scenes["s0"].clear])
    for row in range(CLEAR + 1):
        others = [k for k in range(CLEAR) if k != row]
        np.testing.assert_allclose(model.scenes["s0"].reference[row, 0], clear[others].mean(0), atol=1e-6)


def test_a_clear_frame_comes_out_where_its_own_noise_goes_in(model: CameraFrames) -> None:
    scene, row = model.scenes["s0"], torch.arange(CLEAR)
    found = scene.with_noise(scene.reference[row], None, None, row)
    torch.testing.assert_close(found, scene.clear, atol=1e-6, rtol=0)


def test_noise_of_other_light_is_that_of_the_pixels(model: CameraFrames) -> None:
    """Where nothing is left of the scene a frame has the shot noise of the light that is there."""
    scene, row = model.scenes["s0"], torch.arange(CLEAR)
    light = torch.full_like(scene.clear, 0.5)
    found = scene.with_noise(light, torch.zeros_like(light), None, row)
    # The variance of the pixels is taken from medians of few frames: to some ten percent.
    assert float((found - 0.5).std()) == pytest.approx(np.sqrt(0.5 / ELECTRONS), rel=0.2)


@pytest.mark.parametrize("with_medium", [False, True])
@pytest.mark.parametrize("with_particles", [False, True])
def test_noise_solves_the_equation_of_its_docstring(model: CameraFrames, with_medium, with_particles) -> None:
    """``a^2 + m (a + c t)^2 = g + m t^2``, pixel by pixel."""
    scene, row = model.scenes["s0"], torch.tensor([3, 0, 3])
    generator = torch.Generator().manual_seed(4)
    light, left, share = (torch.rand(3, 1, HEIGHT, WIDTH, generator=generator) for _ in range(3))
    light = 0.3 + 0.4 * light
    transmission, covered = left if with_medium else None, share if with_particles else None
    found = scene.with_noise(light, transmission, covered, row).double()
    before, apart = scene.reference[row].double(), (scene.clear - scene.reference[:-1])[row].double()
    constant, growing = scene.noise_variance
    m, g = 1.0 / (CLEAR - 1), (constant + growing * light) / (constant + growing * before)
    t = left.double() if with_medium else torch.ones_like(before)
    c = share.double() if with_particles else torch.zeros_like(before)
    inside = ((found > 0) & (found < 1)) & (apart.abs() > 2e-3)  # of smaller ones rounding is a larger share
    a = ((found - light) / apart)[inside]
    left_side, right_side = a**2 + m * (a + (c * t)[inside]) ** 2, (g + m * t**2)[inside]
    torch.testing.assert_close(left_side, right_side, rtol=1e-3, atol=1e-3)


@lru_cache
def scene_of(clear: int) -> CameraScene:
    """A scene with so many clear frames."""
    return CameraFrames(Study.from_arrays(**values_of(clear=clear, frames=1))).scenes["s0"]


@pytest.mark.parametrize("clear", [2, 4])
@pytest.mark.parametrize(("covered", "transmission"), [(0.0, 1.0), (0.3, 1.0), (0.9, 1.0), (0.4, 0.6)])
def test_noise_under_particles_is_that_of_a_frame_of_its_own(clear, covered, transmission) -> None:
    """What particles hide of the scene they hide of the clear frames' noise, too; what it is compared with has it."""
    scene, row, light = scene_of(clear), torch.arange(clear), view().bayer
    air = (1.0 - transmission) * light  # particles and air as bright as what they hide: only noise is left
    signal = (1.0 - covered) * (transmission * scene.reference[row] + air) + covered * light
    shares = (torch.full_like(signal, share) for share in (transmission, covered))
    departure = scene.with_noise(signal, *shares, row) - (transmission * scene.reference[row] + air)
    expected = (1.0 + transmission**2 / (clear - 1)) * light / ELECTRONS
    chance = (2.0 / light.numel()) ** 0.5  # of a mean of squares of normal values, each frame's counted as one
    assert float(departure.square().mean() / expected.mean()) == pytest.approx(1.0, abs=5.0 * chance)


def test_levels_of_saturation_are_tried_from_the_highest_signal_down() -> None:
    cut = EFFECTS["camera.saturation"](level=0.3)
    levels = CameraFrames(Study.from_arrays(**values_of([cut], frames=1))).sizes["level"]
    assert isinstance(levels, tuple)
    noise = np.sqrt(0.3 / ELECTRONS)
    assert 0.3 < levels[0] < 0.3 + 4.0 * noise
    assert list(levels) == sorted(levels, reverse=True)


def test_catalogue_without_normals_has_no_wet_surface() -> None:
    given = values_of(frames=1)
    del given["scenes"][0]["geometry"]["normal"]
    assert "camera.wet_surface" not in CameraFrames(Study.from_arrays(**given)).catalogue


# ---- sums against plain loops ----------------------------------------------------------------------------------------


def planes(bayer: np.ndarray) -> np.ndarray:
    """Red, mean green and blue of each cell of an RGGB mosaic."""
    assert CAMERA.bayer_pattern == "RGGB"
    found = np.zeros((3, HEIGHT // 2, WIDTH // 2))
    for row in range(HEIGHT // 2):
        for column in range(WIDTH // 2):
            cell = bayer[2 * row : 2 * row + 2, 2 * column : 2 * column + 2]
            found[:, row, column] = cell[0, 0], 0.5 * (cell[0, 1] + cell[1, 0]), cell[1, 1]
    return found


@pytest.fixture(scope="module")
def frame(study: Study) -> np.ndarray:
    return planes(np.asarray(study.conditions[0].frames[0]["bayer"], dtype=np.float64))


@pytest.fixture(scope="module")
def reference(model: CameraFrames) -> np.ndarray:
    return planes(model.scenes["s0"].reference[0, 0].double().numpy())


def test_cells_and_blocks_are_means(study: Study, frame: np.ndarray) -> None:
    bayer = torch.from_numpy(np.array(study.conditions[0].frames[0]["bayer"]))[None, None]
    cells = cell_colours(bayer, "RGGB")
    np.testing.assert_allclose(cells[0], frame, atol=1e-6)
    np.testing.assert_allclose(in_blocks(cells)[0, 1, 0], frame[1, :2, :2].mean(), atol=1e-6)


def test_brightness_is_summed_over_blocks_of_one_depth(
    model: CameraFrames, frame: np.ndarray, reference: np.ndarray
) -> None:
    measured = model.measured(model.fit[0])
    depth_m = view().depth_m[0].numpy()
    weight, value = np.zeros((3, len(DEPTH_M) - 1)), np.zeros((3, len(DEPTH_M) - 1))
    for row in range(HEIGHT // 4):
        for column in range(WIDTH // 4):
            seen = np.minimum(depth_m[4 * row : 4 * row + 4, 4 * column : 4 * column + 4], 1e5)
            known = model.scenes["s0"].bins["off_axis_rad"][row * (WIDTH // 4) + column] >= 0
            if seen.max() > 1.3 * seen.min() or not known:
                continue
            place = np.searchsorted(DEPTH_M, 0.5 * (seen.max() + seen.min()), side="right") - 1
            for colour in range(3):
                own, before = (
                    max(one[colour, 2 * row : 2 * row + 2, 2 * column : 2 * column + 2].mean(), DARKEST)
                    for one in (frame, reference)
                )
                weight[colour, place] += 1
                value[colour, place] += np.log(own / before)
    for colour, name in enumerate(("red", "green", "blue")):
        np.testing.assert_allclose(group(model, measured, f"log_ratio_{name}", "depth_m", "weight")[0], weight[colour])
        np.testing.assert_allclose(
            group(model, measured, f"log_ratio_{name}", "depth_m")[0], value[colour], rtol=1e-4, atol=1e-4
        )


def test_sharpness_is_a_regression_across_edges(model: CameraFrames, frame: np.ndarray, reference: np.ndarray) -> None:
    measured, scene = model.measured(model.fit[0]), model.scenes["s0"]
    for lag, pairs in scene.sharp.items():
        products, squares = np.zeros(len(DEPTH_CLASSES_M) - 1), np.zeros(len(DEPTH_CLASSES_M) - 1)
        for first, second, kind in zip(
            pairs.first.tolist(), pairs.second.tolist(), pairs.depth_class.tolist(), strict=True
        ):
            assert second - first == lag[0] * (WIDTH // 2) + lag[1]
            before = reference[1].flat[second] - reference[1].flat[first]
            products[kind] += before * (frame[1].flat[second] - frame[1].flat[first])
            squares[kind] += before**2
        name = f"edge_contrast_{lag_name(lag)}"
        there = squares > 0
        found = group(model, measured, name, "depth_m")[0] / np.maximum(
            group(model, measured, name, "depth_m", "weight")[0], 1e-9
        )
        np.testing.assert_allclose(found[there], (products / np.maximum(squares, 1e-12))[there], rtol=1e-3, atol=1e-4)


def test_texture_and_tails_of_a_clear_frame(model: CameraFrames) -> None:
    """Without weather what is expected is the mean of the other clear frames."""
    clear, scene = model.clear("s0"), model.scenes["s0"]
    apart = planes(scene.clear[0, 0].double().numpy())[1] - planes(scene.reference[0, 0].double().numpy())[1]
    for lag, pairs in scene.flat.items():
        squares = np.zeros(len(DEPTH_CLASSES_M) - 1)
        for first, second, kind in zip(
            pairs.first.tolist(), pairs.second.tolist(), pairs.depth_class.tolist(), strict=True
        ):
            squares[kind] += (apart.flat[second] - apart.flat[first]) ** 2
        name = f"difference_spread_{lag_name(lag)}"
        np.testing.assert_allclose(
            group(model, clear, name, "depth_m", "square")[0] * SHARED_CELLS, squares, rtol=1e-3, atol=1e-7
        )
    relative = np.zeros_like(apart)
    relative[:, ASIDE:-ASIDE] = apart[:, ASIDE:-ASIDE] - 0.5 * (apart[:, : -2 * ASIDE] + apart[:, 2 * ASIDE :])
    sums = model._clear_sums["s0"]
    relative /= sums.beside.noise.numpy()
    for side, sign in (("bright", 1.0), ("dark", -1.0)):
        counted = np.zeros((2, len(TAILS_SD) - 1))
        for kind in (0, 1):
            values = sign * relative[sums.beside.classes.numpy() == kind]
            counted[kind] = np.histogram(values, TAILS_SD)[0]
        for kind, where in enumerate(("near", "far")):
            found = group(model, clear, f"{side}_share_{where}", "residual_sd")[0] * SHARED_CELLS
            np.testing.assert_allclose(found, counted[kind], atol=1.0)  # one on an edge of a bin


def test_the_map_is_what_parts_are_over_the_model_without_what_all_of_a_depth_are(model: CameraFrames) -> None:
    scene, sums = model.scenes["s0"], model._clear_sums["s0"]
    over = torch.randn(2, len(scene.block_depth_m), generator=torch.Generator().manual_seed(3))
    depth, columns = scene.bins["depth_m"].numpy(), WIDTH // 4
    across = -(-columns // MAP_BLOCKS)
    for frame, found in zip(over.double().numpy(), sums._over_model(over), strict=True):
        cells: dict[int, list[float]] = {}
        for block, value in enumerate(frame):
            if depth[block] >= 0:
                row, column = divmod(block, columns)
                cell = row // MAP_BLOCKS * across + column // MAP_BLOCKS
                cells.setdefault(cell, []).append(value - frame[depth == depth[block]].mean())
        expected = np.zeros(len(found))
        for cell, values in cells.items():
            expected[cell] = 100.0 * np.mean(values)
        np.testing.assert_allclose(found, expected, atol=1e-4)


def test_portions_add_up(model: CameraFrames) -> None:
    whole, parts = model.clear("s0"), model.clear("s0", 16)
    for name in ("weight", "value"):
        summed = getattr(parts, name).reshape(CLEAR, 16, -1).sum(1)
        kinds = model.layout.each(lambda one: one.kind)[: model.layout.bins]
        kept = np.isin(kinds, ("mean", "spread", "share"))
        np.testing.assert_allclose(summed[:, kept], getattr(whole, name)[:, kept], rtol=1e-4, atol=1e-4)


# ---- simulated frames ------------------------------------------------------------------------------------------------

SEEDS = tuple(range(10, 10 + 2 * CLEAR))
MOVED: dict[str, tuple[str, dict[str, float], str]] = {
    "exposure_gain": ("fog", {"factor": 1.02}, "log_ratio_green"),
    "airlight_scale": ("fog", {"blue": 1.02}, "log_ratio_blue"),
    "extinction_scale": ("fog", {"wavelength_exponent": 0.3}, "log_ratio_red"),
    "stray_light": ("fog", {"offset": 0.01}, "log_ratio_green"),
    "aerosol_glow": ("fog", {"share_per_optical_depth": 0.3, "width_px_per_optical_depth": 4.0}, "edge_contrast"),
    "defocus": ("fog", {"radius_px": 1.0}, "edge_contrast"),
    "ego_blur": ("fog", {"length_px": 3.0}, "edge_contrast_0_2_px"),
    "adherent_drops": ("fog", {"cover": 0.05}, "log_ratio_map"),
    "vignetting": ("fog", {"strength": 0.2}, "log_ratio_green"),
    "wind_slant": ("snow", {"angle_rad": 0.8}, "streak_correlation"),
    "wet_surface": ("fog", {"darkening": 0.2}, "log_ratio_green"),
    "sensor_noise": ("fog", {"electrons_per_unit": 3000.0}, "difference_spread_0_2_px"),
    "tone_curve": ("fog", {"gamma": 1.05}, "log_ratio_green"),
    "saturation": ("fog", {"level": 0.3}, "log_ratio_green"),
    "patchy_fog": ("fog", {"log_std": 0.3}, "log_ratio_spread"),
    "height_fog": ("fog", {"scale_height_m": 15.0}, "log_ratio_green"),
    "streak_contrast": ("snow", {"factor": 2.0}, "bright_share"),
    "particle_count": ("snow", {"factor": 2.0}, "bright_share"),
    "rolling_shutter": ("snow", {"row_time_s": 1e-3}, "streak_correlation"),
}


def test_every_effect_of_the_catalogue_is_tried(model: CameraFrames) -> None:
    assert {f"camera.{name}" for name in MOVED} == set(model.catalogue)


# Searched for where they are named alone.
NAMED: dict[str, tuple[str, dict[str, float], str]] = {
    "snow_cover": ("snow", {"depth_mm": 2.0}, "log_ratio_green"),
    "road_spray": ("rain", {"water_g_per_m": 3.0, "distance_m": 15.0}, "log_ratio_map"),
    "refracting_drops": ("rain", {"cover": 0.1}, "edge_contrast"),
}


def test_water_and_snow_are_searched_for_where_they_are_named(study: Study, model: CameraFrames) -> None:
    named = [f"camera.{name}" for name in NAMED]
    asked = CameraFrames(study, named=[*named, "lidar.snow_cover"])
    assert set(asked.catalogue) == {*model.catalogue, *named}
    assert set(named) <= set(asked.forms)  # of several parameters, each of which must pay
    with pytest.raises(ValueError, match="effect must be one of"):
        find_gap(study, effects=["lidar.snow_cover"])


@pytest.mark.long
def test_snow_on_the_ground_is_named_with_its_depth() -> None:
    """Among all effects of cameras; 4 minutes."""
    hidden = EFFECTS["camera.snow_cover"](depth_mm=2.0, uneven=0.5)
    study = Study.from_arrays(**values_of([hidden], kind="snow", seed=4))
    every = [name for name in EFFECTS if name.startswith("camera.")]
    answer = find_gap(study, effects=every).to_dict()
    (found,) = answer["effects"]
    assert (answer["verdict"], found["name"]) == ("named", "camera.snow_cover")
    assert found["parameters"]["depth_mm"] == pytest.approx(2.0, rel=0.1)


@pytest.mark.parametrize("name", [*MOVED, *NAMED])
def test_an_effect_moves_the_statistics_that_it_should(models: dict[str, CameraFrames], name: str) -> None:
    kind, parameters, statistic = (MOVED | NAMED)[name]
    model = models[kind]
    condition = model.fit[1]
    effect = EFFECTS[f"camera.{name}"](**parameters)
    before = Pool(model.layout, model.simulated(condition, [], 0.0, SEEDS))
    after = Pool(model.layout, model.simulated(condition, [effect], 0.0, SEEDS))
    index = np.arange(len(SEEDS))[None]
    least = np.hypot(before.independent_scatter(len(SEEDS)), before.known_to(len(SEEDS)))
    change = (after.vectors(index) - before.vectors(index))[0] / np.where(least > 0, least, np.inf)
    own = model.layout.each(lambda one: one.statistic.startswith(statistic))
    moved = np.abs(change[own & before.enough(len(SEEDS))])
    print(name, moved.max())
    assert moved.max() > 5.0  # standard deviations that noise has at least


@pytest.mark.parametrize("kind", WEATHERS)
def test_frames_do_not_depend_on_how_they_are_asked_for(models: dict[str, CameraFrames], kind: str) -> None:
    model = models[kind]
    condition = model.fit[0]
    together = model.simulated(condition, [], 0.05, SEEDS[:3])
    alone = Reduced.joined([model.simulated(condition, [], 0.05, [seed]) for seed in SEEDS[:3]])
    fresh = CameraFrames(Study.from_arrays(**values_of(kind=kind)))
    anew = Reduced.joined([fresh.simulated(fresh.fit[0], [], 0.05, [seed]) for seed in reversed(SEEDS[:3])][::-1])
    for field in fields(Reduced):
        np.testing.assert_array_equal(getattr(together, field.name), getattr(alone, field.name))
        # Products of several rows may round otherwise than those of one.
        np.testing.assert_allclose(getattr(anew, field.name), getattr(alone, field.name), rtol=1e-3, atol=1e-3)


def test_between_two_rates_particles_are_taken_along_a_line(models: dict[str, CameraFrames]) -> None:
    model = models["rain"]
    condition = model.fit[1]
    step = max(condition.rel_sd, LEAST_STEP)
    means = [
        group(model, model.simulated(condition, [], intensity, SEEDS), "log_ratio_green", "depth_m").sum()
        for intensity in (0.0, 0.5 * step, step)
    ]
    low, middle, high = means
    assert min(low, high) < middle < max(low, high)
    assert middle == pytest.approx(0.5 * (low + high), rel=0.05)


def test_the_colour_of_drops_is_known_to_a_hundredth(models: dict[str, CameraFrames]) -> None:
    """0.06 of a drop's light is the sky's; one standard deviation of that is a hundredth of the mean light."""
    model = models["rain"]
    condition, scene = model.fit[0], model.scenes[model.fit[0].scene]
    (stage,) = model.systematics(condition, {f"airlight green {condition.scene}": 1.0})
    green = cell_colours(scene.clear.mean(0, keepdim=True), CAMERA.bayer_pattern)[0, 1]
    airlight = model.transform(condition).airlight
    assert airlight is not None
    sky = torch.isinf(scene.depth_m[0]).view(HEIGHT // 2, 2, WIDTH // 2, 2).all(3).all(1)
    # The sky above the horizon, as bright as some of it.
    assert float(green[sky].min()) < airlight[1] < float(green[sky].max())
    assert 0.06 * airlight[1] * float(stage.green) == pytest.approx(0.01 * float(green.mean()), rel=0.02)
    snow = models["snow"]
    assert not [name for name in snow.open(snow.fit[0]) if name.startswith("airlight")]


@pytest.mark.parametrize("kind", ["rain", "snow"])
def test_particles_can_be_rendered_about_the_farthest_weather(kind: str) -> None:
    model = CameraFrames(Study.from_arrays(**values_of(kind=kind)))
    condition = model.fit[1]
    farthest = 4.5 * max(condition.rel_sd, LEAST_STEP)  # that a derivative goes to
    exact = model.simulated(condition, [], farthest, SEEDS)
    model.render_near(condition, 3.3 * max(condition.rel_sd, LEAST_STEP))
    between = model.simulated(condition, [], farthest + 1e-9, SEEDS)  # not taken from what is kept
    brightness = [group(model, one, "log_ratio_green", "depth_m").sum() for one in (exact, between)]
    assert brightness[1] == pytest.approx(brightness[0], rel=0.02)


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("particle_reach_m", 200.0 * math.exp(-27 * REACH_STEP)),
        ("particle_reach_m", math.inf),
        ("path_tangent", 0.31),
        ("row_time_s", 2e-5),
    ],
)
def test_what_moves_particles_is_rendered_as_the_stage_does(name: str, value: float) -> None:
    camera = replace(CAMERA, exposure_s=0.02)
    stage = ParticleVeil([Rain(40.0)], camera, ambient=0.4)
    condition = Study.from_arrays(**values_of(kind="rain")).fit[1]
    state = BayerWeather(Rain(40.0), camera, depth=500.0).state_of(torch.full((2, 1, HEIGHT, WIDTH), 0.3))
    moved = state.changed(keep_truth=True, **{name: torch.full((2,), value)})
    noise = stage.draw(moved, seed=torch.tensor([1, 2]), name=stage.default_name)
    exact, other = stage(moved, noise), Rendered(stage, condition)(moved, 0.0, [1, 2])
    torch.testing.assert_close(other.image.particle_mask, exact.image.particle_mask, rtol=2e-3, atol=1e-6)  # float16
    without = stage(moved.changed(**{name: None}), noise).image.particle_mask
    assert torch.allclose(without, exact.image.particle_mask) is (value == math.inf)


def test_particles_that_end_between_two_rendered_depths_are_those_of_both() -> None:
    camera = replace(CAMERA, exposure_s=0.02)
    stage = ParticleVeil([Rain(40.0)], camera, ambient=0.4)
    rendered = Rendered(stage, Study.from_arrays(**values_of(kind="rain")).fit[1])
    state = BayerWeather(Rain(40.0), camera, depth=500.0).state_of(torch.full((2, 1, HEIGHT, WIDTH), 0.3))
    ends = torch.exp(torch.tensor([-27.0, -26.5, -26.0]) * REACH_STEP) * 200.0

    def covered(make: Callable[[CameraState], CameraState], end_m: Tensor) -> Tensor:
        mask = make(state.changed(keep_truth=True, particle_reach_m=end_m.expand(2))).image.particle_mask
        assert mask is not None
        return -torch.log1p(-mask)

    low, middle, high = (covered(lambda one: rendered(one, 0.0, [1, 2]), end_m) for end_m in ends)
    part = float((ends[1] - ends[0]) / (ends[2] - ends[0]))
    torch.testing.assert_close(middle, (1 - part) * low + part * high, rtol=2e-3, atol=1e-5)  # float16
    # Beside the stage itself: as many particles, of which those that one of both has more are seen in part.
    noise = stage.draw(state, seed=torch.tensor([1, 2]), name=stage.default_name)
    exact = covered(lambda one: stage(one, noise), ends[1])
    assert float(middle.mean() / exact.mean()) == pytest.approx(1.0, abs=0.01)
    assert float(middle.var() / exact.var()) == pytest.approx(1.0, abs=0.05)


def test_drops_on_the_window_stay_over_the_frames_of_a_condition(model: CameraFrames) -> None:
    effect = EFFECTS["camera.adherent_drops"](cover=0.1)
    condition, other = model.fit[:2]
    maps = model.simulated(condition, [effect], 0.0, SEEDS[:4]).maps[:, 0]
    elsewhere = model.simulated(other, [effect], 0.0, SEEDS[:4]).maps[:, 0]
    assert np.corrcoef(maps[0], maps[1])[0, 1] > 0.9
    assert abs(np.corrcoef(maps[0], elsewhere[0])[0, 1]) < 0.6


# ---- whole studies ---------------------------------------------------------------------------------------------------


def test_nothing_is_found_where_nothing_is_missing(study: Study) -> None:
    answer = find_gap(study, ignore_parts=["s0:0,32"]).to_dict()
    assert answer["verdict"] == "none"
    assert answer["ignored_parts"] == ["s0:0,32"]


@pytest.mark.long  # beside the study of tests/benchmarks/test_reduced_camera_bench.py, which names an effect too
def test_own_data_recover_an_effect() -> None:
    effect = EFFECTS["camera.exposure_gain"](factor=1.03)
    found = find_gap(Study.from_arrays(**values_of([effect], seed=3))).to_dict()
    assert [one["name"] for one in found["effects"]] == ["camera.exposure_gain"]
    assert found["effects"][0]["parameters"]["factor"] == pytest.approx(1.03, rel=0.01)
    assert found["gap"]["after"] < found["gap"]["before"]


# ---- bad input -------------------------------------------------------------------------------------------------------


def test_a_single_clear_frame_is_refused() -> None:
    with pytest.raises(TorchweatherError, match="one clear frame"):
        find_gap(Study.from_arrays(**values_of(clear=1)))


def test_nothing_held_out_is_refused() -> None:
    given = values_of()
    for one in given["conditions"]:
        one["split"] = "fit"
    with pytest.raises(TorchweatherError, match=r"held out|holdout"):
        find_gap(Study.from_arrays(**given))


def test_frames_of_nan_are_refused() -> None:
    given = values_of()
    given["conditions"][0]["frames"][0]["bayer"][:] = np.nan
    with pytest.raises(TorchweatherError, match=r"(?i)nan|finite"):
        find_gap(Study.from_arrays(**given))


def test_frames_of_another_size_are_refused() -> None:
    given = values_of()
    given["conditions"][0]["frames"][0]["bayer"] = np.zeros((HEIGHT, WIDTH - 2), np.float32)
    with pytest.raises(TorchweatherError, match="bayer"):
        find_gap(Study.from_arrays(**given))


def test_a_scene_without_depth_is_refused() -> None:
    given = values_of()
    del given["scenes"][0]["geometry"]["depth_m"]
    with pytest.raises(TorchweatherError, match="depth_m"):
        find_gap(Study.from_arrays(**given))


@pytest.mark.parametrize("kind", ["fog", "rain"])
def test_a_scene_that_moved_is_named(kind: str) -> None:
    given = values_of(kind=kind)
    for one in given["conditions"]:
        for frame in one["frames"]:
            frame["bayer"] = np.ascontiguousarray(np.roll(frame["bayer"], 14, 1))
    with pytest.raises(TorchweatherError, match="scene changed"):
        find_gap(Study.from_arrays(**given))


def moved_study(mask: tuple[slice, slice] | None) -> Study:
    """The picture of every condition is shifted in its left half."""
    given = values_of(kind="fog")
    half = WIDTH // 2
    for one in given["conditions"]:
        for frame in one["frames"]:
            frame["bayer"] = frame["bayer"].copy()
            frame["bayer"][:, :half] = np.roll(frame["bayer"][:, :half], 14, 1)
    if mask is not None:
        left_out = np.zeros((HEIGHT, WIDTH), np.uint8)
        left_out[mask] = 1
        given["scenes"][0]["geometry"]["mask"] = left_out
    return Study.from_arrays(**given)


def test_the_parts_that_changed_are_named_and_a_mask_answers_them() -> None:
    with pytest.raises(
        TorchweatherError, match=r"scene changed.*32 x 32 px from \(row, column\) \(\d+, \d+\)"
    ) as found:
        CameraFrames(moved_study(None))
    named = re.findall(r"\((\d+), (\d+)\)", str(found.value))
    assert all(int(column) < WIDTH // 2 for _, column in named)
    CameraFrames(moved_study((slice(None), slice(0, WIDTH // 2 + 8))))
    with pytest.raises(TorchweatherError, match="scene changed"):
        CameraFrames(moved_study((slice(None), slice(WIDTH // 2 + 8, WIDTH))))  # what stands still


def test_the_names_in_the_error_answer_it() -> None:
    with pytest.raises(TorchweatherError, match="scene changed") as found:
        CameraFrames(moved_study(None))
    offered = re.search(r"--ignore-parts ([^ ]+:\d+,\d+(?: [^ ]+:\d+,\d+)*), or", str(found.value))
    assert offered is not None
    names = offered[1].split(" ")
    changed = moved_study((slice(0, 1), slice(0, 1)))
    ignored = with_parts_ignored(changed, names)
    (mask,) = (scene.geometry["mask"] for scene in ignored.scenes.values())
    assert mask.sum() == 32 * 32 * len(names) + (0 if f"{next(iter(changed.scenes))}:0,0" in names else 1)
    CameraFrames(with_parts_ignored(moved_study(None), names))
    with pytest.raises(TorchweatherError, match="scene changed"):
        CameraFrames(with_parts_ignored(moved_study(None), names[:1]))
    (before,) = (scene.geometry["mask"] for scene in changed.scenes.values())
    assert before.sum() == 1  # the study that was given stays as it was


def test_validate_and_fit_name_the_same_parts() -> None:
    changed = moved_study(None)
    with pytest.raises(TorchweatherError, match="scene changed") as found:
        CameraFrames(changed)
    offered = re.search(r"--ignore-parts ([^ ]+:\d+,\d+(?: [^ ]+:\d+,\d+)*), or", str(found.value))
    assert offered is not None
    names = offered[1].split(" ")
    validation = validate(changed, names=["psnr"], power=False)
    first = validation.findings[0]
    assert first.level == "error"
    assert first.what.startswith("Scene changed: in weather")
    assert f"--ignore-parts {offered[1]}." in first.advice
    fit = fit_weather(changed, estimators=["contrast"], bootstrap=50)
    assert fit.text().startswith("warning: Scene changed: in weather")
    assert offered[1] in fit.changed[0]
    # Ignored parts are no change, and do not count in scores and fits.
    answered = validate(changed, names=["psnr"], power=False, ignore_parts=names)
    assert not [one for one in answered.findings if "changed" in one.what]
    assert answered.conditions[0].scores[0].measured.mean > validation.conditions[0].scores[0].measured.mean
    again = fit_weather(changed, estimators=["contrast"], bootstrap=50, ignore_parts=names)
    assert again.changed == ()
    assert again.conditions[0].estimates[0].misfit < fit.conditions[0].estimates[0].misfit
    still = Study.from_arrays(**values_of(kind="fog"))
    assert list(still.study_kind.scene_changes(still)) == []
    with pytest.raises(TorchweatherError, match="fit_weather: ignore_parts must be SCENE:ROW,COLUMN"):
        fit_weather(changed, ignore_parts=["s0"])


@pytest.mark.parametrize(
    ("names", "text"),
    [
        (["s0"], "SCENE:ROW,COLUMN"),
        (["elsewhere:0,0"], "elsewhere"),
        (["{scene}:0,8"], "multiples of 32 px"),
        (["{scene}:0,9600"], "multiples of 32 px within the picture"),
    ],
)
def test_other_parts_are_refused(names: list[str], text: str) -> None:
    study = moved_study(None)
    with pytest.raises(TorchweatherError, match=text):
        with_parts_ignored(study, [name.format(scene=next(iter(study.scenes))) for name in names])


def test_effects_of_the_catalogue_are_no_change_of_the_scene() -> None:
    """Drops on the window hide parts of it, a defocus takes edges away, saturation the brightest."""
    effects = [
        EFFECTS["camera.adherent_drops"](cover=0.2),
        EFFECTS["camera.defocus"](radius_px=2.0),
        EFFECTS["camera.saturation"](level=0.5),
    ]
    CameraFrames(Study.from_arrays(**values_of(effects)))


def test_the_exposure_gain_of_a_condition_is_in_simulated_frames_and_what_they_are_compared_with(study: Study) -> None:
    foggy = [replace(one, weather=Fog(mor_m=100.0)) for one in study.conditions]
    plain = replace(study, conditions=tuple(foggy))
    dark = replace(plain, conditions=tuple(replace(one, exposure_gain=0.5) for one in plain.conditions))
    bright, dim = CameraFrames(plain), CameraFrames(dark)
    one, other = bright.fit[0], dim.fit[0]
    levels = [model._of(each).modelled_level for model, each in ((bright, one), (dim, other))]
    torch.testing.assert_close(levels[1], levels[0] + math.log(0.5), rtol=0, atol=2e-3)
    row = torch.tensor([0, 1])
    with torch.no_grad():
        frames = [
            model._through(model._chain(each, ()), each, row, 0.0, [0, 1])
            for model, each in ((bright, one), (dim, other))
        ]
    assert float(frames[1].mean() / frames[0].mean()) == pytest.approx(0.5, rel=5e-3)
