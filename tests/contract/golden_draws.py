"""Golden numbers of every random stream: ``python -m tests.contract.golden_draws`` writes them anew.

A change of these numbers changes every storm that a user has drawn. It is a breaking change, named in CHANGELOG.md.
"""

from __future__ import annotations

import json
from pathlib import Path

from tests.contract.table import TABLE, transform_of

PATH = Path(__file__).with_name("golden_draws.json")
SEED = 7


def summary(name: str) -> dict[str, list[float]]:
    """Count, first, middle and last number, and mean of each stream of an entry, for one sample."""
    noise = transform_of(name).draw(TABLE[name].data(1), seed=SEED)
    found = {}
    for key, value in sorted(noise.items()):
        flat = value.double().flatten()
        picked = [flat[place].item() for place in (0, len(flat) // 2, -1)] if len(flat) else []
        found[key] = [len(flat), *picked, flat.mean().item() if len(flat) else 0.0]
    return found


def main() -> None:
    """Write the file."""
    lines = (f"{json.dumps(name)}: {json.dumps(summary(name))}" for name in TABLE)
    PATH.write_text("{\n" + ",\n".join(lines) + "\n}\n", encoding="utf-8")


if __name__ == "__main__":
    main()
