"""References of a LiDAR scene's frames: its clear frames, beam by beam, and the bins that beams are put into.

A simulated frame starts from one clear frame and is compared with the others, a measured one with all but one too: both
differ from what they are compared with by the noise of a frame of their own. A beam is *stable* where all clear frames
see one surface, well above the threshold of detection, and *empty* where none of those that a frame is compared with
sees anything and the beam ends in the sky; others are left out.

References:
    GAP.md 3 (1, 2).
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from torchweather.gap.sensors.lidar.open_beams import open_beams
from torchweather.gap.sensors.lidar.reading_steps import frames_within_steps, reading_step
from torchweather.gap.sensors.lidar.stable_beams import SAME_SURFACE_M, one_range
from torchweather.gap.study.study import StudyScene
from torchweather.lidar.stages import ToEnergy

__all__ = ["CLUSTER_M", "FAINTEST", "LidarScene", "has_neighbour", "least_detected", "lidar_scene"]

RANGE_M = (0.0, 4.0, 8.0, 12.0, 17.0, 23.0, 30.0, 40.0, 55.0, 75.0, 110.0, 1000.0)
MARGIN_DB = (-10.0, 0.7, 1.5, 2.5, 4.0, 6.0, 9.0, 13.0, 18.0, 60.0)
AZIMUTH_SECTORS, ELEVATION_BINS, LEVEL_BINS = 16, 8, 5
COS_INCIDENCE = (0.0, 0.15, 0.3, 0.5, 0.75, 1.0001)
UP = (-1.0001, -0.5, 0.5, 1.0001)
ISOLATED = (0.0, 0.5, 1.5)
SPREAD_TIMES = 6.0
CLUSTER_M = 0.5  # returns of one thing in neighbouring beams
FAINTEST = 1e-6  # of intensities in logarithms
# A beam nearer to the threshold than so many standard deviations of the noise of beams is chosen by that noise: seen in
# all clear frames, it was lucky. (Beams at the threshold are about twice as noisy as the mean one.)
FLICKER_SD = 6.0
CHOSEN_SD = 3.0  # of a reading, beyond which noise hardly takes it
DB_PER_NEPER = 10.0 / math.log(10.0)  # of a power
LEAST_NOISE_M = 2e-3  # a range that is written in millimetres
LEAST_READING_NOISE = 1e-3  # of ln(intensity): a reading that is written in a thousand steps


@dataclass(frozen=True)
class LidarScene:
    """The clear frames of a scene and what each frame is compared with.

    Args:
        range_m, intensity: ``(K, N)`` clear frames; readings within their steps.
        step: of readings, 0 where they have none (``reading_steps.py``).
        unsure: ``(N,)`` relative variance of each beam's level that steps leave open; ``None`` where there are none.
        reference_range_m, reference_intensity: ``(K + 1, N)`` mean over the clear frames other than k, the last row
            over all; 0 where it is not defined.
        stable: ``(N,)`` beams that see a surface.
        empty: ``(K + 1, N)`` beams to the sky that saw nothing in any clear frame other than k; the last row in none. A
            surface at the threshold that frame k alone saw is there in a simulated frame as it is in a measured one.
        tolerance_m: how near to the reference a return is the surface's.
        noise_m: standard deviation of the range of the clear frames.
        reading_noise: standard deviation of ln(intensity) of the clear frames, beside what whole frames do.
        log_scale: ``(K,)`` logarithm of the intensities of each clear frame over the mean of all, averaged: what a
            sensor's scale does from frame to frame.
        gain: ``(K,)`` the scale that a frame is divided by.
        clock_m: ``(K,)`` range of each clear frame beyond the mean of all, averaged over stable beams: what the start
            of a sensor's clock does from frame to frame.
        reading_std: relative standard deviation of the intensity that does not depend on the signal.
        variance_at_threshold: relative variance of the intensity that goes as one over the signal, at the threshold.
        bins: axis to the bin of each beam ``(K + 1, N)``, -1 for none, after the clear frames other than k: a frame
            must not choose the bin that it is put into.
        edges: axis to the edges of its bins.
        cos_incidence, up: ``(N,)`` or None.
    """

    range_m: Tensor
    intensity: Tensor
    step: float
    unsure: Tensor | None
    reference_range_m: Tensor
    reference_intensity: Tensor
    stable: Tensor
    empty: Tensor
    tolerance_m: float
    noise_m: float
    reading_noise: float
    log_scale: Tensor
    gain: Tensor
    clock_m: Tensor
    reading_std: float
    variance_at_threshold: float
    bins: dict[str, Tensor]
    edges: dict[str, tuple[float, ...]]
    cos_incidence: Tensor | None
    up: Tensor | None


def lidar_scene(
    scene: StudyScene,
    direction: Tensor,
    grid: tuple[int, int],
    energy: ToEnergy,
    with_intensity: bool,
    max_range_m: float,
) -> LidarScene:
    """A scene of a study, reduced to what frames are compared with.

    Args:
        scene: of the study.
        direction: ``(N, 3)`` unit vectors of the beams.
        grid: their rows and columns.
        energy: of the sensor; tells how far above the threshold a beam is.
        with_intensity: whether intensities mean anything.
        max_range_m: of the sensor.
    """
    frames = [scene.clear[number] for number in range(len(scene.clear))]
    range_m, intensity = (
        torch.stack([torch.from_numpy(np.asarray(frame[name], dtype=np.float32)).reshape(-1) for frame in frames])
        for name in ("range_m", "intensity")
    )
    number = len(frames)
    step = reading_step(intensity[range_m > 0]) if with_intensity else 0.0
    # What frames are compared with follows from the readings alone: a place that was drawn within a step is one that
    # simulated frames share and measured ones do not.
    read, unsure = torch.where(range_m > 0, intensity + 0.5 * step, intensity), None
    if step > 0:
        least = least_detected(range_m, intensity, step, energy)
        intensity, unsure = frames_within_steps(intensity, range_m > 0, step, least, 0)
    seen = (range_m > 0).double()
    # Row k leaves frame k out, the last row takes all; of a single frame, itself.
    keep = torch.ones(number + 1, number, dtype=torch.float64)
    if number > 1:
        keep[:number] -= torch.eye(number, dtype=torch.float64)
    count, frames_of = keep @ seen, keep.sum(1, keepdim=True)
    mean_range = (keep @ range_m.double()) / count.clamp_min(1.0)
    mean_intensity = (keep @ (read.double() * seen)) / count.clamp_min(1.0)
    one_surface = one_range(range_m)
    # Of all frames: a beam that a single frame sees is not empty, nor is one stable that a single frame lacks.
    stable = (keep @ seen == frames_of).all(0) & one_surface
    empty = (count == 0) & open_beams(mean_range.float(), direction, grid, max_range_m)
    usual = _spread(range_m.double() - mean_range[-1], (seen > 0) & one_surface)
    geometry = {
        name: torch.from_numpy(np.asarray(scene.geometry[name], dtype=np.float32)).reshape(-1)
        for name in ("cos_incidence", "up")
        if name in scene.geometry
    }
    with torch.no_grad():
        signal = energy.signal_of_intensity(mean_intensity.float(), mean_range.float())
    margin_db = 10.0 * torch.log10((signal / energy.beam.threshold).clamp_min(1e-6))
    log_scale, gain = torch.zeros(number, dtype=torch.float64), torch.ones(number)
    variance_at_threshold, reading_std, reading_noise = 0.0, 0.0, 0.0
    chosen = torch.zeros_like(margin_db, dtype=torch.bool)
    if with_intensity:
        drawn = (intensity.double() * seen).sum(0) / count[-1].clamp_min(1.0)
        apart = intensity.double().clamp_min(FAINTEST).log() - drawn.clamp_min(FAINTEST).log()
        noise_db = DB_PER_NEPER * _spread(apart, stable)
        stable = stable & (margin_db[-1] > FLICKER_SD * noise_db)
        chosen = _chosen_by_own_noise(margin_db, noise_db)
        if bool(stable.any()) and number > 1:
            log_scale = apart[:, stable].mean(1)
            gain = log_scale.exp().float()
            constant, variance_at_threshold = _variances(apart[:, stable] - log_scale[:, None], margin_db[-1, stable])
            reading_std = math.sqrt(constant)
            reading_noise = _spread(apart - log_scale[:, None], stable)
    clock_m = torch.zeros(number)
    if bool(stable.any()) and number > 1:
        clock_m = (range_m.double() - mean_range[-1])[:, stable].mean(1).float()
    beams = torch.arange(mean_range.shape[1])
    isolated = ~has_neighbour(mean_range[-1].float()[None], grid, 2.0 * CLUSTER_M, beams)
    bins, edges = _bins(direction, mean_range, mean_intensity, margin_db, isolated, stable, with_intensity, geometry)
    # Along axes whose bins follow the frames anyway.
    bins |= {
        axis: bins[axis].masked_fill(chosen, -1) for axis in ("range_m", "margin_db", "log_intensity") if axis in bins
    }
    return LidarScene(
        range_m=range_m,
        intensity=intensity,
        step=step,
        unsure=unsure,
        reference_range_m=mean_range.float(),
        reference_intensity=mean_intensity.float(),
        stable=stable,
        empty=empty,
        tolerance_m=max(SAME_SURFACE_M, SPREAD_TIMES * min(usual, 0.2)),
        noise_m=max(usual, LEAST_NOISE_M),
        reading_noise=max(reading_noise, LEAST_READING_NOISE),
        log_scale=log_scale,
        gain=gain,
        clock_m=clock_m,
        reading_std=reading_std,
        variance_at_threshold=variance_at_threshold,
        bins=bins,
        edges=edges,
        cos_incidence=geometry.get("cos_incidence"),
        up=geometry.get("up"),
    )


def least_detected(range_m: Tensor, intensity: Tensor, step: float, energy: ToEnergy) -> Tensor:
    """Reading ``(N,)`` at the threshold of detection, within the lowest step in which a beam was read."""
    lowest = torch.where(range_m > 0, intensity, torch.inf).amin(0)
    lowest = torch.where(lowest.isfinite(), lowest, 0.0)
    with torch.no_grad():
        start, end = (
            energy.signal_of_intensity(one[None], range_m.amax(0)[None])[0] for one in (lowest, lowest + step)
        )
    share = (energy.beam.threshold - start) / (end - start).clamp_min(1e-30)
    return lowest + step * share.clamp(0.0, 1.0)


def _spread(departure: Tensor, where: Tensor) -> float:
    """Root mean square of departures from the mean of the frames ``(K, N)``, of the beams that count."""
    counted = where.expand(departure.shape)
    number = int(counted.sum())
    share = (len(departure) - 1) / len(departure)  # the mean was taken from the frames themselves
    if number == 0 or share == 0:
        return 0.0
    return float((torch.where(counted, departure, 0.0).square().sum() / (number * share)).sqrt())


def _chosen_by_own_noise(margin_db: Tensor, noise_db: float) -> Tensor:
    """Beams ``(K + 1, N)`` that are stable only where frame k itself was read high.

    Stable is a beam whose mean of all K frames stands above the limit. Where the mean m of the others stands less than

        CHOSEN_SD n (1 + 1 / sqrt(K - 1)) / K

    above it, a beam counts if frame k, as noisy as n, was lucky: a frame that is simulated from k is brighter there
    than a measured one.

    Args:
        margin_db: ``(K + 1, N)`` of the mean without frame k, in the last row of all.
        noise_db: n, standard deviation of a reading.
    """
    number = len(margin_db) - 1
    if number < 2:
        return torch.zeros_like(margin_db, dtype=torch.bool)
    beyond = CHOSEN_SD * noise_db * (1.0 + 1.0 / math.sqrt(number - 1)) / number
    found = margin_db <= FLICKER_SD * noise_db + beyond
    found[-1] = False
    return found


def _variances(apart: Tensor, margin_db: Tensor) -> tuple[float, float]:
    """c and v, 0 or more, of a variance ``c + v / M`` of departures ``(K, S)`` of beams M times over the threshold."""
    variance = apart.square().sum(0) / (len(apart) - 1)
    weak = 10.0 ** (-0.1 * margin_db)
    centred = weak - weak.mean()
    growing = max(0.0, float((centred * variance).sum() / centred.square().sum().clamp_min(1e-12)))
    return max(0.0, float(variance.mean() - growing * weak.mean())), growing


def _bins(
    direction: Tensor,
    range_m: Tensor,
    intensity: Tensor,
    margin_db: Tensor,
    isolated: Tensor,
    stable: Tensor,
    with_intensity: bool,
    geometry: Mapping[str, Tensor],
) -> tuple[dict[str, Tensor], dict[str, tuple[float, ...]]]:
    """Bins of each beam along every axis that a beam has."""
    azimuth = torch.atan2(direction[:, 1], direction[:, 0])
    elevation = torch.asin(direction[:, 2].clamp(-1.0, 1.0))
    low, high = float(elevation.min()), float(elevation.max())
    axes: dict[str, tuple[Tensor, tuple[float, ...]]] = {
        "range_m": (range_m, RANGE_M),
        "azimuth_rad": (azimuth, _evenly(-math.pi, math.pi, AZIMUTH_SECTORS)),
        "elevation_rad": (elevation, _evenly(low, high, ELEVATION_BINS)),
        "isolated": (isolated.float(), ISOLATED),
    }
    if with_intensity:
        level = intensity.clamp_min(FAINTEST).log()
        shares = torch.linspace(0, 1, LEVEL_BINS + 1, dtype=torch.float64)[1:-1]
        inner = torch.quantile(level[-1, stable], shares).tolist() if bool(stable.any()) else []
        axes["log_intensity"] = (level, (-30.0, *inner, 30.0))
        axes["margin_db"] = (margin_db, MARGIN_DB)
    if "cos_incidence" in geometry:
        axes["cos_incidence"] = (geometry["cos_incidence"].abs(), COS_INCIDENCE)
    if "up" in geometry:
        axes["up"] = (geometry["up"], UP)
    bins, edges = {}, {}
    for axis, (value, bounds) in axes.items():
        place = torch.bucketize(value.double().contiguous(), torch.tensor(bounds, dtype=torch.float64), right=True) - 1
        inside = (place >= 0) & (place < len(bounds) - 1)
        bins[axis] = torch.where(inside, place, -1).expand(range_m.shape)
        edges[axis] = tuple(bounds)
    return bins, edges


def _evenly(low: float, high: float, bins: int) -> tuple[float, ...]:
    return tuple(float(value) for value in np.linspace(low - 1e-6, high + 1e-6, bins + 1))


def has_neighbour(range_m: Tensor, grid: tuple[int, int], within_m: float, which: Tensor) -> Tensor:
    """Mask of returns of which a neighbour, of the eight around, is a return of nearly the same range.

    Args:
        range_m: ``(F, N)`` of the frames, 0 where no return.
        grid: rows and columns of the scan; the last column is beside the first.
        within_m: that is nearly its range.
        which: ``(K,)`` places of the returns that are asked for, in the flattened frames.

    Returns:
        ``(K,)`` bool.
    """
    (rows, columns), flat = grid, range_m.flatten()
    beam = which % range_m.shape[1]
    row, column = beam // columns, beam % columns
    first, own_m = which - beam, flat[which]
    found = torch.zeros_like(which, dtype=torch.bool)
    for up in (-1, 0, 1):
        beside_row = row + up
        inside = (beside_row >= 0) & (beside_row < rows)
        for aside in (-1, 0, 1):
            if up == 0 and (aside == 0 or columns == 1):
                continue
            beside = first + beside_row.clamp(0, rows - 1) * columns + (column + aside) % columns
            found |= inside & (flat[beside] > 0) & ((flat[beside] - own_m).abs() < within_m)
    return found & (own_m > 0)
