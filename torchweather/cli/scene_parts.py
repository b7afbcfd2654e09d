"""Option of the commands that look whether a scene is the same in weather as in clear air."""

from __future__ import annotations

import argparse

__all__ = ["add_ignored_parts"]


def add_ignored_parts(parser: argparse.ArgumentParser, said: str) -> None:
    """Add ``--ignore-parts``, which leaves parts of a camera's picture out.

    Args:
        parser: of the command.
        said: help; it names where the parts are listed.
    """
    parser.add_argument("--ignore-parts", nargs="+", action="extend", default=[], metavar="SCENE:ROW,COLUMN", help=said)
