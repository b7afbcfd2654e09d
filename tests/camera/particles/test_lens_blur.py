"""Particles through a lens (PHYSICS.md 10.14) against every particle, drawn sharp and blurred as a picture."""

from __future__ import annotations

import math
from functools import lru_cache
from typing import Any

import numpy as np
import pytest
import torch
from numpy.typing import NDArray
from scipy.signal import oaconvolve

from tests.reference.every_particle import Kind, draw_particles, mark_patches, population
from torchweather.atmosphere.weather import Rain, Snow
from torchweather.sensors import Camera
from torchweather.transforms import BayerWeather

SIZE, MARGIN, FINE = 96, 12, 3
EXPOSURE_S = 0.005
LIMITS_M: dict[Kind, tuple[float, float]] = {"rain": (1.5, 8.0), "snow": (4.0, 14.0)}
F_PX = 968.0 / math.tan(math.radians(40.4))
BLUR_PX = 2.2
RATES: dict[Kind, float] = {"rain": 50.0, "snow": 0.5}
REFERENCE_SEEDS, SEEDS = 8, 40


def disk(diameter: float) -> NDArray[np.float64]:
    """Share of each cell of a grid that a disk covers, of sum 1."""
    reach = math.ceil(diameter / 2)
    place = (np.arange((2 * reach + 1) * 20) + 0.5) / 20 - (reach + 0.5)
    inside = place**2 + place[:, None] ** 2 <= diameter**2 / 4
    cells = inside.reshape(2 * reach + 1, 20, 2 * reach + 1, 20).mean(axis=(1, 3))
    return cells / cells.sum()


@lru_cache
def reference(kind: Kind, blur_px: float) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Mean and standard deviation over the pixels of each reference frame's covered share.

    The sum of all sharp marks, on a grid three times as fine, is convolved with the lens's disk and averaged over the
    pixels: no mark is widened or thinned. Marks seldom overlap: half of the mean cover, under 1 %.
    """
    whole = FINE * (SIZE + 2 * MARGIN)
    found = []
    for seed in range(REFERENCE_SEEDS):
        total = np.zeros(whole * whole)
        slabs = draw_particles(
            population(kind, RATES[kind]),
            f_px=FINE * F_PX,
            height=whole,
            width=whole,
            near_m=LIMITS_M[kind][0],
            far_m=LIMITS_M[kind][1],
            exposure_s=EXPOSURE_S,
            slant_rad=0.0,
            rng=np.random.default_rng(seed),
        )
        for particles in slabs:
            for values, first_row, first_column, _ in mark_patches(particles):
                row = first_row[:, None, None] + np.arange(values.shape[1])[:, None]
                column = first_column[:, None, None] + np.arange(values.shape[2])
                inside = (row >= 0) & (row < whole) & (column >= 0) & (column < whole)
                total += np.bincount((row * whole + column)[inside], values[inside], whole * whole)
        fine = total.reshape(whole, whole)
        if blur_px:
            fine = oaconvolve(fine, disk(FINE * blur_px), mode="same")
        pixels = fine.reshape(whole // FINE, FINE, whole // FINE, FINE).mean(axis=(1, 3))
        mask = np.minimum(pixels[MARGIN:-MARGIN, MARGIN:-MARGIN], 1.0)
        found.append((mask.mean(), mask.std()))
    means, deviations = np.array(found).T
    return means, deviations


@lru_cache
def fast(kind: Kind, blur_px: float) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    camera = Camera.from_intrinsics(
        F_PX, F_PX, (SIZE - 1) / 2, (SIZE - 1) / 2, SIZE, SIZE, exposure_s=EXPOSURE_S, lens_blur_px=blur_px
    )
    weather = (Rain if kind == "rain" else Snow)(RATES[kind])
    transform = BayerWeather(weather, camera, near_m=LIMITS_M[kind][0], depth=LIMITS_M[kind][1], airlight=0.5)
    frame = torch.zeros(1, SIZE, SIZE)
    masks = [transform.run(frame, noise=transform.draw(frame, seed=seed)).particle_mask for seed in range(SEEDS)]
    return np.array([float(one.mean()) for one in masks]), np.array([float(one.std()) for one in masks])


def error_of(ours: NDArray[np.float64], theirs: NDArray[np.float64]) -> float:
    """Three standard errors of the difference of the means over seeds."""
    return 3 * math.sqrt(float(ours.var(ddof=1)) / len(ours) + float(theirs.var(ddof=1)) / len(theirs))


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["rain", "snow"])
def test_a_lens_keeps_the_mean_and_takes_the_reference_s_share_of_the_spread(kind: Any) -> None:
    ours, theirs = fast(kind, BLUR_PX), reference(kind, BLUR_PX)
    mean, deviation = (float(one.mean()) for one in ours)
    # The same shares as of sharp marks in test_particle_statistics.py: 1 % of the mean, 5 % of the deviation.
    wanted_mean, wanted_deviation = (float(one.mean()) for one in theirs)
    assert mean == pytest.approx(wanted_mean, abs=0.01 * wanted_mean + error_of(ours[0], theirs[0]))
    assert deviation == pytest.approx(wanted_deviation, abs=0.05 * wanted_deviation + error_of(ours[1], theirs[1]))


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["rain", "snow"])
def test_a_lens_smooths_single_pixels_as_much_as_it_smooths_the_picture(kind: Any) -> None:
    sharp, soft = fast(kind, 0.0), fast(kind, BLUR_PX)
    assert float(soft[0].mean()) == pytest.approx(float(sharp[0].mean()), rel=0.01, abs=error_of(soft[0], sharp[0]))
    ratio = float(soft[1].mean() / sharp[1].mean())
    wanted = float(reference(kind, BLUR_PX)[1].mean() / reference(kind, 0.0)[1].mean())
    assert wanted < 0.9  # else this could not fail
    assert ratio == pytest.approx(wanted, abs=0.07)  # two deviations of 5 % each


def test_presets_without_a_measured_lens_have_a_typical_one() -> None:
    assert Camera.preset("lucid-triton").lens_blur_px == 2.2
    assert Camera.preset("kitti").lens_blur_px == 2.2
    assert Camera.preset("lucid-triton", lens_blur_px=0.0).lens_blur_px == 0.0
