"""The README's pictures: their size, their licence, and the scripts that make them."""

from __future__ import annotations

import json
import sys
from pathlib import Path

import numpy as np
import pytest
from PIL import Image, ImageChops

from tests.test_docs_effects import module_of

ROOT = Path(__file__).parents[1]
IMAGES = ROOT / "docs" / "images"
FIGURES = ROOT / "docs" / "_figures"
PHOTOGRAPHS = sorted((IMAGES / "photographs").glob("*.jpg"))


# kB: what a page of the README may weigh.
@pytest.mark.parametrize(
    ("name", "width", "most_kb", "frames"),
    [
        ("readme_before_after.jpg", 1600, 250, 1),
        ("readme_snow.webp", 600, 1500, 24),
        ("readme_cloud.png", 1200, 200, 1),
    ],
)
def test_a_picture_of_the_readme_is_small(name: str, width: int, most_kb: int, frames: int) -> None:
    path = IMAGES / name
    with Image.open(path) as picture:
        assert picture.width == width
        assert getattr(picture, "n_frames", 1) == frames
    assert path.stat().st_size <= 1000 * most_kb


def test_every_photograph_has_its_author_and_licence() -> None:
    assert PHOTOGRAPHS
    sources = (IMAGES / "photographs" / "SOURCES.md").read_text(encoding="utf-8")
    notice = (ROOT / "NOTICE").read_text(encoding="utf-8")
    for path in PHOTOGRAPHS:
        assert f"## {path.name}\n" in sources
        section = sources.split(f"## {path.name}\n")[1].split("\n## ")[0]
        for row in ("| author |", "| licence |", "| taken from |", "| changed |"):
            assert row in section
        assert f"`{path.name}`" in notice
        assert path.stat().st_size <= 250_000
        with Image.open(path) as picture:
            assert picture.width <= 1600
            assert not picture.getexif()  # no place, no device


def test_the_script_weathers_the_photograph_and_moves_the_flakes(monkeypatch: pytest.MonkeyPatch) -> None:
    script = module_of(FIGURES / "readme_street.py")
    monkeypatch.setattr(script, "PICTURE_WIDTH", 648)
    monkeypatch.setattr(script, "FILM_WIDTH", 240)
    monkeypatch.setattr(script, "FILM_FRAMES", 2)
    settings = json.loads(script.PHOTOGRAPH.with_suffix(".json").read_text(encoding="utf-8"))

    sheet = script.before_after(script.PHOTOGRAPH, settings)
    width, height = (sheet.width - script.GAP) // 2, (sheet.height - script.GAP) // 2
    panels = [
        np.asarray(sheet.crop((x, y, x + width, y + height - 40)).convert("L"), dtype=float)
        for y in (0, height + script.GAP)
        for x in (0, width + script.GAP)
    ]
    # Edges of the far third of the picture: fog takes most of them, rain in thin mist less.
    clear, rain, fog, _ = (np.abs(np.diff(panel[: height // 3], axis=1)).mean() for panel in panels)
    assert fog < 0.35 * clear
    assert fog < rain < clear

    first, second = script.film(script.PHOTOGRAPH, settings)
    assert ImageChops.difference(first, second).getbbox() is not None
    again = script.film(script.PHOTOGRAPH, settings)
    assert again[1].tobytes() == second.tobytes()


def test_flakes_of_the_point_cloud_are_seen_in_their_own_colour() -> None:
    picture = np.asarray(module_of(FIGURES / "readme_cloud.py").cloud(256).convert("RGB"), dtype=int)
    orange = (picture[..., 0] > picture[..., 2] + 60).sum()
    grey = (np.ptp(picture, axis=-1) < 40) & (picture.min(-1) > 90)
    assert orange > 100
    assert grey.sum() > 100


@pytest.mark.parametrize("name", ["readme_pictures.py", "readme_detector.py"])
def test_a_script_takes_its_parts_and_writes_where_the_readme_looks(
    name: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    script = module_of(FIGURES / name)
    assert script.IMAGES == IMAGES
    monkeypatch.setattr(sys, "argv", ["", "--help"])
    with pytest.raises(SystemExit, match="0"):
        script.main()
    assert f"docs/_figures/{name}" in capsys.readouterr().out
