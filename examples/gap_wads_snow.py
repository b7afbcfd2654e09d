"""Ask the search for a missing effect what the snow model lacks, on real snow: three frames of WADS.

    TORCHWEATHER_REAL_DATA=/data python examples/gap_wads_snow.py          # /data/wads_snow
    python examples/gap_wads_snow.py --data sequences/36 --rates 0.25 0.5 1 --out page

WADS has no clear drive of its own. The clear twin of a frame is the frame without the points that are labelled falling
snow. The vehicle drives, so every frame is a scene of its own with one frame in snow and one twin; each is divided into
as many scans as ``--scans`` says, of every fourth column, which stand for repeated frames. The last frame is held out.
The snowfall is not known: ``--rates`` are tried, each uncertain by ``--rel-sd``. The recording has two echoes of a
beam, the last and the strongest other one; the nearer of them is the sensor's first. (Which is the stronger cannot be
told from intensities that are corrected for range.)

What that costs: a beam whose only echo was snow has no object in its twin, so nothing can be *lost* to snow; the scans
of a frame were taken in the same tenth of a second, so what differs from frame to frame is not seen; their beams are up
to 0.6 degrees apart, so edges count as noise; incidence angles are not known. Nothing is fitted beforehand and no
option is chosen by the answer. Read twice: with the recorded intensities, and without.
"""

from __future__ import annotations

import argparse
import os
import sys
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import torch
from lidar_snow_against_wads import Beams, beams_of_recording
from numpy.typing import NDArray
from torch import Tensor

import torchweather as tw
from torchweather.explain import aligned
from torchweather.gap import GapReport, Study, find_gap
from torchweather.gap.diagnosis import diagnose
from torchweather.gap.scan_grid import scan_frame
from torchweather.io import FALLING_SNOW, PointCloud, read_labels, read_points
from torchweather.report.gap_page import write_gap
from torchweather.report.gap_words import axis_name, parameter_rows, statistic_name
from torchweather.sensors import scan_directions

Frame = Mapping[str, NDArray[Any]]

SENSOR = "pandar64-wads"
RATE_MM_PER_H, REL_SD = 0.5, 0.5  # melted; that the preset was made with, and known to nobody
SCANS = 4
READINGS = {"with intensities": "uint8_linear", "without intensities": "none"}


def study_of(
    folder: Path, rate_mm_per_h: float, rel_sd: float, scans: int = SCANS, intensity_unit: str = "uint8_linear"
) -> Study:
    """Frames in ``velodyne/*.bin`` with ``labels/*.label`` as a study of the snow model.

    Args:
        folder: of the recording.
        rate_mm_per_h: melted.
        rel_sd: relative standard deviation of the rate.
        scans: into which the columns of a frame are divided, 2 or more.
        intensity_unit: of ``tw.Lidar``; ``none`` leaves intensities out.
    """
    whole = replace(tw.Lidar.preset(SENSOR), return_mode="first", intensity_unit=intensity_unit)
    assert whole.columns is not None
    paths = sorted((folder / "velodyne").glob("*.bin"))
    scenes, conditions = [], []
    for place, path in enumerate(paths):
        points = read_points(path, format="kitti").points
        snow = read_labels(folder / "labels" / f"{path.stem}.label", len(points)).classes == FALLING_SNOW
        beams, _, along = beams_of_recording(points, snow)
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


def said(report: GapReport) -> str:
    """Effects with parameters and intervals in a line."""
    parts = []
    for effect in report.answer["effects"]:
        rows = parameter_rows(effect)
        values = (f"{row['name']} {row['value']} {row['unit']}".strip() + f" ({row['interval']})" for row in rows)
        parts.append(f"{effect['name']}: {', '.join(values)}")
    return "; ".join(parts) or "nothing"


def departs(report: GapReport) -> str:
    """The statistic that departs most, before anything is added."""
    worst = report.answer["where"][:1]
    return "; ".join(f"{statistic_name(one['statistic'])} by {axis_name(one['axis'])}" for one in worst)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", type=Path, help="folder with velodyne/*.bin and labels/*.label")
    parser.add_argument("--rates", type=float, nargs="+", default=[RATE_MM_PER_H], help="melted mm/h")
    parser.add_argument("--rel-sd", type=float, default=REL_SD, help="relative standard deviation of a rate")
    parser.add_argument("--scans", type=int, default=SCANS, help="into which a frame is divided")
    parser.add_argument("--out", type=Path, help="folder for the page of the first rate, read with intensities")
    arguments = parser.parse_args()
    if arguments.data is None:
        root = os.environ.get("TORCHWEATHER_REAL_DATA")
        if not root:
            sys.exit("no recording: give --data FOLDER, or set TORCHWEATHER_REAL_DATA to a folder with wads_snow/")
        arguments.data = Path(root) / "wads_snow"
    if len(list((arguments.data / "velodyne").glob("*.bin"))) < 2:
        sys.exit(f"{arguments.data}: wanted two frames or more in velodyne/*.bin, one to hold out")
    if arguments.scans < 2:
        parser.error(f"--scans: wanted 2 or more; got {arguments.scans}")

    rows = [["mm/h", "read", "verdict", "times", "gap", "after", "floor", "departs most", "missing"]]
    for rate in arguments.rates:
        for reading, unit in READINGS.items():
            study = study_of(arguments.data, rate, arguments.rel_sd, arguments.scans, unit)
            if len(rows) == 1:
                print("What this study lacks:")
                print("\n".join(f"- {finding}" for finding in dict.fromkeys(map(str, diagnose(study)))), flush=True)
            report = find_gap(study)
            if len(rows) == 1 and arguments.out is not None:
                write_gap(arguments.out, study, report)
            gap = report.answer["gap"]
            factor = report.answer["nuisance"].get("rate_factor", float("nan"))
            numbers = [f"{gap[key]:.2f}" for key in ("before", "after", "floor")]
            named = [departs(report), said(report)]
            rows.append([f"{rate:g}", reading, report.verdict, f"{factor:.2f}", *numbers, *named])
            print(f"{rate:g} mm/h, {reading}: {report.verdict}, {said(report)}", flush=True)
    print("\n" + "\n".join(aligned(rows)))
    print("\ntimes: the rate that is fitted, over the one that is tried; gap: of the last frame, in scatters")


if __name__ == "__main__":
    main()
