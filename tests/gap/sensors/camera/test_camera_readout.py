"""Displaced colours, rows and columns with offsets of their own, pixels that stand out: against plain loops."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
import torch
from numpy.typing import NDArray
from scipy import ndimage

from tests.gap.sensors.camera.test_camera_frames import CLEAR, HEIGHT, WIDTH, group, planes, values_of
from torchweather.gap import Study
from torchweather.gap.sensors.camera.edges import SHARED_CELLS
from torchweather.gap.sensors.camera.frames import CameraFrames
from torchweather.gap.sensors.camera.pixels import LONE_SD, LONE_SHARE, LonePixels, lone_pixels
from torchweather.gap.sensors.camera.shift import Shifts, gradients, shift_name
from torchweather.gap.sensors.camera.tails import ASIDE, FAR_LAG, HIGHEST
from torchweather.gap.statistics.frame_statistics import Pool

Floats = NDArray[np.float64]
COLOURS = ("red", "green", "blue")


@pytest.fixture(scope="module")
def model() -> CameraFrames:
    return CameraFrames(Study.from_arrays(**values_of()))


# ---- displacement ----------------------------------------------------------------------------------------------------


def smooth(height: int, width: int) -> Floats:
    """Light that is smooth from one cell to the next, so that a straight line is its course between them."""
    rng = np.random.default_rng(6)
    made = np.stack([ndimage.gaussian_filter(rng.random((height, width)), 6.0, mode="wrap") for _ in COLOURS])
    return np.asarray(0.5 + 4.0 * (made - made.mean()), dtype=np.float64)


def moved(light: Floats, across_px: float, down_px: float, outward_px: float) -> Floats:
    """Cells of light that is displaced by so many pixels; outward at the corners."""
    height, width = light.shape
    y, x = np.indices((height, width), dtype=float)
    y0, x0 = 0.5 * (height - 1), 0.5 * (width - 1)
    share = 0.5 * outward_px / np.hypot(x0, y0)  # a cell is two pixels
    place = [y - 0.5 * down_px - share * (y - y0), x - 0.5 * across_px - share * (x - x0)]
    return np.asarray(ndimage.map_coordinates(light, place, order=3, mode="nearest"))


@pytest.mark.parametrize("motion", ["across", "down", "outward"])
@pytest.mark.parametrize("size_px", [0.1, -0.3])
def test_a_displacement_is_found_in_pixels(motion: str, size_px: float) -> None:
    height, width = 180, 240
    light = smooth(height, width)
    classes = torch.zeros(height, width, dtype=torch.long)
    classes[:, :4] = classes[:, -4:] = -1
    classes[:4] = classes[-4:] = -1
    shifts = Shifts(torch.from_numpy(light).float(), (1e-4, 0.0), classes, 1, COLOURS, "depth_m")
    after = light.copy()
    after[2] = moved(light[2], **{f"{one}_px": size_px * (one == motion) for one in ("across", "down", "outward")})
    number, total, _ = shifts.sums(torch.from_numpy(after - light).float()[None], None, 1)
    for colour in COLOURS:
        own = shifts.place[shift_name(motion, colour), "depth_m"]
        found = float(total[0, own][0] / number[0, own][0])
        # Gradients of opposite corners are not quite independent: a tenth of the size for the other motions.
        assert found == pytest.approx(size_px if colour == "blue" else 0.0, abs=0.04 * abs(size_px))
        for other in {"across", "down", "outward"} - {motion}:
            own = shifts.place[shift_name(other, colour), "depth_m"]
            assert abs(float(total[0, own][0] / number[0, own][0])) < 0.3 * abs(size_px)


def test_noise_of_a_displacement_is_what_noise_makes() -> None:
    """Standard deviation of the displacement over frames of pure noise, cells counted as four to one."""
    height, width, frames, sd = 60, 80, 600, 0.01
    light = torch.from_numpy(smooth(height, width)).float()
    classes = torch.zeros(height, width, dtype=torch.long)
    shifts = Shifts(light, (sd**2, 0.0), classes, 1, COLOURS, "depth_m")
    generator = torch.Generator().manual_seed(8)
    pixels = torch.tensor([0.5, 1.0, 0.5])[:, None, None]
    noise = sd / pixels.sqrt() * torch.randn(frames, 3, height, width, generator=generator)
    number, total, square = shifts.sums(noise, None, 1)
    found = (total / number).std(0, ddof=1)
    stated = np.sqrt(square[0] / number[0] / number[0] / SHARED_CELLS)
    np.testing.assert_allclose(found, stated, rtol=5.0 / np.sqrt(2.0 * frames))


def test_gradients_are_per_pixel() -> None:
    ramp = 3.0 * torch.arange(8.0).expand(1, 6, 8) + 5.0 * torch.arange(6.0)[:, None]
    across, down, outward = gradients(ramp)[:, 0, 2, 5].tolist()
    assert (across, down) == (1.5, 2.5)
    radius = np.hypot(3.5, 2.5)
    assert outward == pytest.approx((1.5 * 1.5 + 2.5 * -0.5) / radius)


def test_portions_of_a_displacement_add_up(model: CameraFrames) -> None:
    whole, parts = model.clear("s0"), model.clear("s0", 16)
    for what in ("weight", "value"):
        summed = group(model, parts, "shift_down_px_red", "depth_m", what).reshape(CLEAR, 16, -1).sum(1)
        np.testing.assert_allclose(
            summed, group(model, whole, "shift_down_px_red", "depth_m", what), rtol=1e-3, atol=1e-4
        )


# ---- rows, columns, single pixels ------------------------------------------------------------------------------------


def test_rows_and_columns_are_products_far_along_them(model: CameraFrames) -> None:
    clear, scene, sums = model.clear("s0"), model.scenes["s0"], model._clear_sums["s0"]
    apart = planes(scene.clear[0, 0].double().numpy())[1] - planes(scene.reference[0, 0].double().numpy())[1]
    height, width = apart.shape
    classes = sums._depth_classes().numpy()
    for name, turned in (("column", False), ("row", True)):
        light, kinds = (apart.T, classes.T) if turned else (apart, classes)
        noise = (sums.in_rows if turned else sums.beside).noise.numpy()
        total, number = np.zeros(2), np.zeros(2)
        rows, columns = light.shape
        relative = np.zeros_like(light)
        for x in range(ASIDE, columns - ASIDE):
            beside = 0.5 * (light[:, x - ASIDE] + light[:, x + ASIDE])
            relative[:, x] = np.clip((light[:, x] - beside) / noise[:, x], -HIGHEST, HIGHEST)
        for y in range(rows - FAR_LAG):
            for x in range(ASIDE, columns - ASIDE):
                kind = kinds[y, x]
                if kind >= 0 and kind == kinds[y + FAR_LAG, x]:
                    total[kind] += relative[y, x] * relative[y + FAR_LAG, x]
                    number[kind] += 1
        found = group(model, clear, f"{name}_correlation", "depth_m")[0] * SHARED_CELLS
        weight = group(model, clear, f"{name}_correlation", "depth_m", "weight")[0] * SHARED_CELLS
        np.testing.assert_allclose(weight, number)
        np.testing.assert_allclose(found, total, rtol=1e-3, atol=0.05)
    assert (height, width) == (HEIGHT // 2, WIDTH // 2)


def test_a_lone_pixel_is_one_that_none_about_it_follows() -> None:
    rng = np.random.default_rng(12)
    relative = rng.normal(0.0, 1.0, (3, 40, 50))
    far = rng.random(relative.shape) < 0.01
    relative += far * rng.choice([-30.0, 30.0], relative.shape)
    relative[:, 10:12, 10:14] += 30.0  # a streak
    frames, height, width = relative.shape
    expected = []
    for frame in range(frames):
        for row in range(1, height - 1):
            for column in range(1, width - 1):
                own = abs(relative[frame, row, column])
                about = np.delete(np.abs(relative[frame, row - 1 : row + 2, column - 1 : column + 2]).ravel(), 4)
                if own >= LONE_SD and about.max() < LONE_SHARE * own:
                    expected.append((frame, row, column))
    found = lone_pixels(torch.from_numpy(relative))
    assert list(zip(*(one.tolist() for one in found), strict=True)) == expected
    assert len(expected) > 20


def test_cells_count_the_pixels_that_stand_out_in_both_frames() -> None:
    """Means over many hashes, held against the number; each scatters by the root of 60 x 60 over the cells, and of the
    common ones' own products."""
    height, width, cells, common, others, number = 60, 80, 200, 25, 35, 400
    rng = np.random.default_rng(13)
    modelled = torch.full((3, 1, height, width), 0.5)
    found = []
    for turn in range(number):
        # Each has a place of its own on a grid: none is beside another.
        grid = [(2 + 4 * k, 2 + 4 * n) for k in range(14) for n in range(19)]
        chosen = rng.permutation(len(grid))[: common + 2 * others]
        bayer = modelled[:2].clone()
        for frame, own in enumerate((chosen[: common + others], np.delete(chosen, slice(common, common + others)))):
            for place in own:
                bayer[frame, 0, grid[place][0], grid[place][1]] += 0.2 if place % 2 else -0.2
        pixels = LonePixels(modelled, (1e-4, 0.0), cells)
        shift = (turn % 7, turn % 11)  # other places, other cells
        bayer = torch.roll(bayer, shift, (2, 3))
        first, second = pixels(bayer, torch.tensor([0, 1]))
        found.append(first @ second)
    scatter = (common + others) / np.sqrt(cells) / np.sqrt(number)
    assert np.mean(found) == pytest.approx(common, abs=5.0 * np.sqrt(2.0) * scatter)


def test_pixels_that_stand_out_in_all_frames_persist_and_flakes_do_not() -> None:
    """Of 74 hot pixels some stand beside others, behind flakes or at the border."""
    given = values_of(kind="snow")
    model = CameraFrames(Study.from_arrays(**given))
    condition = model.fit[0]
    place = [one.statistic for one in model.layout.groups].index("lone_pixel_map")
    entry = model.layout.slices[place]
    pool = Pool(model.layout, model.simulated(condition, [], 0.0, list(range(4 * CLEAR))))
    index = np.random.default_rng(0).permuted(np.tile(np.arange(len(pool)), (50, 1)), axis=1)[:, :3]
    flakes = pool.vectors(index)[:, entry]
    rng = np.random.default_rng(11)
    hot = torch.stack(
        [torch.from_numpy(hot_pixels(np.asarray(frame["bayer"], float), rng)).float() for frame in condition.frames]
    )[:, None]
    row = torch.arange(len(hot)) % CLEAR
    found = Pool(model.layout, model._of(condition)(hot.clamp(0.0, 1.0), row)).vectors(np.arange(3)[None])[0, entry]
    number = int((np.random.default_rng(9).random((HEIGHT, WIDTH)) < 6e-3).sum())
    print(number, found, flakes.mean(), flakes.std())
    assert found[0] ** 2 == pytest.approx(0.7 * number, rel=0.4)
    assert found[0] > flakes.mean() + 8.0 * flakes.std()


def rows_of_their_own(frame: Floats, rng: np.random.Generator) -> Floats:
    return np.asarray(frame + 0.004 * rng.standard_normal((HEIGHT, 1)))


def hot_pixels(frame: Floats, rng: np.random.Generator) -> Floats:
    return np.asarray(frame + 0.25 * (np.random.default_rng(9).random((HEIGHT, WIDTH)) < 6e-3))


def blue_larger(frame: Floats, rng: np.random.Generator) -> Floats:
    found = frame.copy()
    found[1::2, 1::2] = moved(frame[1::2, 1::2], 0.0, 0.0, 1.0)
    return found


@pytest.mark.parametrize(
    ("fault", "statistic"),
    [
        (rows_of_their_own, "row_correlation"),
        (hot_pixels, "lone_pixel_map"),
        (blue_larger, "shift_outward_px_blue"),
    ],
)
def test_faults_that_no_effect_explains_are_seen_in_snow(
    fault: Callable[[Floats, np.random.Generator], Floats], statistic: str
) -> None:
    rng = np.random.default_rng(11)
    given = values_of(kind="snow")
    for condition in given["conditions"]:
        condition["frames"] = [
            {"bayer": np.clip(fault(frame["bayer"].astype(float), rng), 0.0, 1.0).astype(np.float32)}
            for frame in condition["frames"]
        ]
    model = CameraFrames(Study.from_arrays(**given))
    condition = model.fit[0]
    seeds = list(range(2 * CLEAR))
    here, there = model.simulated(condition, [], 0.0, seeds), model.measured(condition)
    modelled, measured = Pool(model.layout, here), Pool(model.layout, there)
    index = np.arange(len(measured))[None]
    apart = measured.vectors(index)[0] - modelled.vectors(np.arange(len(seeds))[None])[0]
    least = np.hypot(modelled.independent_scatter(len(measured)), modelled.known_to(len(measured)))
    z = np.abs(apart) / np.where(least > 0, least, np.inf)
    own = model.layout.each(lambda one: one.statistic.startswith(statistic)) & modelled.enough(len(measured))
    print(statistic, z[own].max())
    assert z[own].max() > 8.0
