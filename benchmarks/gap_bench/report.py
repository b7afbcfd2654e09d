"""Last step of a bench: the truth is opened and compared with the answers."""

from __future__ import annotations

import argparse
from pathlib import Path

from torchweather.io import atomic_write

from .bars import against_bars
from .drawing import draw_calibration, draw_confusion
from .generator.planning import FAMILIES
from .scoring import score
from .sealed import read_json, read_lines, write_json
from .steps import sensor_of, truth_of
from .table_text import bars_table, missed_table, other_figures_table

__all__ = ["folder_and_families", "report"]


def folder_and_families(given: str) -> tuple[Path, list[str]]:
    """``DIR``, or ``DIR:single,pair``: the families of a set that count; none: all."""
    folder, colon, listed = given.rpartition(":")
    if not colon or (Path(given) / "seal.json").exists():
        return Path(given), []
    families = listed.split(",")
    if not set(families) <= set(FAMILIES):
        raise SystemExit(
            f"{given}: expected a folder, or one with :{','.join(FAMILIES)} or some of these; got {listed}."
        )
    return Path(folder), families


def report(arguments: argparse.Namespace) -> None:
    """Open the truth and set it against the answers."""
    sets = [folder_and_families(str(given)) for given in arguments.folders]
    folders = [folder for folder, _ in sets]
    seals, truths, answers, told, alone = [], {}, [], [], []
    for folder, families in sets:
        seal, lines = read_json(folder / "seal.json"), read_lines(folder / "answers.jsonl")
        strange = sorted({one["case"] for one in lines if one["sealed"] != seal["truth_sha256"]})
        if strange:
            raise SystemExit(f"{folder}: {', '.join(strange)} were answered under another seal; answer them again.")
        if seals and seal["sensor"] != seals[0]["sensor"]:
            raise SystemExit(f"{folder}: expected a set of sensor {seals[0]['sensor']}; got {seal['sensor']}.")
        seals.append({**seal, "families": families} if families else seal)
        truths |= {case: one for case, one in truth_of(folder).items() if not families or one["family"] in families}
        answers += lines
        told += read_lines(folder / "known.jsonl")
        alone += read_lines(folder / "seconds.jsonl")
    sensor = sensor_of(folders[0])
    found = score(truths, answers, told, sensor.floors, alone)
    out: Path = arguments.out or folders[0] / "score"
    bars = against_bars(found["table"], sensor.bars)
    write_json(out / "score.json", {"sets": seals, "table": found["table"], "bars": bars})
    write_json(out / "cases.json.gz", found["cases"])
    if found["table"]["confusion"]:  # of single effects and such from outside
        draw_confusion(found["table"]["confusion"], out / "confusion.png")
    draw_calibration(found["table"]["calibration"], out / "calibration.png")
    tables = bars_table(found["table"], bars), other_figures_table(found["table"]), missed_table(found["cases"])
    with atomic_write(out / "table.md") as unfinished:  # for docs/gap-bench.md
        unfinished.write_text("\n\n".join(tables) + "\n", encoding="utf-8")
    for name, value in found["table"].items():
        if isinstance(value, dict) and "share" in value and value["of"]:
            print(f"{name:32s} {value['hits']:4d} of {value['of']:4d}  {value['share']:.3f}  {value['wilson_95']}")
    for name in (
        *("parameter_off_over_departure", "interval_width_over_known", "other_metrics_after_over_before"),
        "seconds",
    ):
        print(f"{name}: {found['table'][name]}")
    for one in bars:
        limit = next(f"{side.replace('_', ' ')} {one[side]:g}" for side in ("at_least", "at_most") if side in one)
        said = {True: "holds", False: "does not hold", None: "nothing counted"}[one["holds"]]
        print(f"bar: {one['figure']} {limit}: {said}")
