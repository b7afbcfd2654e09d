"""Frames of WADS as a study of the search for missing effects: each a scene, divided into scans."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import torch
from numpy.typing import NDArray
from parts.snow_beams import SCANNER, Beams, beams_of_recording, read_frame
from torch import Tensor

import torchweather as tw
from torchweather.gap import Study
from torchweather.gap.study.scan_grid import scan_frame
from torchweather.io import PointCloud
from torchweather.sensors import scan_directions

Frame = Mapping[str, NDArray[Any]]


def study_of(folder: Path, rate_mm_per_h: float, rel_sd: float, scans: int, intensity_unit: str) -> Study:
    """Frames in ``velodyne/*.bin`` with ``labels/*.label`` as a study of the snow model.

    Args:
        folder: of the recording.
        rate_mm_per_h: melted.
        rel_sd: relative standard deviation of the rate.
        scans: into which the columns of a frame are divided, 2 or more.
        intensity_unit: of ``tw.Lidar``; ``none`` leaves intensities out.
    """
    whole = replace(tw.Lidar.preset(SCANNER), return_mode="first", intensity_unit=intensity_unit)
    assert whole.columns is not None
    paths = sorted((folder / "velodyne").glob("*.bin"))
    scenes, conditions = [], []
    for place, path in enumerate(paths):
        beams, _, along = beams_of_recording(*read_frame(path))
        measured, clear = (
            scan_frame(first_echoes(beams, along, which), whole, path.stem)[0] for which in (True, False)
        )
        scenes.append({"id": f"scene-{path.stem}", "clear": divided(clear, scans)})
        conditions.append(
            {
                "id": path.stem,
                "scene": f"scene-{path.stem}",
                "weather": {"kind": "snow", "rate_mm_per_h": rate_mm_per_h, "rate_rel_sd": rel_sd},
                "frames": divided(measured, scans),
                "split": "holdout" if place == len(paths) - 1 else "fit",
            }
        )
    columns = whole.columns // scans
    direction = scan_directions(whole).reshape(-1, whole.columns, 3)[:, : scans * columns : scans]
    return Study.from_arrays(
        sensor=replace(whole, columns=columns),
        beams={"direction": direction.numpy()},
        scenes=scenes,
        conditions=conditions,
    )


def first_echoes(beams: Beams, along: Tensor, with_snow: bool) -> PointCloud:
    """The nearest echo of each beam, of all or of those that are no snow."""
    there = (beams.range_m > 0) & (with_snow | ~beams.snow)
    range_m, which = torch.where(there, beams.range_m, torch.inf).min(1)
    intensity = beams.intensity.gather(1, which[:, None])
    seen = there.any(1)
    points = torch.cat([along * range_m[:, None], intensity], 1)[seen]
    return PointCloud(points.float(), ("x", "y", "z", "intensity"))


def divided(frame: Frame, scans: int) -> list[dict[str, NDArray[Any]]]:
    """Scans of every so many columns each."""
    columns = next(iter(frame.values())).shape[1] // scans * scans
    return [{key: values[:, start:columns:scans].copy() for key, values in frame.items()} for start in range(scans)]
