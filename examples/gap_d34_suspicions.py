"""Six things that D3.4 suspects or does, each hidden in a study as effects, searched for, and added.

    python examples/gap_d34_suspicions.py                              # all six
    python examples/gap_d34_suspicions.py --only filter extent
    python examples/gap_d34_suspicions.py --columns 256                # 16,384 beams instead of 8,192

    filter      5.2.2    the sensor filters isolated returns              in snow
    extinction  5.3.2    the extinction of fog is simulated too high      in fog
    extent      7.4.2    it rains in part of the space only               in rain
    sprinkler   7.4.2.1  sprinklers stand in the measured scene alone     in rain
    exposure    7.4.1.1  the camera exposes longer in rain than in clear  in rain, of a camera
    noise       6.1      noise grows in rain and the threshold does not   in rain, of a radar

D3.4's radar detects more in rain than in clear air, 535 to 543 instead of 340, as its noise is no receiver's: where
noise rises and the threshold does not, noise is detected.

The frames that stand for measured ones are made from the embedded scene, those of the radar from targets of all ranges
that this file draws and measures with a receiver of its own, so that the truth is known; the search is told
neither what is hidden nor where, and the weather record that it gets is off by a draw from its uncertainty of 10 %.
What it finds is fitted to three conditions and tested on a fourth. Every case gets the page that ``torchweather gap``
writes and a picture.
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import matplotlib
from parts.d34_figure import draw, table
from parts.d34_studies import camera_study, radar_study
from parts.shared import command_line

from torchweather.camera.effects.all import CameraExposureGain
from torchweather.gap import GapReport, find_gap
from torchweather.gap.study.hidden import WEATHERS, hidden_study
from torchweather.io import atomic_write
from torchweather.lidar.effects.all import (
    LidarExtinctionScale,
    LidarIsolatedReturnFilter,
    LidarLimitedExtent,
    LidarStaticStructure,
)
from torchweather.radar.effects.all import RadarCfarShift, RadarNoiseFloor
from torchweather.report.gap_page import write_gap
from torchweather.report.gap_words import verdict_sentence
from torchweather.stages import Effect


@dataclass(frozen=True)
class Suspicion:
    """What D3.4 suspects or does, as effects of the catalogue, and the weather in which they are hidden."""

    section: str
    words: str
    effects: tuple[Effect, ...]
    weather: str


NOISE_UP_DB = 4.0  # raises the number of detections by about half, as in D3.4
SUSPICIONS = {
    "filter": Suspicion(
        "5.2.2", "the sensor filters isolated returns", (LidarIsolatedReturnFilter(probability=0.7),), "snow"
    ),
    "extinction": Suspicion("5.3.2", "the extinction of fog is too high", (LidarExtinctionScale(factor=0.7),), "fog"),
    "extent": Suspicion("7.4.2", "it rains in part of the space only", (LidarLimitedExtent(extent_m=10.0),), "rain"),
    "sprinkler": Suspicion(
        # Half a metre wide, 30 degrees to the left: a sprinkler on its stand.
        "7.4.2.1",
        "a sprinkler stands in the rain",
        (LidarStaticStructure(azimuth_rad=0.52, range_m=8.0, width_rad=0.06),),
        "rain",
    ),
    "exposure": Suspicion("7.4.1.1", "the camera exposes longer in rain", (CameraExposureGain(factor=1.1),), "rain"),
    # The threshold stands still in power, and so comes nearer to the floor by as much as that rises.
    "noise": Suspicion(
        "6.1",
        "noise grows in rain, the threshold does not",
        (RadarNoiseFloor(shift_db=NOISE_UP_DB), RadarCfarShift(shift_db=-NOISE_UP_DB)),
        "rain",
    ),
}


def searched(suspicion: Suspicion, columns: int, seed: int, out: Path) -> tuple[GapReport, dict[str, Any]]:
    """The search's report and a row of the table; writes the page."""
    first = suspicion.effects[0]
    if first.id.startswith("camera."):
        hidden = camera_study(first, seed)
    elif first.id.startswith("radar."):
        hidden = radar_study(suspicion.effects, NOISE_UP_DB, seed)
    else:
        hidden = hidden_study(suspicion.effects, WEATHERS[suspicion.weather], columns=columns, seed=seed)
    report = find_gap(hidden.study)
    answer = write_gap(out, hidden.study, report)
    row = {
        "section": suspicion.section,
        "suspected": suspicion.words,
        "hidden": hidden.truth()["effects"],
        "verdict": answer["verdict"],
        "found": [{key: one[key] for key in ("name", "parameters", "interval")} for one in answer["effects"]],
        "gap": answer["gap"],
        "seconds": answer["seconds"],
    }
    return report, row


def main() -> None:
    parser = command_line(__doc__)
    parser.add_argument("--out", type=Path, default=Path("d34_suspicions"), help="folder for pages and pictures")
    parser.add_argument("--only", nargs="+", choices=list(SUSPICIONS), default=list(SUSPICIONS), help="cases")
    parser.add_argument("--columns", type=int, default=128, help="of the LiDAR's scan; of 64 rings each")
    parser.add_argument("--seed", type=int, default=0, help="of the studies")
    arguments = parser.parse_args()

    matplotlib.use("Agg")
    rows = []
    for name in arguments.only:
        suspicion = SUSPICIONS[name]
        report, row = searched(suspicion, arguments.columns, arguments.seed, arguments.out / name)
        draw(arguments.out / f"{name}.png", row, report)
        print(f"{suspicion.section} {suspicion.words}: {verdict_sentence(report.answer)}", flush=True)
        rows.append(row)
    with atomic_write(arguments.out / "suspicions.json") as unfinished:
        unfinished.write_text(json.dumps(rows, indent=1, allow_nan=False) + "\n", encoding="utf-8")
    print(f"\n{table(rows)}\n\npages and pictures: {arguments.out}")


if __name__ == "__main__":
    main()
