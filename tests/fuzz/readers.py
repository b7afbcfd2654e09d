"""Mutated files of every reader: ``python -m tests.fuzz.readers --count 1000 --seed 0 [--reader points-pcd]``.

Each input is made from the reader's name, the seed and its number alone; ``--first N --count 1`` repeats one.
"""

from __future__ import annotations

import argparse
import random
import shutil
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import torch

from tests.fuzz import image_readers, point_readers, text_readers
from tests.fuzz.containers import mutate_inside
from tests.fuzz.mutations import difference
from tests.fuzz.outcome import Outcome, outcome_of
from tests.fuzz.reader import Reader
from tests.fuzz.totals import Counts, add_totals, report
from tests.fuzz.watched import watched

__all__ = ["READERS", "fuzz_reader"]

READERS = {one.name: one for one in (*point_readers.READERS, *image_readers.READERS, *text_readers.READERS)}


def fuzz_reader(reader: Reader, count: int, seed: int, *, first: int = 0, until: float = float("inf")) -> Counts:
    """Outcomes of ``count`` mutated files.

    Args:
        reader: of the list.
        count, first: numbers of the inputs; -1 as the first: only the unharmed files.
        seed: of the mutations.
        until: time (``time.monotonic``) at which no further input is begun.
    """
    found = Counts()
    begin = time.monotonic()
    with tempfile.TemporaryDirectory(prefix="fuzz-") as temporary:
        folder = Path(temporary)
        (folder / "seeds").mkdir()
        (folder / "beside").mkdir()
        contents = list(reader.make(folder / "seeds"))
        beside = reader.beside(folder / "beside")
        mutated = _mutations(reader.name, contents, seed)

        def work(number: int) -> Outcome:
            """The outcome of an input; of a negative number, of an unharmed file."""
            place = folder / "work"
            shutil.rmtree(place, ignore_errors=True)
            path = place / reader.file
            for name, content in {**beside, reader.file: mutated(number)[1]}.items():
                (place / name).parent.mkdir(parents=True, exist_ok=True)
                (place / name).write_bytes(content)
            return outcome_of(lambda: reader.read(path))

        numbers = range(first, first + count) if first >= 0 else range(-len(contents), 0)
        for number, outcome in watched(work, numbers, reader.memory_bytes):
            repeat = ""
            if outcome.fault:
                repeat = (
                    f"--reader {reader.name} --seed {seed} --first {number} --count 1  {difference(*mutated(number))}"
                )
            found.add(outcome, repeat)
            if time.monotonic() > until:
                break
    found.seconds = time.monotonic() - begin
    return found


def _mutations(name: str, contents: list[bytes], seed: int) -> Callable[[int], tuple[bytes, bytes]]:
    def mutated(number: int) -> tuple[bytes, bytes]:
        if number < 0:
            return contents[-1 - number], contents[-1 - number]
        pick = random.Random(f"{name}/{seed}/{number}")
        before = pick.choice(contents)
        return before, mutate_inside(before, contents, pick)

    return mutated


def main() -> int:
    """Run from the command line; exit code 1 where a fault was found."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--count", type=int, default=200, help="inputs for each reader")
    parser.add_argument("--first", type=int, default=0, help="number of the first input")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--reader", action="append", help="a reader, or the beginning of several; all by default")
    parser.add_argument("--seconds", type=float, default=480.0, help="no reader is begun after this time")
    parser.add_argument("--write", action="store_true", help="add the counts to totals.json")
    given = parser.parse_args()
    torch.set_num_threads(1)
    end = time.monotonic() + given.seconds
    found: dict[str, Counts] = {}
    faults = 0
    for name, reader in READERS.items():
        if (given.reader and not name.startswith(tuple(given.reader))) or time.monotonic() > end:
            continue
        found[name] = fuzz_reader(reader, given.count, given.seed, first=given.first)
        faults += report({name: found[name]})
    if given.write:
        add_totals("readers", given.seed, found)
    print(f"{sum(one.kinds.total() for one in found.values())} inputs, {faults} faults")
    return 1 if faults else 0


if __name__ == "__main__":
    raise SystemExit(main())
