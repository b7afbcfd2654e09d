"""Command line of the scripts that draw effects: which effects, how many frames, into which folder."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import matplotlib as mpl
from effect_drawing import save
from matplotlib.figure import Figure

from torchweather.report.figures import STYLE
from torchweather.stages import EFFECTS

__all__ = ["parsed", "write_all"]


def parsed(
    about: str | None, pictures: Mapping[str, Any], out: str, frames: int, **more: tuple[int, str]
) -> argparse.Namespace:
    """Arguments of the command line; an effect without a picture is refused.

    Args:
        about: docstring of the script.
        pictures: by the id of their effect.
        out: folder unless another one is given.
        frames: over which statistics are taken unless given.
        more: further options, each with its usual value and its help.
    """
    parser = argparse.ArgumentParser(description=about, formatter_class=argparse.RawDescriptionHelpFormatter)
    some = next(iter(pictures))
    parser.add_argument("effects", nargs="*", metavar="EFFECT", help=f"ids such as {some}; all unless given")
    parser.add_argument("--out", type=Path, default=Path(out), help="folder")
    parser.add_argument("--frames", type=int, default=frames, help="over which statistics are taken")
    for name, (usual, text) in more.items():
        parser.add_argument(f"--{name.replace('_', '-')}", type=int, default=usual, help=text)
    arguments = parser.parse_args()
    unknown = sorted(set(arguments.effects) - set(pictures))
    if unknown:
        parser.error(f"no such effect: {', '.join(unknown)}; known are {', '.join(pictures)}")
    return arguments


def write_all(
    arguments: argparse.Namespace, pictures: Mapping[str, Any], draw: Callable[[str], Figure], colours: int
) -> None:
    """Write the picture of every effect that was asked for, and print where it lies."""
    arguments.out.mkdir(parents=True, exist_ok=True)
    for name in arguments.effects or pictures:
        path = arguments.out / f"{name}.png"
        with mpl.rc_context({**STYLE, "font.size": 9.0}):
            save(draw(name), path, colours)
        print(f"{EFFECTS[name].title}: {path}")
