"""Fit the visibility to photographs of a highway camera in fog, beside the value of a visibility meter.

    TORCHWEATHER_REAL_DATA=/data python examples/fog_on_a_highway.py            # /data/roadcam_fog
    python examples/fog_on_a_highway.py --data roadcam_fog --out found --study 20200222

The folder holds ``frames/DATE/*.jpg`` of one fixed view and ``visibility/Vis-DD-Feb-2020.mat``, the meter's metres for
each frame. Depth of the road comes from lane marks and horizon. Frames below 1 km are fitted in blocks of about eight;
clear frames are those above 5 km of the same morning. Estimators stand side by side: those of ``tw.fit_weather``, and
``local_contrast`` (lane marks and seams against their surroundings, frame by frame). The estimator is chosen on the
days 1 to 15 of the month and reported on the others, which were not looked at before.

Writes ``highway.json`` (fits, brightness by depth as recorded and as simulated) and ``highway.png`` (curves alone).
``--pictures`` adds ``recorded-and-simulated.png`` with frames: for your own eyes, since the recording has no licence.
``--study DATE`` writes that morning as a study folder, for ``torchweather gap`` and ``torchweather validate``.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from parts.highway_figures import draw_curves, draw_frames
from parts.road_camera import Block, Morning, blocks, light_of, local_extinction, mornings, study_of
from parts.shared import command_line, recordings, write_json
from scipy import stats

import torchweather as tw
from torchweather.gap.study.simulation import simulate
from torchweather.gap.study.study import Study
from torchweather.physics.visibility import mor_from_extinction

LAST_CHOOSING_DAY = 15
LOCAL = "local_contrast"
MOST_CLEAR = 16
NO_ANSWER = math.log(10.0)  # for an estimate without limit, as if it were off by a factor of ten
EDGES_M = (8.0, 10.0, 13.0, 17.0, 22.0, 28.0, 36.0, 46.0, 60.0, 80.0, 110.0)
GREEN = 1

Array = NDArray[np.float64]


def by_local_contrast(block: Block, frames: Mapping[int, Array], clear: Sequence[Array], shrink: int) -> list[float]:
    """Visibility with a central 90 % interval by Student's t over the frames' extinctions."""
    green = [frames[place][GREEN] for place in block.places]
    found = local_extinction(green, [light[GREEN] for light in clear], shrink)
    found = found[np.isfinite(found)]
    if len(found) < 2:
        return [math.nan] * 3
    middle = float(np.mean(found))
    reach = float(stats.t.ppf(0.95, len(found) - 1) * np.std(found, ddof=1) / math.sqrt(len(found)))
    low, value, high = (
        float(mor_from_extinction(each)) if each > 0 else math.inf for each in (middle + reach, middle, middle - reach)
    )
    return [value, low, high]


def brightness(study: Study, seed: int) -> dict[str, Any]:
    """Brightness of the road in fog over that in clear air, by depth: recorded, and simulated at the meter's value."""
    scene = next(iter(study.scenes.values()))
    road, depth = np.asarray(scene.geometry["mask"]) == 0, np.asarray(scene.geometry["depth_m"])
    cells = [road & (depth >= low) & (depth < high) for low, high in pairwise(EDGES_M)]
    clear = np.mean([scene.clear[k]["bayer"] for k in range(len(scene.clear))], axis=0)
    found: dict[str, Any] = {}
    for condition in study.conditions:
        recorded = np.mean([frame["bayer"] for frame in condition.frames], axis=0)
        simulated = np.mean([simulate(study, condition, seed=seed, number=k)["bayer"] for k in range(4)], axis=0)
        found[condition.id] = {
            name: [float(frame[cell].mean() / clear[cell].mean()) for cell in cells]
            for name, frame in (("recorded", recorded), ("simulated", simulated))
        }
    return found


def fit_morning(morning: Morning, shrink: int, bootstrap: int, seed: int) -> tuple[list[dict[str, Any]], Any, Study]:
    """Estimates of every block, brightness by depth, and the study of the morning."""
    fog = blocks(morning)
    frames = {place: light_of(morning.paths[place], shrink) for block in fog for place in block.places}
    kept = np.unique(np.linspace(0, len(morning.clear) - 1, MOST_CLEAR).round().astype(int))
    clear = [light_of(morning.paths[morning.clear[place]], shrink) for place in kept]
    study = study_of(morning, fog, frames, clear, shrink)
    fitted = tw.fit_weather(study, bootstrap=bootstrap, seed=seed)
    rows = []
    for block, condition in zip(fog, fitted.conditions, strict=True):
        estimates = {
            each.name: [each.intensity.value, each.intensity.low, each.intensity.high] for each in condition.estimates
        }
        estimates[LOCAL] = by_local_contrast(block, frames, clear, shrink)
        gains = {each.name: each.others["exposure_gain"].value for each in condition.estimates}
        row: dict[str, Any] = {"block": block.name, "frames": len(block.places), "meter_m": block.meter_m}
        rows.append({**row, "fits": estimates, "exposure_gain": gains})
    return rows, brightness(study, seed), study


def distance(rows: Sequence[Mapping[str, Any]], name: str) -> float:
    """Median of the logarithms by which an estimator's ratios miss 1."""
    missed = []
    for row in rows:
        value = row["fits"].get(name, [math.nan])[0] / row["meter_m"]
        missed.append(min(abs(math.log(value)), NO_ANSWER) if 0 < value < math.inf else NO_ANSWER)
    return float(np.median(missed))


def as_text(fit: Sequence[float], meter_m: float) -> str:
    value, low, high = (each / meter_m for each in fit)
    return f"{value:.2f} ({low:.2f} to {high:.2f})"


def main() -> None:
    parser = command_line(__doc__)
    parser.add_argument("--data", type=Path, help="folder with frames/ and visibility/")
    parser.add_argument("--out", type=Path, default=Path("highway"), help="folder to write to")
    parser.add_argument("--shrink", type=int, default=2, help="means of so many pixels each way")
    parser.add_argument("--every", type=int, default=1, help="use every Nth frame")
    parser.add_argument("--bootstrap", type=int, default=200, help="samples of the frames")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--study", metavar="DATE", help="write this morning as a study folder")
    parser.add_argument("--pictures", action="store_true", help="write frames, recorded and simulated")
    arguments = parser.parse_args()
    arguments.out.mkdir(parents=True, exist_ok=True)

    rows: list[dict[str, Any]] = []
    curves: dict[str, Any] = {}
    left_out = {}
    for morning in mornings(recordings(arguments.data, "roadcam_fog"), arguments.every):
        if len(morning.clear) < 2 or not blocks(morning):
            left_out[morning.name] = "fewer than 2 clear frames" if len(morning.clear) < 2 else "no fog below 1 km"
            continue
        found, curve, study = fit_morning(morning, arguments.shrink, arguments.bootstrap, arguments.seed)
        rows += [row | {"chosen_on": morning.day <= LAST_CHOOSING_DAY} for row in found]
        curves |= curve
        if arguments.study == morning.name:
            study.write(arguments.out / f"study-{morning.name}")
        if arguments.pictures:
            draw_frames(study, arguments.out / f"{morning.name}-recorded-and-simulated.png", arguments.seed)
    choosing = [row for row in rows if row["chosen_on"]]
    names = list(dict.fromkeys(name for row in rows for name in row["fits"]))
    missed = {name: distance(choosing, name) for name in names} if choosing else {}
    chosen = min(missed, key=missed.__getitem__) if missed else None
    report = {
        "torchweather": tw.__version__,
        "chosen": chosen,
        "typical_factor_on_choosing_days": {name: math.exp(value) for name, value in missed.items()},
        "blocks": rows,
        "depth_edges_m": EDGES_M,
        "brightness_over_clear": curves,
        "left_out": left_out,
    }
    write_json(arguments.out / "highway.json", report)
    draw_curves(report, arguments.out / "highway.png")

    print(f"{'block':<14} frames  meter m  " + "".join(f"{name:<24}" for name in names))
    for row in rows:
        fits = "".join(f"{as_text(row['fits'][name], row['meter_m']):<24}" for name in names)
        print(f"{row['block']:<14} {row['frames']:6d} {row['meter_m']:8.0f}  {fits}")
    for name, why in left_out.items():
        print(f"{name}: left out: {why}")
    for name in missed:
        print(f"{name}: off by a factor of {math.exp(missed[name]):.2f} on the days up to {LAST_CHOOSING_DAY} (median)")
    others = [row for row in rows if not row["chosen_on"]]
    if chosen and others:
        factor = math.exp(distance(others, chosen))
        print(f"chosen there: {chosen}; off by a factor of {factor:.2f} on the other days (median)")
    print(f"written: {arguments.out}/highway.json, highway.png")


if __name__ == "__main__":
    main()
