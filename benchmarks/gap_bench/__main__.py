"""Command line of the bench: ``python -m benchmarks.gap_bench``."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from .generator.bench_sensor import SENSORS
from .report import report
from .steps import keep, known, make, run, timed


def main(argv: list[str] | None = None) -> int:
    """Read the command line."""
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.gap_bench",
        description="Bench of the search on studies in which an effect is hidden.",
    )
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
    one = commands.add_parser("keep", help="copy seal, truth and answers of a set, compressed, into a folder")
    one.add_argument("folder", type=Path)
    one.add_argument("into", type=Path)
    one.set_defaults(run=keep)
    arguments = parser.parse_args(argv)
    arguments.run(arguments)
    return 0


if __name__ == "__main__":
    sys.exit(main())
