"""Bench of the gap workflow on LiDAR data in which an effect is hidden.

    python benchmarks/gap_bench.py make DIR --set dev --seed 1 --cases singles nulls --count 20
    python benchmarks/gap_bench.py run DIR                  # resumable: one line of JSON a case
    python benchmarks/gap_bench.py score DIR --out benchmarks/gap_bench

``make`` writes studies to ``DIR/studies`` and what is hidden in them to ``DIR/sealed/truth.json``, whose SHA-256 it
prints and keeps in ``DIR/seal.json``. ``run`` never opens the sealed folder. A set that led to a change of the workflow
is a development set (``--set dev...``) from then on.
"""

from __future__ import annotations

import argparse
import sys
import time
from pathlib import Path

from hidden.cases import GROUPS, Streets, build, plan
from hidden.design import Size
from hidden.sealed import read_json, sha256_of, write_json


def make(arguments: argparse.Namespace) -> None:
    """Write studies and the sealed truth."""
    folder: Path = arguments.folder
    size = Size().smaller_grid() if arguments.small else Size()
    cases = list(plan(arguments.set, arguments.seed, arguments.cases, size))
    cases = cases[arguments.skip :][: arguments.count]
    truth_path = folder / "sealed" / "truth.json"
    truths = read_json(truth_path) if truth_path.exists() else {}
    names = tuple(sorted({name for case in cases for name in case.names})) if arguments.few else None
    streets = Streets(arguments.set, arguments.seed, folder / "sealed", names)
    for case in cases:
        if case.id in truths and (folder / "studies" / case.id / "study.yaml").exists():
            continue
        start = time.perf_counter()
        study, truth = build(case, streets)
        study.write(folder / "studies" / case.id)
        truths[case.id] = truth
        write_json(truth_path, truths)
        print(f"{case.id}  {time.perf_counter() - start:.1f} s", flush=True)
    seal = sha256_of(truth_path)
    write_json(folder / "seal.json", {"set": arguments.set, "seed": arguments.seed, "truth_sha256": seal})
    print(f"{len(truths)} studies; SHA-256 of the sealed truth: {seal}")


def main(argv: list[str] | None = None) -> int:
    """Read the command line."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    commands = parser.add_subparsers(required=True)
    one = commands.add_parser("make", help="write studies and the sealed truth")
    one.add_argument("folder", type=Path)
    one.add_argument("--set", default="dev", help="name of the set: dev... or blind...")
    one.add_argument("--seed", type=int, default=1)
    one.add_argument("--cases", nargs="+", choices=sorted(GROUPS), default=sorted(GROUPS))
    one.add_argument("--count", type=int, default=None, help="no more than these")
    one.add_argument("--skip", type=int, default=0, help="leave these out first")
    one.add_argument("--small", action="store_true", help="4,096 beams")
    one.add_argument("--few", action="store_true", help="strengths of the needed effects only, no cosines: faster")
    one.set_defaults(run=make)
    arguments = parser.parse_args(argv)
    arguments.run(arguments)
    return 0


if __name__ == "__main__":
    sys.exit(main())
