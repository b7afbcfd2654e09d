"""Random calls of the public names: ``python -m tests.fuzz.calls --count 4000 --seed 0 [--call mie]``.

Each call has valid arguments but for one to three, which are wrong or extreme. ``--call NAME --first N --count 1``
repeats one.
"""

from __future__ import annotations

import argparse
import os
import random
import tempfile
import time
from collections.abc import Sequence
from typing import Any

import torch

from tests.fuzz.edge_values import edge
from tests.fuzz.outcome import Outcome, first_not_finite, outcome_of
from tests.fuzz.targets import Target, targets
from tests.fuzz.totals import Counts, add_totals, report
from tests.fuzz.watched import watched

__all__ = ["fuzz_calls"]


def arguments_of(target: Target, seed: int, number: int) -> tuple[dict[str, Any], list[str]]:
    """Arguments of a call, and which of them are no longer valid."""
    pick = random.Random(f"{target.name}/{seed}/{number}")
    torch.manual_seed(number)
    values = {name: make() for name, make in target.arguments.items()}
    names = [*target.arguments, *target.optional]
    if not names or number < 0:  # the valid call
        return values, []
    changed = pick.sample(names, min(len(names), pick.choice((1, 1, 1, 2, 3))))
    for name in changed:
        values[name] = edge(values[name] if name in values else target.optional[name](), pick)
    if pick.random() < 0.01:
        values["no_such_argument"] = 1
    return values, changed


def one_call(target: Target, seed: int, number: int) -> Outcome:
    """The outcome of one call."""
    values, _ = arguments_of(target, seed, number)
    finite = target.finite and not first_not_finite(values)
    found = outcome_of(lambda: target.call(**values), finite=finite, own_call=True)
    # Who asks for terabytes gets Python's and torch's own word for it.
    if found.kind == "internal" and ("MemoryError" in found.where or "can't allocate memory" in found.detail):
        return Outcome("refused")
    return found


def fuzz_calls(chosen: Sequence[Target], count: int, seed: int, *, first: int = 0) -> dict[str, Counts]:
    """Outcomes by group of ``count`` calls for each target."""
    found: dict[str, Counts] = {}
    os.chdir(tempfile.mkdtemp(prefix="fuzz-calls-"))  # names such as "x" are written to
    jobs = [(target, number) for target in chosen for number in range(first, first + count)]
    begin = time.monotonic()
    for at, outcome in watched(lambda at: one_call(*_with_seed(jobs[at], seed)), range(len(jobs))):
        target, number = jobs[at]
        counts = found.setdefault(target.group, Counts())
        repeat = ""
        if outcome.fault:
            values, changed = arguments_of(target, seed, number)
            shown = ", ".join(f"{name}={_short(values[name])}" for name in changed)
            repeat = f"--call {target.name} --seed {seed} --first {number} --count 1  {shown}"
        counts.add(outcome, repeat)
        now = time.monotonic()
        counts.seconds, begin = counts.seconds + now - begin, now
    return found


def _with_seed(job: tuple[Target, int], seed: int) -> tuple[Target, int, int]:
    return job[0], seed, job[1]


def _short(value: Any) -> str:
    try:
        text = f"{tuple(value.shape)} {value.dtype}" if hasattr(value, "dtype") and value.ndim else repr(value)
    except Exception as error:
        text = f"<{type(error).__name__}>"
    return text if len(text) < 60 else text[:57] + "..."


def main() -> int:
    """Run from the command line; exit code 1 where a fault was found."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--count", type=int, default=10, help="calls of each name")
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--call", action="append", help="a name, or the beginning of several; all by default")
    parser.add_argument("--valid", action="store_true", help="only the valid call of each name; print those that fail")
    parser.add_argument("--write", action="store_true", help="add the counts to totals.json")
    given = parser.parse_args()
    torch.set_num_threads(1)
    chosen = [one for one in targets() if not given.call or one.name.startswith(tuple(given.call))]
    if given.valid:
        return _valid(chosen)
    found = fuzz_calls(chosen, given.count, given.seed, first=given.first)
    faults = report(found)
    if given.write:
        add_totals("calls", given.seed, found)
    print(f"{sum(one.kinds.total() for one in found.values())} calls of {len(chosen)} names, {faults} faults")
    return 1 if faults else 0


def _valid(chosen: Sequence[Target]) -> int:
    wrong = 0
    for target in chosen:
        values, _ = arguments_of(target, 0, -1)
        try:
            begin = time.monotonic()
            target.call(**values)
            if time.monotonic() - begin > 1:
                print(f"{target.name}: {time.monotonic() - begin:.1f} s")
        except Exception as error:
            wrong += 1
            print(f"{target.name}: {type(error).__name__}: {str(error)[:150]}")
    print(f"{len(chosen)} names, {wrong} without valid arguments")
    return 1 if wrong else 0


if __name__ == "__main__":
    raise SystemExit(main())
