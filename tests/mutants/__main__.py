"""Command line: ``python -m tests.mutants [--room lidar] [--only NAME] [-j 1]``."""

from __future__ import annotations

import argparse
import sys

from tests.mutants.rooms import ROOMS
from tests.mutants.run import Outcome, run_mutants


def main(arguments: list[str] | None = None) -> int:
    """0 where every mutant goes red, 1 where one survives or cannot be tried."""
    parser = argparse.ArgumentParser(prog="python -m tests.mutants", description=__doc__)
    parser.add_argument("--room", action="append", choices=ROOMS, help="of these rooms alone; default: all")
    parser.add_argument("--only", action="append", metavar="NAME", help="these mutants alone")
    parser.add_argument("-j", "--jobs", type=int, default=1, help="mutants side by side, each on its own copy")
    given = parser.parse_args(arguments)
    wanted = {
        room: [mutant for mutant in mutants if not given.only or mutant.name in given.only]
        for room, mutants in ROOMS.items()
        if not given.room or room in given.room
    }
    unknown = set(given.only or ()) - {mutant.name for mutants in wanted.values() for mutant in mutants}
    if unknown:
        parser.error(f"no mutant {', '.join(sorted(unknown))} in the rooms chosen")
    bad = []
    for room, mutants in wanted.items():
        if not mutants:
            continue
        print(f"{room}", flush=True)
        bad += [outcome for outcome in run_mutants(mutants, given.jobs, _show) if not outcome.good]
    tried = sum(map(len, wanted.values()))
    print(f"{tried} mutants, {len(bad)} complaints")
    for outcome in bad:
        print(f"  {outcome.name}: {outcome.end}")
    return 1 if bad else 0


def _show(outcome: Outcome) -> None:
    print(f"  {'ok ' if outcome.good else 'BAD'} {outcome.seconds:6.1f} s  {outcome.name:44} {outcome.end}", flush=True)


if __name__ == "__main__":
    sys.exit(main())
