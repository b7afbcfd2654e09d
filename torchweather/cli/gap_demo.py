"""``torchweather gap demo``: an effect drawn at random and hidden, searched for, and compared with the answer.

Nothing is hidden only where that is asked for (``--allow-none``).
"""

from __future__ import annotations

import argparse
import hashlib
import json
import secrets
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from torchweather.core.exceptions import InputValueError

__all__ = ["outcome", "run"]

STUDY, TRUTH = "study", "truth.json"
FORMAT = "torchweather-gap-demo/1"
SEEDS = 2**32  # from which one is drawn


def run(args: argparse.Namespace) -> int:
    """Hide, seal, search, and open the seal last."""
    from torchweather.cli.output import note, print_json, print_lines
    from torchweather.gap import find
    from torchweather.gap.study.hidden import drawn_study
    from torchweather.gap.study.study import Study
    from torchweather.report.gap_page import write_gap

    if args.effects is not None:
        raise InputValueError("gap: --effects belongs to a study; the demo searches the whole catalogue.")
    if args.ignore_parts:
        raise InputValueError("gap: --ignore-parts belongs to a study; no scene of the demo changes.")
    seed = secrets.randbelow(SEEDS) if args.seed is None else args.seed
    hidden = drawn_study(seed, allow_none=args.allow_none)
    hidden.study.write(args.out / STUDY)
    sha256 = seal(args.out / TRUTH, hidden.truth())
    # Told whether progress is wanted or not: that it comes before the search is what it is worth.
    note(f"seed {seed}; what is hidden is sealed in {args.out / TRUTH}, SHA-256 {sha256}")
    study = Study.read(args.out / STUDY)
    report = find.find_gap(study, progress=lambda text: note(text, quiet=args.quiet))
    answer = write_gap(args.out, study, report)
    truth = opened(args.out / TRUTH, sha256)
    right, said = outcome(truth, answer)
    if args.json:
        found = {"format": FORMAT, "seed": seed, "truth_sha256": sha256, "hidden": truth, "found": answer}
        print_json({**found, "right": right, "outcome": said})
    else:
        print_lines("\n".join([f"seed {seed}", "", *side_by_side(truth, answer), "", said]))
        print_lines(f"wrote {args.out / 'report.html'}")
    return 0


def seal(path: Path, truth: Mapping[str, Any]) -> str:
    """Write the truth; the SHA-256 of the file."""
    from torchweather.io import atomic_write

    content = (json.dumps(truth, indent=1, allow_nan=False) + "\n").encode()
    with atomic_write(path) as unfinished:
        unfinished.write_bytes(content)
    return hashlib.sha256(content).hexdigest()


def opened(path: Path, sha256: str) -> dict[str, Any]:
    """The truth of a file that is still the one that was sealed."""
    from torchweather.core.errors import TorchweatherError

    content = path.read_bytes()
    if hashlib.sha256(content).hexdigest() != sha256:
        raise TorchweatherError(f"{path}: expected the file that was sealed before the search; it was changed since.")
    truth: dict[str, Any] = json.loads(content)
    return truth


def side_by_side(truth: Mapping[str, Any], answer: Mapping[str, Any]) -> list[str]:
    """Lines with what was hidden and what was found, parameter by parameter, and how far the weather record is off."""
    from torchweather.core.text import aligned

    hidden, found = _values(truth["effects"]), _values(answer["effects"])
    rows = [["", "hidden", "found"]]
    rows += [[key, hidden.get(key, "–"), found.get(key, "–")] for key in dict.fromkeys([*hidden, *found])]
    if not hidden and not found:
        rows.append(["effect", "none", "none"])
    factors = truth["weather_factor"]
    rows += [
        [f"true over recorded weather, {name}", f"{factors[name]:.3f}", f"{value:.3f}"]
        for name, value in answer["nuisance"]["by_condition"].items()
    ]
    return aligned(rows)


def _values(effects: list[dict[str, Any]]) -> dict[str, str]:
    """Effect and parameter to the value with its unit, and the interval where there is one."""
    from torchweather.report.gap_words import parameter_rows

    found = {}
    for effect in effects:
        for row in parameter_rows({"interval": {}, **effect}):
            value = f"{row['value']} {row['unit']}".strip()
            found[f"{effect['name']} {row['name']}"] = f"{value} ({row['interval']})" if row["interval"] else value
    return found


def outcome(truth: Mapping[str, Any], answer: Mapping[str, Any]) -> tuple[bool, str]:
    """Success of the search, which is to name the hidden effect and nothing else, and a sentence on it.

    Example:
        >>> loss = {"name": "lidar.window_loss", "parameters": {"loss_db": 2.0}}
        >>> outcome({"effects": [loss]}, {"verdict": "none", "effects": []})
        (False, 'Not found: window loss was hidden; the search says that nothing is missing.')
    """
    from torchweather.report.gap_words import effect_name

    hidden, found = ([one["name"] for one in side["effects"]] for side in (truth, answer))
    words = " and ".join(map(effect_name, hidden)) or "nothing"
    named = " and ".join(map(effect_name, found))
    said = {
        "none": "that nothing is missing",
        "named": f"that {named} is missing",
        "named_and_rest": f"that {named} is missing, and more",
        "unknown": "that something is missing that no effect of the catalogue explains",
    }[answer["verdict"]]
    right = set(hidden) == set(found) and answer["verdict"] == ("named" if hidden else "none")
    if right:
        judged = "Right"
    elif not hidden:
        judged = "Wrong"
    else:
        judged = "Found, but not alone" if set(hidden) <= set(found) else "Not found"
    return right, f"{judged}: {words} was hidden; the search says {said}."
