"""A radar scene in clear air: what each target is compared with, how much it fluctuates, and where it lies.

A frame is compared with all clear frames of its scene but one, as simulated frames are: the one that they start from.
Only targets count that half of those others have. Were the frame itself among them, what is strong in it by chance
would be taken for a target that is strong, and measured frames, which are not among them, would fall behind. Powers
are compared in dB.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import stats
from scipy.ndimage import median_filter

from torchweather.core.errors import TorchweatherError
from torchweather.gap.sensors.radar.fading import FADING_SPREAD_DB, chance_of_fading, fading, shares_by_class
from torchweather.gap.study.frames import Frame
from torchweather.gap.study.study import StudyScene
from torchweather.radar.sensor import Radar

__all__ = [
    "CLUTTER_COLUMNS",
    "MEASURED",
    "Detections",
    "RadarScene",
    "detection_count",
    "detections_of",
    "inverse_variance_weights",
    "own_spread",
    "radar_edges",
    "radar_scene",
]

Floats = NDArray[np.float64]
Whole = NDArray[np.int64]

CLUTTER_COLUMNS = 5  # range, azimuth, elevation, speed, power; the Doppler width is not simulated
BINS = 5  # along each axis, of about as many targets each
AXES = ("range_m", "azimuth_rad", "elevation_rad", "margin_db")
PRIOR_DEGREES = 2.0  # of freedom, that the median spread of all targets counts beside a target's own
# The same of the median one of so many targets of about its power; set on development studies of the bench.
LIKE_DEGREES, ALIKE = 4.0, 17
LEVEL_ROUNDS = 4  # in which what a frame's targets share is told from what each has of its own
LEAST_LEVEL_SHARE = 1 / 16  # of the quiet quarter's variance: a target tells of the level as if it had so much more
# No list is read finer (quantisation of series radars, order of magnitude): dB, m, m/s.
LEAST_SPREAD = {"power_db": 0.05, "range_m": 1e-3, "speed_m_per_s": 1e-3}
FLICKERS = 3.0  # spreads above the threshold, up to which a target is lost in clear air now and then
SELDOM = float(stats.norm.sf(FLICKERS))  # how often one there is lost, and at most one that fluctuates
MEASURED = ("power_db", "range_m", "speed_m_per_s")


@dataclass(frozen=True)
class Detections:
    """Frames of one scene.

    Args:
        power_db, range_m, speed_m_per_s: ``(F, N)`` of the targets, NaN where not detected.
        floor_db: ``(F,)`` of the empty cells.
        clutter: ``(M, 5)`` further detections of all frames: range, azimuth, elevation, speed, power.
        clutter_frame: ``(M,)`` which frame each belongs to.
    """

    power_db: Floats
    range_m: Floats
    speed_m_per_s: Floats
    floor_db: Floats
    clutter: Floats
    clutter_frame: Whole

    def __len__(self) -> int:
        return len(self.power_db)


def detections_of(frames: Sequence[Frame]) -> Detections:
    """Frames of a study, one after the other."""
    targets = [np.stack([np.asarray(frame[name], dtype=np.float64) for frame in frames]) for name in MEASURED]
    floor_db = np.array([float(np.asarray(frame["noise_floor_db"])) for frame in frames])
    rows = [np.asarray(frame.get("clutter", np.zeros((0, 6))), dtype=np.float64) for frame in frames]
    frame = np.repeat(np.arange(len(frames)), [len(row) for row in rows])
    power_db, range_m, speed = (np.where(np.isnan(targets[0]), np.nan, values) for values in targets)
    return Detections(
        power_db,
        range_m,
        speed,
        floor_db,
        np.concatenate(rows)[:, :CLUTTER_COLUMNS],
        frame,
    )


def detection_count(frames: Detections) -> Whole:
    """Number of detections ``(F,)`` of each frame, targets and others."""
    others = np.bincount(frames.clutter_frame, minlength=len(frames))
    return np.asarray((~np.isnan(frames.power_db)).sum(1) + others)


@dataclass(frozen=True)
class RadarScene:
    """Targets in clear air.

    Args:
        clear: the clear frames.
        geometry: ``range_m, azimuth_rad, elevation_rad, speed_m_per_s, target_class (N,)``.
        reference: of each measured quantity ``(K, N)``, the mean of all clear frames but one; NaN where none has it.
        reference_floor_db: ``(K,)``.
        spread: of each measured quantity ``(K, N)``, standard deviation of a target over all clear frames but one,
            drawn towards that of all targets.
        level_weight: of each measured quantity ``(K, N)``, what a target tells of what several share in a frame: the
            inverse square of what is left of it when that is taken away, over all clear frames but one. Powers of
            those that fluctuate weigh all the same, as they have one law: a handful of frames that are alike by chance
            lacks the deep fades, and is too strong.
        margin_db: ``(K, N)`` by which a target exceeds the detection threshold in the mean of all clear frames but one.
        counted: ``(K, N)`` targets that half of all clear frames but one have, or more.
        known: ``(N,)`` targets that two clear frames or more detect, whose scatter can be estimated. A target that a
            single clear frame detects departs from it in weather by more than any two clear frames differ.
        steady: ``(K, N)`` those that stand above the threshold by several times their spread, and by more if they
            may fluctuate (``radar_fading.py``): what flickers in clear air is lost in weather by chance, and how often
            it does so a handful of clear frames tells badly, and equally badly for all conditions.
    """

    clear: Detections
    geometry: Mapping[str, Floats]
    reference: Mapping[str, Floats]
    reference_floor_db: Floats
    spread: Mapping[str, Floats]
    level_weight: Mapping[str, Floats]
    margin_db: Floats
    counted: NDArray[np.bool_]
    known: NDArray[np.bool_]
    steady: NDArray[np.bool_]

    @property
    def axes(self) -> dict[str, Floats]:
        """Where each target lies along each axis, ``(K, N)``; NaN for those that do not count."""
        known = {**self.geometry, "margin_db": self.margin_db}
        return {name: np.where(self.counted, known[name], np.nan) for name in (*AXES, "target_class")}


def radar_scene(scene: StudyScene, radar: Radar) -> RadarScene:
    """A scene from its clear frames.

    Args:
        scene: of the study.
        radar: for the SNR from which a target is detected.

    Raises:
        TorchweatherError: no target was detected in two clear frames.
    """
    clear = detections_of(list(scene.clear))
    geometry = {
        name: np.asarray(scene.geometry[name], dtype=np.float64)
        for name in ("range_m", "azimuth_rad", "elevation_rad", "speed_m_per_s", "target_class")
    }
    seen = ~np.isnan(clear.power_db)
    known = seen.sum(0) >= 2
    if not known.any():
        raise TorchweatherError(
            f"find_gap: not enough data to decide: {scene.clear.name}: power_db: expected targets that two clear "
            "frames or more detect; got none. Without them the differences between clear frames are unknown."
        )
    reference = {name: _others_mean(getattr(clear, name)) for name in MEASURED}
    count = len(clear)
    floor = (clear.floor_db.sum() - clear.floor_db) / max(count - 1, 1)
    margin_db = reference["power_db"] - floor[:, None] - radar.detection_snr_db
    spread = {name: _spreads(getattr(clear, name), LEAST_SPREAD[name]) for name in MEASURED}
    fluctuates, fades = _fading(clear, floor, radar.detection_snr_db, geometry["target_class"])
    level_weight = {
        name: inverse_variance_weights(
            getattr(clear, name), LEAST_SPREAD[name], reference["power_db"], fluctuates if name == "power_db" else None
        )
        for name in MEASURED
    }
    others = seen.sum(0) - seen
    counted = others >= max(0.5 * (count - 1), 1.0)
    steady = counted & (others == count - 1) & (margin_db > FLICKERS * spread["power_db"])
    steady &= fades < SELDOM
    return RadarScene(clear, geometry, reference, floor, spread, level_weight, margin_db, counted, known, steady)


def _fading(clear: Detections, floor_db: Floats, threshold_db: float, target_class: Floats) -> tuple[Floats, Floats]:
    """From all clear frames but one: probability ``(K, N)`` that a target fluctuates, and that a frame loses it so."""
    snr_db = clear.power_db - clear.floor_db.mean()
    typical_db = _median_spread(clear.power_db, LEAST_SPREAD["power_db"])
    share = shares_by_class(snr_db, threshold_db, typical_db, target_class)
    rows = [np.delete(clear.power_db, row, 0) - floor for row, floor in enumerate(floor_db)]
    fluctuates, fades = (
        np.stack([law(row, threshold_db, typical_db, share) for row in rows]) for law in (fading, chance_of_fading)
    )
    return fluctuates, fades


def _median_spread(values: Floats, least: float) -> float:
    squares, degrees = _squares(values)
    known = degrees > 0
    return float(np.sqrt(np.median(squares[known] / degrees[known]) + least**2)) if known.any() else least


def _mean(values: Floats) -> Floats:
    there = ~np.isnan(values)
    found: Floats = np.where(there, values, 0.0).sum(0) / np.where(there.any(0), there.sum(0), np.nan)
    return found


def _others_mean(values: Floats) -> Floats:
    """Mean ``(K, N)`` of all frames but one, NaN where they have none."""
    there = ~np.isnan(values)
    filled = np.where(there, values, 0.0)
    number = there.sum(0) - there
    found: Floats = (filled.sum(0) - filled) / np.where(number > 0, number, np.nan)
    return found


def _spreads(values: Floats, least: float) -> Floats:
    """Standard deviation ``(K, N)`` of each target over all frames but one, drawn towards the median one's of all."""
    squares, degrees = _squares(values)
    known = degrees > 0
    median = float(np.median(squares[known] / degrees[known])) if known.any() else 0.0
    found = []
    for row in range(len(values)):
        squares, degrees = _squares(np.delete(values, row, 0))
        found.append((squares + PRIOR_DEGREES * median) / (degrees + PRIOR_DEGREES) + least**2)
    return np.sqrt(np.stack(found))


def inverse_variance_weights(
    values: Floats, least: float, power_db: Floats, fluctuates: Floats | None = None
) -> Floats:
    """Inverse squares ``(K, N)`` of the spread of each target about its own mean and the frame's, over all frames but
    one. The frame's is the mean of all targets by these weights, so they are found in turns; a lower limit keeps one
    target from being that mean. A handful of frames tells a spread badly: it is drawn towards that of targets of about
    the same power, as noise goes with the power. One other frame tells no spread: each has the median one of all
    targets, or that of one that fluctuates, as far as its class does.

    Args:
        values: ``(K, N)`` of the frames, NaN where not detected.
        least: spread that no list is read finer than.
        power_db: ``(K, N)`` mean power over all frames but one.
        fluctuates: ``(K, N)`` probability that a target's power does; ``None`` where that is no matter.
    """
    if len(values) < 3:
        chance = np.zeros_like(values) if fluctuates is None else fluctuates
        variance: Floats = (1.0 - chance) * _median_spread(values, least) ** 2 + chance * FADING_SPREAD_DB**2
        return 1.0 / variance
    found = []
    for row in range(len(values)):
        others = np.delete(values, row, 0)
        there = ~np.isnan(others)
        apart = np.where(there, others - _mean(others), 0.0)
        degrees = np.maximum(there.sum(0) - 1, 0)
        known = degrees > 0
        weight = np.ones(values.shape[1])
        for _ in range(LEVEL_ROUNDS):
            level = (weight * apart).sum(1) / np.maximum((weight * there).sum(1), 1e-9)
            squares = np.where(there, apart - level[:, None], 0.0) ** 2
            variance = squares.sum(0) / np.maximum(degrees, 1)
            alike = _of_alike(variance, known, power_db[row])
            variance = (squares.sum(0) + LIKE_DEGREES * alike) / (degrees + LIKE_DEGREES)
            if fluctuates is not None:
                chance = np.where(known, fluctuates[row], 0.0)
                variance = (1.0 - chance) * variance + chance * FADING_SPREAD_DB**2
            quiet = float(np.quantile(variance[known], 0.25)) if known.any() else 0.0
            weight = known / (variance + LEAST_LEVEL_SHARE * quiet + least**2 / 12.0)
        found.append(weight)
    return np.stack(found)


def _of_alike(variance: Floats, known: NDArray[np.bool_], power_db: Floats) -> Floats:
    """Median variance ``(N,)`` of the targets next to each one in power."""
    order = np.flatnonzero(known)[np.argsort(power_db[known])]
    found = np.zeros_like(variance)
    if len(order):
        found[order] = median_filter(variance[order], min(ALIKE, len(order)), mode="nearest")
    return found


def own_spread(values: Floats) -> Floats:
    """Standard deviation ``(N,)`` of each target over the frames ``(K, N)``, that of the median one where two do not
    have it. Badly known, but not off: drawn towards that of all, strong targets would get the errors of weak ones."""
    squares, degrees = _squares(values)
    known = degrees > 0
    variance = squares[known] / degrees[known]
    usual = float(np.median(variance)) if known.any() else 0.0
    found = np.full(len(squares), usual)
    found[known] = variance
    return np.asarray(np.sqrt(found))


def _squares(values: Floats) -> tuple[Floats, Whole]:
    """Squares about each target's mean, summed, and their degrees of freedom, ``(N,)``."""
    there = ~np.isnan(values)
    squares = np.where(there, (values - _mean(values)) ** 2, 0.0).sum(0)
    return squares, np.maximum(there.sum(0) - 1, 0)


def radar_edges(scenes: Sequence[RadarScene]) -> dict[str, tuple[float, ...]]:
    """Edges of bins along each axis, of about as many targets each, common to all scenes.

    An axis along which all targets lie in one place has none.
    """
    found = {}
    for name in AXES:
        values = np.concatenate([scene.axes[name][scene.counted] for scene in scenes])
        low, high = float(values.min()), float(values.max())
        inner = np.unique(np.quantile(values, np.arange(1, BINS) / BINS))
        edges = [float(one) for one in inner if low < one < high]
        if edges:
            found[name] = (low, *edges, float(np.nextafter(high, np.inf)))
    classes = np.unique(np.concatenate([scene.axes["target_class"][scene.counted] for scene in scenes]))
    middles = 0.5 * (classes[1:] + classes[:-1])
    found["target_class"] = (float(classes[0]) - 0.5, *(float(one) for one in middles), float(classes[-1]) + 0.5)
    return found
