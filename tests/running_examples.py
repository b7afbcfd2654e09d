"""Runs an example as the command line does, but in this process: a new one takes two seconds to load torch."""

from __future__ import annotations

import contextlib
import importlib
import io
import os
import runpy
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from unittest import mock

__all__ = ["EXAMPLES", "Done", "load_example", "run_example"]

EXAMPLES = Path(__file__).parents[1] / "examples"


def load_example(name: str) -> Any:
    """The module of a file in ``examples/`` or ``examples/parts/``; its main job is not run."""
    with mock.patch.object(sys, "path", [str(EXAMPLES), *sys.path]):
        return importlib.import_module(".".join(Path(name).with_suffix("").parts))


@dataclass(frozen=True)
class Done:
    """What a run left: its exit status and what it printed."""

    returncode: int
    stdout: str
    stderr: str


def run_example(name: str, arguments: list[str], folder: Path, **environment: str) -> Done:
    """An example of ``examples/`` in a folder of its own, without recordings unless ``environment`` names some.

    Args:
        name: of the file.
        arguments: of its command line.
        folder: in which it runs; packages there can be imported.
        environment: variables beside those of this process.
    """
    out, err = io.StringIO(), io.StringIO()
    status: object = 0
    with (
        _as_if_alone(name, arguments, folder, environment),
        contextlib.redirect_stdout(out),
        contextlib.redirect_stderr(err),
    ):
        try:
            runpy.run_path(str(EXAMPLES / name), run_name="__main__")
        except SystemExit as stop:  # a text is printed and means 1
            status = stop.code or 0
            if not isinstance(status, int):
                print(status, file=sys.stderr)
                status = 1
    assert isinstance(status, int)
    return Done(status, out.getvalue(), err.getvalue())


@contextlib.contextmanager
def _as_if_alone(name: str, arguments: list[str], folder: Path, environment: dict[str, str]) -> Iterator[None]:
    """Arguments, folder, path and environment of a new process, taken back afterwards."""
    without = {key: value for key, value in os.environ.items() if key != "TORCHWEATHER_REAL_DATA"}
    with (
        contextlib.chdir(folder),
        mock.patch.dict(os.environ, {**without, "MPLBACKEND": "Agg", **environment}, clear=True),
        mock.patch.object(sys, "argv", [name, *arguments]),
        mock.patch.object(sys, "path", [str(EXAMPLES), *sys.path, str(folder)]),
    ):
        importlib.invalidate_caches()  # of packages that the test has just written
        yield
