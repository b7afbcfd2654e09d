"""The command line as tests call it: words in, exit code and both outputs out."""

from __future__ import annotations

from collections.abc import Callable

import pytest

from tests.cli.bare import bare
from torchweather.cli import main

Run = Callable[..., tuple[int, str, str]]


@pytest.fixture
def run(request: pytest.FixtureRequest, capsys: pytest.CaptureFixture[str]) -> Run:
    """Exit code, standard output and standard error of a command.

    A module sets ``COMMAND`` to the words that all its commands begin with, and ``AS_TYPED = True`` to leave seeds and
    records as users have them; by default they are `bare`.
    """
    first = getattr(request.module, "COMMAND", ())
    prepared = (lambda argv: [str(one) for one in argv]) if getattr(request.module, "AS_TYPED", False) else bare

    def call(*argv: object) -> tuple[int, str, str]:
        code = main(prepared([*first, *argv]))
        printed = capsys.readouterr()
        return code, printed.out, printed.err

    return call
