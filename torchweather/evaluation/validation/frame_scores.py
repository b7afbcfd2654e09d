"""Scores of a frame against a clear one, for each kind of sensor."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from torchweather.camera.sensor import Camera
from torchweather.core.errors import check_one_of
from torchweather.gap.study.study import Frame, Study
from torchweather.metrics.bayer import bayer_scores
from torchweather.metrics.cloud_scores import CLOUD_SCORES, cloud_scores
from torchweather.metrics.image_scores import IMAGE_SCORES

__all__ = ["FrameScores", "ScoreMeaning", "frame_scores", "lidar_points", "radar_points"]

Array = NDArray[Any]


@dataclass(frozen=True)
class ScoreMeaning:
    """Reading of a score.

    Args:
        higher_is_better: nearer to the clear frame where higher.
        unit: empty for a plain number.
        says: what it is, in words; empty for the scores of D3.4's tables.
        called: in a sentence; empty: by its name.
    """

    higher_is_better: bool
    unit: str = ""
    says: str = ""
    called: str = ""


Meanings = dict[str, ScoreMeaning]
CLOUD = {name: ScoreMeaning(higher_is_better=False, unit="" if name == "sdm" else "m") for name in CLOUD_SCORES}
POWER = {
    "power_change_db": ScoreMeaning(True, "dB", "median change of power of the targets that both frames detect"),
    "power_rmse_db": ScoreMeaning(False, "dB", "root mean square change of their power"),
    "detected_share": ScoreMeaning(True, "", "detected targets, over those of the clear frame"),
}
IMAGE = {
    name: ScoreMeaning(facts.higher_is_better, "dB" if name == "psnr" else "") for name, facts in IMAGE_SCORES.items()
}
KNOWN: dict[str, Meanings] = {"lidar": CLOUD, "camera": IMAGE, "radar": {**POWER, **CLOUD}}
"""Scores by the kind of a study."""


@dataclass(frozen=True)
class FrameScores:
    """The scores that a study's frames get.

    Args:
        meanings: by name, in order.
        left_out: name to the reason why these frames cannot have the score.
        score: of a frame and a clear frame, with the geometry of their scene, ``{name: score}``.
    """

    meanings: Meanings
    left_out: dict[str, str]
    score: Callable[[Frame, Frame, Frame], dict[str, float]]


def frame_scores(study: Study, names: Sequence[str] | None = None) -> FrameScores:
    """The scores of the frames of a study.

    Args:
        study: of kind ``lidar`` (scores of point clouds), ``camera`` (scores of images, of the demosaiced frames in
            sRGB) or ``radar`` (changes of power, and scores of point clouds of the detections).
        names: which; ``None``: all that the frames are large enough for.
    """
    check_one_of("kind", study.kind, KNOWN, owner="frame_scores")
    known = KNOWN[study.kind]
    for name in names or ():
        check_one_of("score", name, known, owner="frame_scores")
    chosen = {name: known[name] for name in (known if names is None else dict.fromkeys(names))}
    found = SCORES[study.kind](study, chosen)

    def score(frame: Frame, clear: Frame, geometry: Frame) -> dict[str, float]:
        return found.score(*_unmasked(study.kind, frame, clear, geometry), geometry)

    return replace(found, score=score)


def _unmasked(kind: str, frame: Frame, clear: Frame, geometry: Frame) -> tuple[Frame, Frame]:
    """Both frames without what the scene's mask leaves out: pixels are alike in both, beams and targets are gone."""
    if "mask" not in geometry:
        return frame, clear
    mask, (key, gone) = np.asarray(geometry["mask"]) != 0, GONE[kind]
    filled = clear[key] if gone is None else gone
    return (
        {**frame, key: np.where(mask, filled, frame[key])},
        {**clear, key: np.where(mask, filled, clear[key])},
    )


def _of_images(study: Study, chosen: Meanings) -> FrameScores:
    camera = Camera.of(study.sensor)
    side = min(camera.width, camera.height)
    left_out = {
        name: f"it takes {IMAGE_SCORES[name].minimum} pixels a side; these frames have {side}"
        for name in chosen
        if IMAGE_SCORES[name].minimum > side
    }
    scored = {name: meaning for name, meaning in chosen.items() if name not in left_out}

    def score(frame: Frame, clear: Frame, geometry: Frame) -> dict[str, float]:
        first, second = (torch.from_numpy(np.array(each["bayer"], dtype=np.float32))[None] for each in (frame, clear))
        with torch.no_grad():
            found = bayer_scores(first, second, scored, pattern=camera.bayer_pattern)
        return {name: float(value) for name, value in found.items()}

    return FrameScores(scored, left_out, score)


def _of_scans(study: Study, chosen: Meanings) -> FrameScores:
    direction = study.beams["direction"]

    def score(frame: Frame, clear: Frame, geometry: Frame) -> dict[str, float]:
        return _cloud(lidar_points(frame, direction), lidar_points(clear, direction), chosen)

    return FrameScores(chosen, {}, score)


def _of_detections(study: Study, chosen: Meanings) -> FrameScores:
    def score(frame: Frame, clear: Frame, geometry: Frame) -> dict[str, float]:
        found = _powers(np.asarray(frame["power_db"]), np.asarray(clear["power_db"]))
        if in_space := [name for name in chosen if name in CLOUD]:
            found |= _cloud(radar_points(frame, geometry), radar_points(clear, geometry), in_space)
        return {name: found[name] for name in chosen}

    return FrameScores(chosen, {}, score)


# Array of a frame and its value where there is nothing; of a camera the clear frame's own.
GONE: dict[str, tuple[str, float | None]] = {
    "camera": ("bayer", None),
    "lidar": ("range_m", 0.0),
    "radar": ("power_db", math.nan),
}
SCORES = {"camera": _of_images, "lidar": _of_scans, "radar": _of_detections}


def _cloud(points: Tensor, clear: Tensor, names: Iterable[str]) -> dict[str, float]:
    return {name: float(value) for name, value in cloud_scores(points, clear, names=list(names)).items()}


def lidar_points(frame: Frame, direction: Array) -> Tensor:
    """Returns of a scan ``(N, 3)``, metres.

    Args:
        frame: ``range_m (H, W)``, 0 where no return.
        direction: ``(H, W, 3)`` unit vectors.
    """
    range_m = np.asarray(frame["range_m"], dtype=np.float32)
    seen = range_m > 0
    return torch.from_numpy(range_m[seen][:, None] * np.asarray(direction, dtype=np.float32)[seen])


def radar_points(frame: Frame, geometry: Frame) -> Tensor:
    """Detections of targets ``(N, 3)``, metres: the measured range in the target's own direction.

    Args:
        frame: ``power_db (N,)``, NaN where not detected; ``range_m (N,)`` as measured.
        geometry: ``azimuth_rad``, ``elevation_rad (N,)``.
    """
    seen = np.isfinite(frame["power_db"])
    azimuth = np.asarray(geometry["azimuth_rad"], dtype=np.float64)[seen]
    elevation = np.asarray(geometry["elevation_rad"], dtype=np.float64)[seen]
    flat = np.cos(elevation)
    towards = np.stack([flat * np.cos(azimuth), flat * np.sin(azimuth), np.sin(elevation)], -1)
    return torch.from_numpy(np.asarray(frame["range_m"], dtype=np.float64)[seen][:, None] * towards)


def _powers(power_db: Array, clear_db: Array) -> dict[str, float]:
    """Scores of the powers of targets; without a target in both, their change is not a number.

    The median, because some targets fluctuate by several dB from frame to frame (trees, people) and others do not.
    """
    both = np.isfinite(power_db) & np.isfinite(clear_db)
    change = power_db[both] - clear_db[both]
    before = int(np.isfinite(clear_db).sum())
    return {
        "power_change_db": float(np.median(change)) if len(change) else math.nan,
        "power_rmse_db": float(np.sqrt(np.square(change).mean())) if len(change) else math.nan,
        "detected_share": int(np.isfinite(power_db).sum()) / before if before else math.nan,
    }
