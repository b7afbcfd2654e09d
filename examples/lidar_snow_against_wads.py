"""Hold simulated snow against the labelled falling snow of WADS, beam by beam.

    TORCHWEATHER_REAL_DATA=/data python examples/lidar_snow_against_wads.py     # /data/wads_snow
    python examples/lidar_snow_against_wads.py --data sequences/36 --out compared --rates 0.5 1 2

A frame is taken apart into beams, its snow points are removed, and snow is simulated into what is left, with the same
directions: what the beam saw behind the flake where the recording has it, else nothing. Both are then described by the
same numbers. Nothing is fitted. Writes ``wads.md``, ``wads.json`` and ``wads.png``, and two views of the first frame
and of the same frame in simulated snow: ``wads_side.png`` from the side, ``wads_angles.png`` by azimuth and elevation.

The recording sensor stores two echoes of every beam: the last, and the strongest or, where that is the last, the second
strongest (Hesai, Pandar64 user manual, section 3.1.2.2). ``return_mode="dual"`` gives the last and the strongest alone,
so a flake that is fainter than the object behind it is missing. `LastAndOther` is the recording sensor's rule as a
stage; the tables have both.

A third sensor stands beside the two presets to show what would have to be otherwise: the range at 10 % of the data
sheet (200 m, from memory, unverified) and flakes fainter by the square of 200 m over the 30 m of `pandar64-wads`, so
that a flake alone in its beam is seen as often as before. It is an assumption, not a preset.
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

from parts.shared import command_line, recordings, write_json
from parts.snow_beams import beams_of_recording, joined, read_frame
from parts.snow_echoes import RULES, cases, simulated
from parts.snow_figures import draw, write_views
from parts.snow_tables import ELEVATION_EDGES_DEG, RANGE_EDGES_M, statistics, table

import torchweather as tw
from torchweather.io import atomic_write

RATES_MM_PER_H = (0.25, 0.5, 1.0, 2.0, 3.0)


def main() -> None:
    parser = command_line(__doc__)
    parser.add_argument("--data", type=Path, help="folder with velodyne/*.bin and labels/*.label")
    parser.add_argument("--out", type=Path, default=Path("wads"), help="folder to write to")
    parser.add_argument("--rates", type=float, nargs="+", default=list(RATES_MM_PER_H), help="melted mm/h")
    parser.add_argument("--seed", type=int, default=1)
    arguments = parser.parse_args()
    folder = recordings(arguments.data, "wads_snow")
    clouds = sorted((folder / "velodyne").glob("*.bin"))
    if not clouds:
        sys.exit(f"{folder}: holds no velodyne/*.bin")
    rates = sorted(arguments.rates)

    frames = [beams_of_recording(*read_frame(path)) for path in clouds]
    recorded = joined([beams for beams, _, _ in frames])
    found = statistics(recorded)
    each = {path.stem: statistics(beams) for path, (beams, _, _) in zip(clouds, frames, strict=True)}
    print(f"{len(frames)} frames, {len(recorded.object_m)} directions")

    runs: dict[tuple[str, str, float], dict[str, Any]] = {}
    floored: dict[str, float] = {}
    for case in cases():
        seen = sum(int((cloud[:, :3] != 0).any(1).sum()) for _, cloud, _ in frames)
        dry = tw.LidarSnow(tw.Snow(rate_mm_per_h=0), case.sensor)
        floored[case.name] = (
            sum(int(dry.run(cloud, directions=along).floored_points) for _, cloud, along in frames) / seen
        )
        for rate in rates:
            # One seed for each frame: the same storm for every sensor and rate.
            drawn = [
                simulated(cloud, along, case, rate, arguments.seed + k) for k, (_, cloud, along) in enumerate(frames)
            ]
            for rule, beams in zip(RULES, zip(*drawn, strict=True), strict=True):
                runs[case.name, rule, rate] = statistics(joined(beams))

    arguments.out.mkdir(parents=True, exist_ok=True)
    text = ""
    for case in cases():
        text += f"\n## {case.name}\n\nObjects whose intensity says less than the threshold: {floored[case.name]:.1%}.\n"
        for rule in RULES:
            text += f"\n### Reported: {rule}\n\n"
            text += table(found, {rate: runs[case.name, rule, rate] for rate in rates}) + "\n"
    with atomic_write(arguments.out / "wads.md") as unfinished:
        unfinished.write_text(text.lstrip(), encoding="utf-8")
    report = {
        "torchweather": tw.__version__,
        "seed": arguments.seed,
        "range edges, m": RANGE_EDGES_M,
        "elevation edges, degrees": ELEVATION_EDGES_DEG,
        "recorded": found,
        "recorded, each frame": each,
        "objects below the threshold": floored,
        "simulated": [
            {"sensor": name, "reported": rule, "rate_mm_per_h": rate} | values
            for (name, rule, rate), values in runs.items()
        ],
    }
    write_json(arguments.out / "wads.json", _rounded(report))
    draw(found, runs, arguments.out / "wads.png")
    write_views(*read_frame(clouds[0]), arguments.out, arguments.seed)
    print(text)
    print(f"written: {arguments.out}/wads.md, wads.json, wads.png, wads_side.png, wads_angles.png")


def _rounded(value: Any) -> Any:
    if isinstance(value, float):
        return round(value, 5)
    if isinstance(value, dict):
        return {key: _rounded(one) for key, one in value.items()}
    return [_rounded(one) for one in value] if isinstance(value, (list, tuple)) else value


if __name__ == "__main__":
    main()
