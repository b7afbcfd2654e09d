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
from torchweather.camera.effects.all import CameraExposureGain
from torchweather.explain import aligned
from torchweather.gap import GapReport, Study, find_gap
from torchweather.gap.hidden_study import WEATHERS, HiddenStudy, hidden_study
from torchweather.io import atomic_write
from torchweather.lidar.effects.all import (
    LidarExtinctionScale,
    LidarIsolatedReturnFilter,
    LidarLimitedExtent,
    LidarStaticStructure,
)
from torchweather.physics import rain_attenuation_p838_db_per_km
from torchweather.radar.effects.all import RadarCfarShift, RadarNoiseFloor
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

BEFORE, AFTER = "#e03131", "#1c7ed6"
TICKS = (-300, -100, -30, -10, -3, 0, 3, 10, 30, 100, 300)  # of departures, in scatters


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
# Of the camera's study: a small frame, and the electrons of a saturated pixel and of its readout (orders of magnitude).
CAMERA_PX = (240, 180)
FULL_WELL_ELECTRONS, READ_ELECTRONS = 10_000.0, 5.0
# Of the radar's: targets, by how much they exceed the threshold in clear air, and the floor of its list.
TARGETS, MARGINS_DB, FLOOR_DB = 120, (1.0, 35.0), -125.0
FLOOR_READ_DB = 0.03  # to which the mean of so many cells is known
CLEAR_FRAMES, FRAMES, REL_SD = 8, 5, 0.1
RATES_MM_PER_H = {10.0: "fit", 25.0: "fit", 40.0: "holdout", 60.0: "fit"}


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


def radar_study(effects: Sequence[Effect], noise_up_db: float, seed: int) -> HiddenStudy:
    """Lists of a radar whose noise is up in rain while its threshold stays where it was: targets are lost or kept by
    their power, and every empty cell whose noise exceeds the threshold is listed.

    Args:
        effects: of the catalogue, that are this.
        noise_up_db: by which the noise is up.
        seed: of everything random.
    """
    rng = np.random.default_rng(seed)
    radar = tw.Radar.preset("imaging-77ghz", noise_floor_db=FLOOR_DB)
    targets = {
        "range_m": np.exp(rng.uniform(np.log(5.0), np.log(0.98 * radar.max_range_m), TARGETS)),
        "azimuth_rad": rng.uniform(-0.6, 0.6, TARGETS),
        "elevation_rad": rng.uniform(-0.1, 0.1, TARGETS),
        "speed_m_per_s": rng.uniform(-3.0, 3.0, TARGETS),
        "target_class": rng.integers(0, 3, TARGETS),
    }
    clear_snr_db = radar.detection_snr_db + rng.uniform(*MARGINS_DB, TARGETS)

    def frame(loss_db: NDArray[Any] | float, up_db: float) -> dict[str, NDArray[Any]]:
        """Powers in units of the noise as it is."""
        threshold = 10.0 ** (0.1 * (radar.detection_snr_db - up_db))
        amplitude = 10.0 ** (0.05 * (clear_snr_db - loss_db - up_db))
        receiver = rng.standard_normal((2, TARGETS)) / np.sqrt(2.0)
        snr = (amplitude + receiver[0]) ** 2 + receiver[1] ** 2
        error = rng.standard_normal((2, TARGETS)) / np.sqrt(2.0 * np.maximum(snr, 1.0))
        measured = {
            "power_db": FLOOR_DB + up_db + 10.0 * np.log10(snr),
            "range_m": targets["range_m"] + radar.range_resolution_m * error[0],
            "speed_m_per_s": targets["speed_m_per_s"] + radar.speed_resolution_m_per_s * error[1],
        }
        found = {name: np.where(snr >= threshold, values, np.nan) for name, values in measured.items()}
        noise = rng.exponential(size=radar.range_doppler_cells)
        noise = noise[noise >= threshold]
        places = [
            radar.max_range_m * rng.random(len(noise)),
            rng.uniform(-0.6, 0.6, len(noise)),
            rng.uniform(-0.1, 0.1, len(noise)),
            radar.max_speed_m_per_s * rng.uniform(-1.0, 1.0, len(noise)),
        ]
        clutter = np.stack([*places, FLOOR_DB + up_db + 10.0 * np.log10(noise), np.zeros(len(noise))], 1)
        floor_db = np.array(FLOOR_DB + up_db + FLOOR_READ_DB * rng.standard_normal())
        return {**found, "noise_floor_db": floor_db, "clutter": clutter}

    clear = [frame(0.0, 0.0) for _ in range(CLEAR_FRAMES)]
    conditions, factors = [], {}
    for rate, split in RATES_MM_PER_H.items():
        name = f"rain-{rate:g}"
        factors[name] = float(np.exp(REL_SD * rng.standard_normal()))
        per_km = float(rain_attenuation_p838_db_per_km(rate * factors[name], radar.frequency_ghz))
        frames = [frame(2e-3 * per_km * targets["range_m"], noise_up_db) for _ in range(FRAMES)]
        weather = {"kind": "rain", "rate_mm_per_h": rate, "rate_rel_sd": REL_SD}
        conditions.append({"id": name, "scene": "road", "weather": weather, "frames": frames, "split": split})
    study = Study.from_arrays(
        sensor=radar,
        scenes=[{"id": "road", "clear": clear, "geometry": targets}],
        conditions=conditions,
    )
    return HiddenStudy(study, tuple(effects), factors)


def table(rows: Sequence[Mapping[str, Any]]) -> str:
    """Hidden and found, parameter by parameter, and the held-out gap."""
    lines = [["D3.4", "hidden", "found", "90 % interval", "held-out gap", "floor"]]
    for row in rows:
        gap = row["gap"]
        shrunk = [f"{gap['before']:.2f} -> {gap['after']:.2f}", f"{gap['floor']:.2f}"]
        hidden, found = (
            {name: text for one in row[key] for name, text in _texts(one).items()} for key in ("hidden", "found")
        )
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
    hidden = " and ".join(_short(one) for one in row["hidden"])
    found = " and ".join(_short(one) for one in row["found"]) or row["verdict"]
    figure.suptitle(f"D3.4 {row['section']}: {row['suspected']}\nhidden: {hidden}\nfound: {found}", fontsize=10.5)
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
