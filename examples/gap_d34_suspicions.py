"""Five effects that D3.4 suspects behind its results, each hidden in a study, searched for, and added.

    python examples/gap_d34_suspicions.py                              # all five
    python examples/gap_d34_suspicions.py --only filter extent
    python examples/gap_d34_suspicions.py --columns 256                # 16,384 beams instead of 8,192

    filter      5.2.2    the sensor filters isolated returns              in snow
    extinction  5.3.2    the extinction of fog is simulated too high      in fog
    extent      7.4.2    it rains in part of the space only               in rain
    sprinkler   7.4.2.1  sprinklers stand in the measured scene alone     in rain
    exposure    7.4.1.1  the camera exposes longer in rain than in clear  in rain, of a camera

The frames that stand for measured ones are made from the embedded scene, so that the truth is known; the search is told
neither what is hidden nor where, and the weather record that it gets is off by a draw from its uncertainty of 10 %.
What it finds is fitted to three conditions and tested on a fourth. Every case gets the page that ``torchweather gap``
writes and a picture.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import matplotlib
import numpy as np
from numpy.typing import NDArray

import torchweather as tw
from torchweather.explain import aligned
from torchweather.gap import GapReport, Study, find_gap
from torchweather.gap.hidden_study import WEATHERS, HiddenStudy, hidden_study
from torchweather.io import atomic_write
from torchweather.report.gap_page import write_gap
from torchweather.report.gap_words import (
    axis_name,
    edge_text,
    effect_name,
    parameter_rows,
    statistic_name,
    verdict_sentence,
)
from torchweather.scenes import SCENES
from torchweather.stages import Effect
from torchweather.stages.effects_camera import CameraExposureGain
from torchweather.stages.effects_lidar import (
    LidarExtinctionScale,
    LidarIsolatedReturnFilter,
    LidarLimitedExtent,
    LidarStaticStructure,
)

BEFORE, AFTER = "#e03131", "#1c7ed6"
TICKS = (-300, -100, -30, -10, -3, 0, 3, 10, 30, 100, 300)  # of departures, in scatters


@dataclass(frozen=True)
class Suspicion:
    """What D3.4 suspects, as an effect of the catalogue, and the weather in which it is hidden."""

    section: str
    words: str
    effect: Effect
    weather: str


SUSPICIONS = {
    "filter": Suspicion(
        "5.2.2", "the sensor filters isolated returns", LidarIsolatedReturnFilter(probability=0.7), "snow"
    ),
    "extinction": Suspicion("5.3.2", "the extinction of fog is too high", LidarExtinctionScale(factor=0.7), "fog"),
    "extent": Suspicion("7.4.2", "it rains in part of the space only", LidarLimitedExtent(extent_m=10.0), "rain"),
    "sprinkler": Suspicion(
        # Half a metre wide, 30 degrees to the left: a sprinkler on its stand.
        "7.4.2.1",
        "a sprinkler stands in the rain",
        LidarStaticStructure(azimuth_rad=0.52, range_m=8.0, width_rad=0.06),
        "rain",
    ),
    "exposure": Suspicion("7.4.1.1", "the camera exposes longer in rain", CameraExposureGain(factor=1.1), "rain"),
}
# Of the camera's study: a small frame, and the electrons of a saturated pixel and of its readout (orders of magnitude).
CAMERA_PX = (240, 180)
FULL_WELL_ELECTRONS, READ_ELECTRONS = 10_000.0, 5.0
CLEAR_FRAMES, FRAMES, REL_SD = 8, 5, 0.1
RATES_MM_PER_H = {10.0: "fit", 25.0: "fit", 40.0: "holdout", 60.0: "fit"}


def searched(suspicion: Suspicion, columns: int, seed: int, out: Path) -> tuple[GapReport, dict[str, Any]]:
    """The search's report and a row of the table; writes the page."""
    if suspicion.effect.id.startswith("camera."):
        hidden = camera_study(suspicion.effect, seed)
    else:
        hidden = hidden_study([suspicion.effect], WEATHERS[suspicion.weather], columns=columns, seed=seed)
    report = find_gap(hidden.study)
    answer = write_gap(out, hidden.study, report)
    row = {
        "section": suspicion.section,
        "suspected": suspicion.words,
        "hidden": hidden.truth()["effects"][0],
        "verdict": answer["verdict"],
        "found": [{key: one[key] for key in ("name", "parameters", "interval")} for one in answer["effects"]],
        "gap": answer["gap"],
        "seconds": answer["seconds"],
    }
    return report, row


def camera_study(effect: Effect, seed: int) -> HiddenStudy:
    """Raw frames of the test track in rain, with an effect in the weather frames; shot and readout noise come last."""
    rng = np.random.default_rng(seed)
    camera = replace(tw.Camera.preset("lucid-triton").resized(*CAMERA_PX), response_knots=None)
    view = SCENES["test-track"]().view(camera)

    def noisy(bayer: NDArray[Any]) -> dict[str, NDArray[Any]]:
        electrons = rng.poisson(bayer * FULL_WELL_ELECTRONS) + READ_ELECTRONS * rng.standard_normal(bayer.shape)
        return {"bayer": np.clip(electrons / FULL_WELL_ELECTRONS, 0.0, 1.0).astype(np.float32)}

    geometry = {"depth_m": view.depth_m[0].numpy(), "normal": view.normal.movedim(0, -1).numpy()}
    clear = [noisy(view.bayer[0].numpy()) for _ in range(CLEAR_FRAMES)]
    conditions, factors = [], {}
    for rate, split in RATES_MM_PER_H.items():
        name = f"rain-{rate:g}"
        factors[name] = float(np.exp(REL_SD * rng.standard_normal()))
        rain = tw.BayerRain(tw.Rain(rate * factors[name]), camera, effects=[effect])
        seeds = rng.integers(2**62, size=FRAMES)
        made = [rain(view.bayer, view.depth_m, rain.draw(view.bayer, seed=int(one)))[0].numpy() for one in seeds]
        weather = {"kind": "rain", "rate_mm_per_h": rate, "rate_rel_sd": REL_SD}
        frames = [noisy(one) for one in made]
        conditions.append({"id": name, "scene": "test-track", "weather": weather, "frames": frames, "split": split})
    study = Study.from_arrays(
        sensor=camera,
        scenes=[{"id": "test-track", "clear": clear, "geometry": geometry}],
        conditions=conditions,
    )
    return HiddenStudy(study, (effect,), factors)


def table(rows: Sequence[Mapping[str, Any]]) -> str:
    """Hidden and found, parameter by parameter, and the held-out gap."""
    lines = [["D3.4", "hidden", "found", "90 % interval", "held-out gap", "floor"]]
    for row in rows:
        gap = row["gap"]
        shrunk = [f"{gap['before']:.2f} -> {gap['after']:.2f}", f"{gap['floor']:.2f}"]
        hidden = _texts(row["hidden"])
        found = {name: text for one in row["found"] for name, text in _texts(one).items()}
        for place, name in enumerate(dict.fromkeys([*hidden, *found])):
            first = place == 0
            value, interval = found.get(name, (row["verdict"] if first and not found else "-", ""))
            wanted = f"{name} {hidden[name][0]}" if name in hidden else f"(not {name})"
            lines.append([row["section"] if first else "", wanted, value, interval, *(shrunk if first else ["", ""])])
    return "\n".join(aligned(lines))


def _texts(effect: Mapping[str, Any]) -> dict[str, tuple[str, str]]:
    """``effect.parameter`` to its value with unit, and its interval."""
    return {
        f"{effect['name']}.{row['name']}": (f"{row['value']} {row['unit']}".strip(), row["interval"])
        for row in parameter_rows({"interval": {}, **effect})
    }


def draw(path: Path, row: Mapping[str, Any], report: GapReport) -> None:
    """The statistic that departs most, before and after, and the held-out gap beside its floor."""
    from matplotlib.figure import Figure

    first = report.curves[0]
    shown = [one for one in report.curves if (one.statistic, one.axis) == (first.statistic, first.axis)]
    figure = Figure(figsize=(10.5, 4.5), layout="constrained")
    left, right = figure.subplots(1, 2, width_ratios=(2.2, 1.0))
    bins = np.arange(len(first.edges) - 1)
    left.axhspan(-1, 1, color="0.88", label="scatter of the simulation")
    for number, curve in enumerate(shown):
        label = {"before": "before", "after": "after"} if number == 0 else {"before": None, "after": None}
        left.plot(bins, curve.before, "o-", color=BEFORE, markersize=4, linewidth=1, label=label["before"])
        if curve.after is not None:
            hollow: dict[str, Any] = {"markerfacecolor": "white", "markersize": 4, "linewidth": 1}
            left.plot(bins, curve.after, "s-", color=AFTER, label=label["after"], **hollow)
    left.set_yscale("symlog", linthresh=3.0, linscale=0.6)
    left.set_yticks([y for y in TICKS if left.get_ylim()[0] <= y <= left.get_ylim()[1]], minor=False)
    left.yaxis.set_major_formatter("{x:g}")
    left.minorticks_off()
    every = -(-len(first.edges) // 12)
    left.set_xticks(
        (np.arange(len(first.edges)) - 0.5)[::every], [edge_text(first.axis, x) for x in first.edges][::every]
    )
    left.set(
        title=f"{statistic_name(first.statistic)}, {len(shown)} conditions",
        xlabel=axis_name(first.axis),
        ylabel="measured − simulated, scatters",
    )
    left.grid(axis="y", alpha=0.3)
    left.legend(fontsize=9)
    gap = row["gap"]
    right.bar(["before", "after"], [gap["before"], gap["after"]], color=[BEFORE, AFTER], width=0.55)
    right.axhline(gap["floor"], color="0.3", linestyle="--", linewidth=1.2, label=f"floor {gap['floor']:.2f}")
    for place, name in enumerate(("before", "after")):
        right.annotate(f"{gap[name]:.2f}", (place, gap[name]), (0, 3), textcoords="offset points", ha="center")
    right.margins(y=0.12)
    right.set(title="Condition held out", ylabel="departure, root mean square, scatters")
    right.legend(fontsize=9)
    found = " and ".join(_short(one) for one in row["found"]) or row["verdict"]
    figure.suptitle(
        f"D3.4 {row['section']}: {row['suspected']}\nhidden: {_short(row['hidden'])}\nfound: {found}", fontsize=10.5
    )
    with atomic_write(path) as unfinished:
        figure.savefig(unfinished, dpi=110)


def _short(effect: Mapping[str, Any]) -> str:
    values = ", ".join(f"{row['name']} {row['value']}" for row in parameter_rows({"interval": {}, **effect}))
    return f"{effect_name(effect['name'])} ({values})"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
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
