"""What `import torchweather` offers, and that it costs nothing before it is used."""

from __future__ import annotations

import importlib
import subprocess
import sys

import pytest

import torchweather
from tests.public_names import MODULES, names_of, written


def test_importing_the_library_does_not_import_torch() -> None:
    code = "import sys, torchweather; sys.exit('torch' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0


PARTS = (
    "export",
    "gap",
    "image",
    "io",
    "metrics",
    "physics",
    "radar",
    "robustness",
    "scenes",
    "stages",
    "sweep",
    "transforms",
)


def test_parts_are_reached_without_an_import_of_their_own() -> None:
    # Each as the first of a library that is loaded anew, in one process: torch takes the time.
    code = f"""
import sys
import torch
for part in {PARTS}:
    for name in [name for name in sys.modules if name.split(".")[0] == "torchweather"]:
        del sys.modules[name]
    import torchweather
    assert not [name for name in sys.modules if name.startswith("torchweather.")], part
    print(getattr(torchweather, part).__name__)
"""
    done = subprocess.run([sys.executable, "-c", code], check=True, capture_output=True, text=True)
    assert done.stdout.split() == [f"torchweather.{part}" for part in PARTS]


def test_every_public_name_is_there_and_unknown_ones_are_refused() -> None:
    for name in torchweather.__all__:
        assert getattr(torchweather, name) is not None
    with pytest.raises(AttributeError, match="LidarRian"):
        _ = torchweather.LidarRian


@pytest.mark.parametrize("module", list(MODULES))
def test_the_public_names_are_those_of_the_page(module: str) -> None:
    """After a change: ``python -m tests.public_names``, a line in CHANGELOG.md, and an old name where one goes."""
    assert written()[module] == names_of(module)


def test_every_public_name_exists() -> None:
    assert list(written()) == list(MODULES)
    for module, names in written().items():
        for name in names:
            assert hasattr(importlib.import_module(module), name), f"{module}.{name}"
