"""Steps of a bench: make studies, answer them, answer again for comparison, keep the set."""

from __future__ import annotations

import argparse
import time
from dataclasses import asdict
from pathlib import Path
from typing import Any

from .answering import answer
from .generator.bench_sensor import BenchSensor, bench_sensor
from .scoring import score
from .sealed import append_line, keep_packed, read_json, read_lines, sha256_of, stored, write_json

__all__ = ["answered", "keep", "known", "make", "part_of", "run", "sensor_of", "timed", "truth_of"]

TRUTH = Path("sealed", "truth.json")
KEPT = (Path("seal.json"), TRUTH, Path("answers.jsonl"), Path("known.jsonl"), Path("seconds.jsonl"))
"""Files of a set that are kept; the studies follow from the truth."""


def make(arguments: argparse.Namespace) -> None:
    """Write studies and the sealed truth."""
    folder: Path = arguments.folder
    if stored(folder / "answers.jsonl") is not None:
        raise SystemExit(f"{folder}: has answers; its truth is sealed. Make further studies in another folder.")
    sensor = bench_sensor(arguments.sensor)
    groups = arguments.cases or list(sensor.usual)
    strange = sorted(set(groups) - set(sensor.groups))
    if strange:
        raise SystemExit(f"--cases: expected some of {', '.join(sensor.groups)}; got {', '.join(strange)}.")
    cases = sensor.plan(arguments.set, arguments.seed, groups, arguments.small)
    cases = cases[arguments.skip :][: arguments.count]
    truth_path = folder / TRUTH
    truths = read_json(truth_path) if stored(truth_path) is not None else {}
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
        raise SystemExit(f"--part: expected k/n with k from 1 to n; got {part}.")
    return cases[number - 1 :: parts]


def truth_of(folder: Path) -> dict[str, Any]:
    """The sealed truth, if it is still what was sealed."""
    path = folder / TRUTH
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


def keep(arguments: argparse.Namespace) -> None:
    """Copy what is kept of a set into a folder; all but the seal is compressed."""
    for name in KEPT:
        if stored(arguments.folder / name) is not None:
            print(keep_packed(arguments.folder / name, arguments.into / name))
