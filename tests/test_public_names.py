"""What `import torchweather` offers, and that it costs nothing before it is used."""

from __future__ import annotations

import subprocess
import sys

import pytest

import torchweather


def test_importing_the_library_does_not_import_torch() -> None:
    code = "import sys, torchweather; sys.exit('torch' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0


PARTS = ("export", "gap", "image", "io", "metrics", "physics", "radar", "scenes", "stages", "sweep", "transforms")


@pytest.mark.parametrize("part", PARTS)
def test_parts_are_reached_without_an_import_of_their_own(part: str) -> None:
    code = f"import torchweather; print(torchweather.{part}.__name__)"
    done = subprocess.run([sys.executable, "-c", code], check=True, capture_output=True, text=True)
    assert done.stdout.strip() == f"torchweather.{part}"


def test_every_public_name_is_there_and_unknown_ones_are_refused() -> None:
    for name in torchweather.__all__:
        assert getattr(torchweather, name) is not None
    with pytest.raises(AttributeError, match="LidarRian"):
        _ = torchweather.LidarRian
