"""Bench of the gap workflow on data in which an effect is hidden.

    python benchmarks/gap_bench.py make DIR --sensor lidar --set dev --seed 1 --cases singles nulls --count 20
    python benchmarks/gap_bench.py run DIR                  # resumable: one line of JSON a case
    python benchmarks/gap_bench.py known DIR                # opens the truth: how narrow intervals could be
    python benchmarks/gap_bench.py score DIR --out benchmarks/gap_bench

``make`` writes studies to ``DIR/studies`` and what is hidden in them to ``DIR/sealed/truth.json``, whose SHA-256 it
prints and keeps in ``DIR/seal.json``. ``run`` never opens the sealed folder; ``known`` and ``score`` do, so they come
after it. A set that led to a change of the workflow is a development set (``--set dev...``) from then on.
"""

from __future__ import annotations

import argparse
import sys
import time
from dataclasses import asdict
from pathlib import Path
from typing import Any

from hidden.answering import answer, draw_calibration, draw_confusion
from hidden.bars import against_bars
from hidden.bench_sensor import SENSORS, BenchSensor, bench_sensor
from hidden.planning import FAMILIES
from hidden.scoring import score
from hidden.sealed import append_line, read_json, read_lines, sha256_of, write_json
from hidden.table_text import bars_table, further_table, missed_table

from torchweather.io import atomic_write


def make(arguments: argparse.Namespace) -> None:
    """Write studies and the sealed truth."""
    folder: Path = arguments.folder
    if (folder / "answers.jsonl").exists():
        raise SystemExit(f"{folder}: has answers; its truth is sealed. Make further studies in another folder.")
    sensor = bench_sensor(arguments.sensor)
    groups = arguments.cases or list(sensor.usual)
    strange = sorted(set(groups) - set(sensor.groups))
    if strange:
        raise SystemExit(f"--cases: wanted some of {', '.join(sensor.groups)}; got {', '.join(strange)}.")
    cases = sensor.plan(arguments.set, arguments.seed, groups, arguments.small)
    cases = cases[arguments.skip :][: arguments.count]
    truth_path = folder / "sealed" / "truth.json"
    truths = read_json(truth_path) if truth_path.exists() else {}
    for case in cases:
        sealed = truths.get(case.id, {}).get("size")
        if sealed is not None and sealed != asdict(case.size):
            raise SystemExit(
                f"{case.id}: sealed with a size of {sealed}; asked for is {asdict(case.size)}. "
                "Give or leave out --small."
            )
    build = sensor.builder(arguments.set, arguments.seed, folder / "sealed", cases, arguments.few)
    for case in cases:
        if case.id in truths and (folder / "studies" / case.id / "study.yaml").exists():
            continue
        start = time.perf_counter()
        study, truth = build(case)
        study.write(folder / "studies" / case.id)
        truths[case.id] = truth
        write_json(truth_path, truths)
        print(f"{case.id}  {time.perf_counter() - start:.1f} s", flush=True)
    seal = sha256_of(truth_path)
    about = {"sensor": arguments.sensor, "set": arguments.set, "seed": arguments.seed, "truth_sha256": seal}
    write_json(folder / "seal.json", about)
    print(f"{len(truths)} studies; SHA-256 of the sealed truth: {seal}")


def run(arguments: argparse.Namespace) -> None:
    """Answer every study that has no answer yet; the sealed folder stays shut."""
    folder: Path = arguments.folder
    answers = folder / "answers.jsonl"
    seal = read_json(folder / "seal.json")
    cases = sorted(path.parent.name for path in (folder / "studies").glob("*/study.yaml"))
    metrics = sensor_of(folder).other_metrics
    done = answered(answers)
    waiting = [case for case in part_of(cases, arguments.part) if case not in done][: arguments.count]
    print(f"set {seal['set']}, SHA-256 of the sealed truth: {seal['truth_sha256']}")
    print(f"{len(done)} of {len(cases)} studies have an answer; {len(waiting)} to go")
    for case in waiting:
        if case in answered(answers):  # by another process
            continue
        found = answer(folder / "studies" / case, arguments.seed, other_metrics=metrics)
        append_line(answers, {"case": case, "seed": arguments.seed, "sealed": seal["truth_sha256"], **found})
        said = found.get("report", {}).get("verdict", "refused")
        print(f"{case}  {said}  {found['seconds']:.1f} s", flush=True)


def sensor_of(folder: Path) -> BenchSensor:
    """Of a set that was made."""
    return bench_sensor(read_json(folder / "seal.json")["sensor"])


def answered(answers: Path) -> set[str]:
    """Studies that have an answer."""
    return {one["case"] for one in read_lines(answers)}


def part_of(cases: list[str], part: str | None) -> list[str]:
    """Every n-th of all studies from the k-th: parts never overlap, whatever is done already."""
    if part is None:
        return cases
    number, parts = (int(value) for value in part.split("/"))
    if not 1 <= number <= parts:
        raise SystemExit(f"--part: wanted k/n with k from 1 to n; got {part}.")
    return cases[number - 1 :: parts]


def truth_of(folder: Path) -> dict[str, Any]:
    """The sealed truth, if it is still what was sealed."""
    path = folder / "sealed" / "truth.json"
    if sha256_of(path) != read_json(folder / "seal.json")["truth_sha256"]:
        raise SystemExit(f"{path}: its SHA-256 is not the one that was sealed; make the set anew.")
    return dict(read_json(path))


def known(arguments: argparse.Namespace) -> None:
    """Answer again, allowed the true effects alone, the studies whose answer named just these."""
    folder: Path = arguments.folder
    truths, lines = truth_of(folder), folder / "known.jsonl"
    missing = sorted(set(truths) - answered(folder / "answers.jsonl"))
    if missing:
        raise SystemExit(f"{folder}: {len(missing)} studies have no answer yet; run them first, the truth opens then.")
    rows = score(truths, read_lines(folder / "answers.jsonl"))["cases"]
    exact = {row["case"]: row["true"] for row in rows if row["exact"]}
    waiting = [case for case in part_of(sorted(exact), arguments.part) if case not in answered(lines)]
    for case in waiting[: arguments.count]:
        found = answer(folder / "studies" / case, arguments.seed, exact[case])
        append_line(lines, {"case": case, "seed": arguments.seed, **found})
        print(f"{case}  {found['seconds']:.1f} s", flush=True)


def timed(arguments: argparse.Namespace) -> None:
    """Answer some studies again for their seconds: where answers came from several processes side by side."""
    folder: Path = arguments.folder
    lines = folder / "seconds.jsonl"
    for case in sorted(answered(folder / "answers.jsonl"))[arguments.skip :: arguments.every]:
        if case not in answered(lines):
            found = answer(folder / "studies" / case, arguments.seed)
            append_line(lines, {"case": case, "seconds": found["seconds"]})
            print(f"{case}  {found['seconds']:.1f} s", flush=True)


def folder_and_families(given: str) -> tuple[Path, list[str]]:
    """``DIR``, or ``DIR:single,pair``: the families of a set that count; none: all."""
    folder, colon, listed = given.rpartition(":")
    if not colon or (Path(given) / "seal.json").exists():
        return Path(given), []
    families = listed.split(",")
    if not set(families) <= set(FAMILIES):
        raise SystemExit(f"{given}: wanted a folder, or one with :{','.join(FAMILIES)} or some of these; got {listed}.")
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
            raise SystemExit(f"{folder}: wanted a set of sensor {seals[0]['sensor']}; got {seal['sensor']}.")
        seals.append({**seal, "families": families} if families else seal)
        truths |= {case: one for case, one in truth_of(folder).items() if not families or one["family"] in families}
        answers += lines
        told += read_lines(folder / "known.jsonl")
        alone += read_lines(folder / "seconds.jsonl")
    sensor = sensor_of(folders[0])
    found = score(truths, answers, told, sensor.floors, alone)
    out: Path = arguments.out or folders[0] / "score"
    bars = against_bars(found["table"], sensor.bars)
    write_json(out / "score.json", {"sets": seals, **found, "bars": bars})
    if found["table"]["confusion"]:  # of single effects and such from outside
        draw_confusion(found["table"]["confusion"], out / "confusion.png")
    draw_calibration(found["table"]["calibration"], out / "calibration.png")
    tables = bars_table(found["table"], bars), further_table(found["table"]), missed_table(found["cases"])
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


def main(argv: list[str] | None = None) -> int:
    """Read the command line."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    commands = parser.add_subparsers(required=True)
    one = commands.add_parser("make", help="write studies and the sealed truth")
    one.add_argument("folder", type=Path)
    one.add_argument("--sensor", choices=SENSORS, default="lidar")
    one.add_argument("--set", default="dev", help="name of the set: dev... or blind...")
    one.add_argument("--seed", type=int, default=1)
    one.add_argument("--cases", nargs="+", help="groups of cases; default: a full set, without the screen")
    one.add_argument("--count", type=int, default=None, help="no more than these")
    one.add_argument("--skip", type=int, default=0, help="leave these out first")
    one.add_argument("--small", action="store_true", help="the size for tests")
    one.add_argument(
        "--few", action="store_true", help="compute what these cases need alone: faster, without confusions"
    )
    one.set_defaults(run=make)
    for name, act, what in (
        ("run", run, "answer every study that has no answer yet"),
        ("known", known, "open the sealed truth and search again for the true effects alone"),
    ):
        one = commands.add_parser(name, help=what)
        one.add_argument("folder", type=Path)
        one.add_argument("--seed", type=int, default=0)
        one.add_argument("--count", type=int, default=None, help="no more than these")
        one.add_argument("--part", default=None, help="k/n: every n-th study from the k-th, for several processes")
        one.set_defaults(run=act)
    one = commands.add_parser("time", help="search some studies again, one process alone, for their seconds")
    one.add_argument("folder", type=Path)
    one.add_argument("--seed", type=int, default=0)
    one.add_argument("--every", type=int, default=7, help="every n-th of those answered, by name")
    one.add_argument("--skip", type=int, default=0, help="leave these out first")
    one.set_defaults(run=timed)
    one = commands.add_parser("score", help="open the sealed truth and write the table and pictures")
    one.add_argument(
        "folders",
        nargs="+",
        help="one set, or several of a sensor in one table; DIR:single,pair counts these families of a set alone",
    )
    one.add_argument("--out", type=Path, default=None, help="default: score in the first folder")
    one.set_defaults(run=report)
    arguments = parser.parse_args(argv)
    arguments.run(arguments)
    return 0


if __name__ == "__main__":
    sys.exit(main())
