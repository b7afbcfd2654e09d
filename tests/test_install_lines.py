"""Every installation that a page or a message names works from a clone: its extras and folders exist."""

from __future__ import annotations

import re
import shlex
import tomllib
from pathlib import Path

import pytest

from tests.test_docs import PAGES, name_of
from torchweather.core.extras import install_hint

ROOT = Path(__file__).parents[1]
EXTRAS = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]["optional-dependencies"]
INSTALL = re.compile(r"pip install ([^`&\n]*)")
OTHERS = ("pre-commit",)  # packages of others that pages name


def targets(words: str) -> list[str]:
    """What a ``pip install`` is given beside its options."""
    given, found = iter(shlex.split(words, comments=True)), []
    for word in given:
        if word in ("-c", "--extra-index-url"):
            next(given)
        elif not word.startswith("-"):
            found.append(word)
    return found


@pytest.mark.parametrize("page", [*PAGES, ROOT / "CONTRIBUTING.md"], ids=name_of)
def test_what_a_page_installs_is_in_the_clone(page: Path) -> None:
    for words in INSTALL.findall(page.read_text(encoding="utf-8")):
        for target in targets(words):
            folder, _, named = target.partition("[")
            assert target in OTHERS or (ROOT / folder).is_dir(), f"pip install {words}"
            assert not named or set(named.rstrip("]").split(",")) <= set(EXTRAS), f"pip install {words}"


def test_a_hint_on_an_extra_names_the_clone() -> None:
    assert "-e '.[video]'" in install_hint("video")
