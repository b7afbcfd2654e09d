"""Where the real recordings are, and the visible skip where they are not; cheap garbage and cheap figures."""

from __future__ import annotations

import gc
from collections.abc import Callable
from pathlib import Path
from typing import IO, Any

import pytest

from tests.recordings import recording

# Objects between two collections of the youngest, and collections of one generation between two of the next: at
# Python's 700, 10 and 10 collecting took 4 % of the processor.
COLLECT_AFTER = (20_000, 20, 20)
FEW_DPI = 25


@pytest.fixture
def real_data() -> Callable[[str], Path]:
    """Path of a real recording below the folder that TORCHWEATHER_REAL_DATA names."""
    return recording


@pytest.fixture
def undrawn(monkeypatch: pytest.MonkeyPatch) -> None:
    """Figures are built and laid on their pages, but not drawn: blank files of their size.

    For tests of commands whose pages tests/report draws and looks at: drawing took a third of their time.
    """
    from matplotlib.figure import Figure
    from PIL import Image

    def blank(figure: Figure, target: IO[bytes], *, format: str, dpi: float | None = None, **options: Any) -> None:
        if format == "svg":
            target.write(b'<svg xmlns="http://www.w3.org/2000/svg"/>')
            return
        width, height = figure.get_size_inches() * (dpi or figure.dpi)
        mode = "RGB" if format == "jpeg" else "RGBA"
        Image.new(mode, (round(width), round(height))).save(target, format=format, compress_level=1)

    monkeypatch.setattr(Figure, "savefig", blank)


@pytest.fixture
def few_dots(monkeypatch: pytest.MonkeyPatch) -> None:
    """Figures are drawn whole, of few dots: for examples and tutorials whose pictures must be written."""
    from matplotlib.figure import Figure

    savefig = Figure.savefig
    monkeypatch.setattr(Figure, "savefig", lambda *args, **options: savefig(*args, **{**options, "dpi": FEW_DPI}))


def pytest_collectstart() -> None:
    """No collection of garbage while tests are imported: nearly all of it stays."""
    gc.disable()


def pytest_collection_finish() -> None:
    """Leave what was imported and collected out of every later collection: walking it took up to a second each."""
    gc.collect()
    gc.freeze()
    gc.set_threshold(*COLLECT_AFTER)
    gc.enable()
