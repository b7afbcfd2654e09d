"""Counts of a run by reader or group of calls, its report, and the totals that are committed."""

from __future__ import annotations

import datetime
import json
from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from tests.fuzz.outcome import KINDS, Outcome
from torchweather import __version__

__all__ = ["FILE", "Counts", "add_totals", "report"]

FILE = Path(__file__).with_name("totals.json")
_MOST_SHOWN = 3


@dataclass
class Counts:
    """Outcomes of one reader or group.

    Args:
        kinds: kind to number.
        faults: place to the repeats that show it, the command and the bytes.
        seconds: that it took.
    """

    kinds: Counter[str] = field(default_factory=Counter)
    faults: dict[str, list[str]] = field(default_factory=dict)
    details: dict[str, str] = field(default_factory=dict)
    seconds: float = 0.0

    def add(self, outcome: Outcome, repeat: str) -> None:
        """Count an outcome; ``repeat`` is what shows it again."""
        self.kinds[outcome.kind] += 1
        if outcome.fault:
            where = f"{outcome.kind}: {outcome.where}"
            self.faults.setdefault(where, []).append(repeat)
            self.details.setdefault(where, outcome.detail)


def report(found: dict[str, Counts]) -> int:
    """Print counts and faults; the number of faults."""
    for name, counts in found.items():
        shown = ", ".join(f"{kind} {counts.kinds[kind]}" for kind in KINDS if counts.kinds[kind])
        print(f"{name}: {shown} in {counts.seconds:.1f} s", flush=True)
        for where, repeats in counts.faults.items():
            print(f"  {len(repeats)} x {where}")
            print("    " + counts.details[where].strip().replace("\n", "\n    "))
            for repeat in repeats[:_MOST_SHOWN]:
                print(f"    {repeat}")
    return sum(len(one) for counts in found.values() for one in counts.faults.values())


def add_totals(part: str, seed: int, found: dict[str, Counts]) -> None:
    """Write a run's counts to ``totals.json``, beside those of other parts; a further seed of a name is added."""
    totals: dict[str, Any] = json.loads(FILE.read_text(encoding="utf-8")) if FILE.is_file() else {}
    rows = totals.setdefault(part, {})
    for name, counts in found.items():
        row = rows.setdefault(name, {"seeds": []})
        if seed in row["seeds"]:  # done again
            row = rows[name] = {"seeds": []}
        row["seeds"].append(seed)
        row["date"], row["version"] = datetime.date.today().isoformat(), __version__
        for kind in KINDS:
            row[kind] = row.get(kind, 0) + counts.kinds[kind]
        row["seconds"] = round(row.get("seconds", 0.0) + counts.seconds, 1)
    totals["sums"] = {part: _sum(rows.values()) for part, rows in totals.items() if part != "sums"}
    FILE.write_text(json.dumps(totals, indent=1) + "\n", encoding="utf-8")


def _sum(rows: Iterable[dict[str, Any]]) -> dict[str, float]:
    names = ("number", *KINDS[2:], "seconds")
    every = [{**row, "number": sum(row[kind] for kind in KINDS)} for row in rows]
    return {name: round(sum(row[name] for row in every), 1) for name in names}
