"""Record of a run beside its outputs: version, weather, sensors, seed, options and depth of every file written."""

from __future__ import annotations

import argparse
import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from torchweather import __version__
from torchweather.cli.output import plain
from torchweather.core.exceptions import TorchweatherError

__all__ = ["NAME", "add_no_record", "read_runs", "record_of", "write_run"]

NAME = "torchweather-record.json"
FORMAT = "torchweather-record/1"
# Arguments that change no result.
WITHOUT_EFFECT = ("run", "json", "debug", "quiet", "no_record", "no_fsync")


def add_no_record(parser: argparse.ArgumentParser) -> None:
    """The argument that leaves the record out."""
    parser.add_argument("--no-record", action="store_true", help=f"write no {NAME} beside the results")


def record_of(args: argparse.Namespace, command: str, values: Mapping[str, Any]) -> dict[str, Any]:
    """One run as plain values: the arguments that were given, and what the command found.

    Args:
        args: of the command.
        command: its name.
        values: weather, sensors, options, depth, files.
    """
    from torchweather.core.random import DRAWS  # which imports numpy: the parser starts without it

    given = {
        name: value
        for name, value in vars(args).items()
        if name not in WITHOUT_EFFECT and value not in (None, False, [])
    }
    return {
        "command": command,
        "torchweather": __version__,
        "draws": DRAWS,
        "arguments": plain(given),
        **plain(values),
    }


def read_runs(folder: Path) -> list[dict[str, Any]]:
    """Runs that the record of a folder holds; none where there is no record.

    Raises:
        TorchweatherError: the file is damaged or no record.
    """
    path = folder / NAME
    if not path.is_file():
        return []
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
        runs = content["runs"] if content["format"] == FORMAT else None
    except (ValueError, RecursionError, KeyError, TypeError):
        runs = None
    if not isinstance(runs, list) or not all(isinstance(run, dict) for run in runs):
        raise TorchweatherError(
            f"{path}: expected a record of format {FORMAT}; it is damaged or something else. Move it away, or give "
            "--no-record or another --out."
        )
    return runs


def write_run(folder: Path, run: Mapping[str, Any], earlier: Sequence[Mapping[str, Any]] = ()) -> Path:
    """Write the record with a further run; of ``earlier`` ones what this run wrote anew leaves."""
    from torchweather.core.atomic import atomic_write

    written = {entry.get("output") for entry in run.get("files", ())}
    kept = []
    for one in earlier:
        files = one.get("files")
        if isinstance(files, list):
            left = [entry for entry in files if isinstance(entry, dict) and entry.get("output") not in written]
            if left:
                kept.append({**one, "files": left})
    path = folder / NAME
    with atomic_write(path) as unfinished:
        content = {"format": FORMAT, "runs": [*kept, run]}
        unfinished.write_text(json.dumps(content, indent=1, allow_nan=False) + "\n", encoding="utf-8")
    return path
