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

import sys
from pathlib import Path

from parts.shared import command_line, recordings
from parts.snow_study import study_of

from torchweather.explain import aligned
from torchweather.gap import GapReport, find_gap
from torchweather.gap.diagnosis import diagnose
from torchweather.report.gap_page import write_gap
from torchweather.report.gap_words import axis_name, parameter_rows, statistic_name

RATE_MM_PER_H, REL_SD = 0.5, 0.5  # melted; that the preset was made with, and known to nobody
SCANS = 4
READINGS = {"with intensities": "uint8_linear", "without intensities": "none"}


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
    parser = command_line(__doc__)
    parser.add_argument("--data", type=Path, help="folder with velodyne/*.bin and labels/*.label")
    parser.add_argument("--rates", type=float, nargs="+", default=[RATE_MM_PER_H], help="melted mm/h")
    parser.add_argument("--rel-sd", type=float, default=REL_SD, help="relative standard deviation of a rate")
    parser.add_argument("--scans", type=int, default=SCANS, help="into which a frame is divided")
    parser.add_argument("--out", type=Path, help="folder for the page of the first rate, read with intensities")
    arguments = parser.parse_args()
    folder = recordings(arguments.data, "wads_snow")
    if len(list((folder / "velodyne").glob("*.bin"))) < 2:
        sys.exit(f"{folder}: expected two frames or more in velodyne/*.bin, one to hold out")
    if arguments.scans < 2:
        parser.error(f"--scans: expected 2 or more; got {arguments.scans}")

    rows = [["mm/h", "read", "verdict", "times", "gap", "after", "floor", "departs most", "missing"]]
    for rate in arguments.rates:
        for reading, unit in READINGS.items():
            study = study_of(folder, rate, arguments.rel_sd, arguments.scans, unit)
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
