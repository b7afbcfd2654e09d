"""Displaced colours, rows and columns with offsets of their own, pixels that stand out: against plain loops."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
import torch
from numpy.typing import NDArray
from scipy import ndimage, stats

from tests.gap.test_camera_frames import CLEAR, HEIGHT, WIDTH, group, planes, values_of
from torchweather.gap import Study
from torchweather.gap.camera import CameraFrames
from torchweather.gap.camera_edges import SHARED_CELLS
from torchweather.gap.camera_scene import green_pair
from torchweather.gap.camera_shift import Shifts, gradients, shift_name
from torchweather.gap.camera_sums import ASIDE, FAR_LAG, HIGHEST, TAILS_SD
from torchweather.gap.statistics import Pool

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
        noise = (sums._row_noise if turned else sums._tail_noise).numpy()
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


def test_pairs_of_greens_are_counted_by_how_far_they_differ(model: CameraFrames) -> None:
    clear, scene, sums = model.clear("s0"), model.scenes["s0"], model._clear_sums["s0"]

    def difference(bayer: Floats) -> Floats:
        return np.asarray(bayer[0::2, 1::2] - bayer[1::2, 0::2])

    apart = difference(scene.clear[0, 0].double().numpy()) - difference(scene.reference[0, 0].double().numpy())
    size = np.abs(apart) / sums._pair_noise.numpy()
    for kind, where in enumerate(("near", "far")):
        inside = sums._pair_class.numpy() == kind
        counted = np.histogram(size[inside], TAILS_SD)[0]
        found = group(model, clear, f"green_pair_share_{where}", "residual_sd")[0] * SHARED_CELLS
        np.testing.assert_allclose(found, counted, atol=1.0)  # one on an edge of a bin
        # In clear air they are normal, of the variance that they have here.
        expected = 2.0 * stats.norm.sf(TAILS_SD[0] / np.sqrt((size[inside] ** 2).mean())) * inside.sum()
        assert counted.sum() == pytest.approx(expected, abs=5.0 * np.sqrt(expected))


def test_greens_of_a_cell_are_told_apart() -> None:
    bayer = torch.rand(2, 1, 4, 6, generator=torch.Generator().manual_seed(1))
    torch.testing.assert_close(green_pair(bayer, "GRBG"), bayer[:, 0, 0::2, 0::2] - bayer[:, 0, 1::2, 1::2])
    torch.testing.assert_close(green_pair(bayer, "RCCB"), bayer[:, 0, 0::2, 1::2] - bayer[:, 0, 1::2, 0::2])


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
        (hot_pixels, "green_pair_share"),
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
    z = np.abs(apart) / modelled.least_scatter(len(measured))
    own = model.layout.each(lambda one: one.statistic.startswith(statistic)) & modelled.enough(len(measured))
    print(statistic, z[own].max())
    assert z[own].max() > 8.0
