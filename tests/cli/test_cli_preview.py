"""torchweather apply --preview: a page beside each result, of images in three severities and of clouds."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
import torch

from torchweather.atmosphere.weather import Fog, Mixture, Rain, Snow
from torchweather.cli import main
from torchweather.cli.preview import severities
from torchweather.io import read_image, write_image, write_points

GREY = torch.full((3, 24, 32), 120, dtype=torch.uint8)


def applied(capsys: pytest.CaptureFixture[str], *arguments: object) -> dict[str, object]:
    assert main(["apply", *map(str, arguments), "--preview", "--json"]) == 0
    (entry,) = json.loads(capsys.readouterr().out)["files"]
    return dict(entry)


def test_severities_lie_on_both_sides_and_within_what_a_draw_holds() -> None:
    rates = [one.rate_mm_per_h for _, one in severities(Rain(40.0))]
    assert rates == [40.0, 10.0, 100.0]
    assert [one.rate_mm_per_h for _, one in severities(Snow(1.0))] == [1.0, 0.25, 4.0]
    both = severities(Mixture(Rain(4.0), Fog(mor_m=400.0)))
    assert [[part.intensity for part in one.parts] for _, one in both] == [[400.0, 4.0], [1600.0, 1.0], [100.0, 16.0]]


def test_an_image_gets_a_page_with_three_pictures(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    write_image(tmp_path / "a.png", GREY)
    options = ("--weather", "fog:mor=100", "--depth", 40, "--airlight", 0.6, 0.6, 0.6, "-o", tmp_path / "out")
    entry = applied(capsys, tmp_path / "a.png", *options)
    page = Path(str(entry["preview"])).read_text(encoding="utf-8")
    assert entry["depth"] == "exact"
    for words in ("Fog of 100 m", "Fog of 400 m", "Fog of 25 m", "Depth exact", "given"):
        assert words in page
    assert page.count("data:image/") >= 4  # clear and three severities
    assert not torch.equal(read_image(tmp_path / "out/a.png")[0], GREY)


def test_a_raw_frame_is_developed_for_its_page(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    raw = torch.full((1, 24, 32), 900, dtype=torch.int32).to(torch.uint16)
    write_image(tmp_path / "raw.png", raw)
    options = ("--weather", "snow:rate=1", "--depth", 40, "--airlight", 0.6, 0.6, 0.6, "-o", tmp_path / "out")
    entry = applied(capsys, tmp_path / "raw.png", *options)
    assert Path(str(entry["preview"])).read_text(encoding="utf-8").count("data:image/") >= 4


def test_a_cloud_gets_a_page_with_its_counts(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    rows = torch.zeros(200, 4)
    rows[:, 0] = torch.linspace(5.0, 60.0, 200)
    rows[:, 3] = 0.5
    write_points(tmp_path / "a.bin", rows)
    sensor = ("--sensor", "lidar:velodyne-hdl-64e", "--intensity-unit", "reflectivity", "--weather", "fog:mor=50")
    entry = applied(capsys, tmp_path / "a.bin", *sensor, "-o", tmp_path / "out")
    page = Path(str(entry["preview"])).read_text(encoding="utf-8")
    assert "200" in page
    assert "http://" not in page.replace("http://www.w3.org", "")
    assert "https://" not in page
