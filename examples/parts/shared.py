"""Parts that every longer example needs: a command line, the place of recordings, files that are written whole."""

from __future__ import annotations

import argparse
import json
import os
import sys
from pathlib import Path
from typing import Any

from torchweather.io import atomic_write

__all__ = ["command_line", "recordings", "write_figure", "write_json"]


def command_line(about: str | None) -> argparse.ArgumentParser:
    """Options of an example, with its docstring as help."""
    return argparse.ArgumentParser(description=about, formatter_class=argparse.RawDescriptionHelpFormatter)


def recordings(given: Path | None, *names: str) -> Path:
    """Folder that was given, else the one of this name in TORCHWEATHER_REAL_DATA; leaves where there is neither."""
    root = os.environ.get("TORCHWEATHER_REAL_DATA")
    if given is None and not root:
        sys.exit(f"no recording: give --data FOLDER, or set TORCHWEATHER_REAL_DATA to a folder with {names[0]}/")
    return given or Path(root or "", *names)


def write_json(path: Path, values: Any) -> None:
    """Write values, whole or not at all."""
    with atomic_write(path) as unfinished:
        unfinished.write_text(json.dumps(values, indent=1), encoding="utf-8")


def write_figure(path: Path, figure: Any, dpi: float) -> None:
    """Write a figure of matplotlib, whole or not at all, and close it."""
    from matplotlib import pyplot as plt

    with atomic_write(path) as unfinished:
        figure.savefig(unfinished, dpi=dpi)
    plt.close(figure)
