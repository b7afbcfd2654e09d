"""The page of a point cloud: whole in itself, counts of the cloud, points as they were, bounded."""

from __future__ import annotations

import base64
import inspect
import json
import math
import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from torch import Tensor

from tests.recordings import recording
from tests.report.parsed_page import Page
from torchweather.atmosphere.weather import Weather, parse_weather
from torchweather.core.errors import TorchweatherError
from torchweather.datasets import read_kitti_points
from torchweather.report.cloud_counts import cloud_counts, has_return
from torchweather.report.cloud_view import MOST_POINTS, write_cloud_view
from torchweather.report.view_points import counts_by_range, thinned, view_points
from torchweather.report.view_words import share_text, weather_words
from torchweather.sensors import Lidar, scan_directions
from torchweather.transforms import LidarResult, LidarWeather

SNOW = parse_weather("snow:rate=2")


def lidar(**fields: Any) -> Lidar:
    return replace(Lidar.preset("velodyne-hdl-64e"), intensity_unit="reflectivity", **fields)


def points(rows: int = 3000) -> Tensor:
    """Points all around at 2 to 90 m, some rows without a return."""
    random = torch.Generator().manual_seed(4)
    way = torch.randn(rows, 3, generator=random) * torch.tensor([1.0, 1.0, 0.1])
    ranges = 2 + 88 * torch.rand(rows, 1, generator=random) ** 2
    cloud = torch.cat([way / way.norm(dim=-1, keepdim=True) * ranges, torch.rand(rows, 1, generator=random)], -1)
    cloud[::17] = 0.0
    return cloud


def sweep(sensor: Lidar) -> Tensor:
    """A turn of the sensor, ring after ring, at 5 to 60 m; a fourth of its beams return nothing."""
    random = torch.Generator().manual_seed(4)
    way = scan_directions(sensor)
    ranges = 5 + 55 * torch.rand(len(way), 1, generator=random) ** 2
    cloud = torch.cat([way * ranges, torch.rand(len(way), 1, generator=random)], -1)
    return cloud[torch.rand(len(way), generator=random) > 0.25]


def weathered(cloud: Tensor, sensor: Lidar, weather: Weather = SNOW, **options: Any) -> LidarResult:
    transform = LidarWeather(weather, sensor, **options)
    return transform.run(cloud, transform.draw(cloud, seed=7))


def written(path: Path, cloud: Tensor, sensor: Lidar, result: LidarResult, **more: Any) -> tuple[dict[str, Any], Page]:
    given = {"weather": SNOW, "seed": 7, "name": "a.bin", "sensor_name": "lidar:velodyne-hdl-64e", **more}
    summary = write_cloud_view(path, cloud, result, sensor, **given)
    return summary, Page(path.read_text(encoding="utf-8"))


def data_of(path: Path) -> dict[str, Any]:
    text = path.read_text(encoding="utf-8")
    (found,) = re.findall(r'<script type="application/json" id="data">(.*?)</script>', text, re.DOTALL)
    values: dict[str, Any] = json.loads(found)
    return values


def arrays_of(data: dict[str, Any], name: str) -> tuple[Any, Any, Any]:
    entry = data[name]
    position = np.frombuffer(base64.b64decode(entry["position"]), "<i2").reshape(-1, 3) * data["step_m"]
    intensity = np.frombuffer(base64.b64decode(entry["intensity"]), "<u2") * (data["intensity_full"] / 65535)
    kind = np.frombuffer(base64.b64decode(entry["kind"]), "u1")
    assert entry["count"] == len(position) == len(intensity) == len(kind)
    return position, intensity, kind


def assert_self_contained(page: Page, text: str) -> None:
    assert not page.mistakes
    assert all(str(image["src"]).startswith("data:") for image in page.all("img"))
    assert [link["href"] for link in page.all("link")] == ["data:,"]
    assert all("src" not in script for script in page.all("script"))
    assert not re.search(r"https?://", text)
    assert not re.search(r"url\((?!data:)|@import", text)


def test_the_page_needs_nothing_else_and_says_what_it_shows(tmp_path: Path) -> None:
    cloud = points()
    note = "No --sensor was given: the default preset is assumed."
    _, page = written(tmp_path / "a.html", cloud, lidar(), weathered(cloud, lidar()), notes=[note], alerts=["Doubt."])
    assert_self_contained(page, (tmp_path / "a.html").read_text(encoding="utf-8"))
    for said in ("snow of 2 mm/h", "seed 7", "lidar:velodyne-hdl-64e", note, "Doubt."):
        assert said in page.words
    buttons = {str(value) for button in page.all("button") for value in button.values()}
    assert {"clear", "weather", "0", "1", "2", "above"} <= buttons
    assert [path.name for path in tmp_path.iterdir()] == ["a.html"]


@pytest.mark.parametrize("options", [{}, {"lost": "nan"}, {"lost": "drop"}, {"complete_scan": True}], ids=str)
@pytest.mark.parametrize("mode", ["strongest", "dual"])
def test_counts_are_those_of_the_cloud(tmp_path: Path, options: dict[str, Any], mode: str) -> None:
    sensor, cloud = lidar(return_mode=mode), points()
    if options.get("complete_scan"):
        sensor = replace(sensor, columns=64, origin_heights_m=None)
        cloud = sweep(sensor)
    result = weathered(cloud, sensor, **options)
    summary, page = written(tmp_path / "a.html", cloud, sensor, result)
    hit = has_return(cloud, sensor)
    wanted = cloud_counts(hit, result)
    second = {name: wanted.get(f"second_{name}", 0) for name in ("objects", "particles")}
    assert summary["points"] == int(hit.sum())
    assert summary["objects"] == wanted["objects"] + second["objects"]
    assert summary["particles"] == wanted["particles"] + second["particles"]
    assert summary["lost"] == wanted["lost"] > 0
    assert summary["particles"] > 0
    assert (summary["shown_clear"], summary["stride"]) == (summary["points"], 1)
    shown = [int(str(cell["data-count"])) for cell in page.all("td") if "data-count" in cell]
    rows = np.array(shown).reshape(-1, 4)
    assert rows[:-1].sum(0).tolist() == rows[-1].tolist()
    assert rows[-1].tolist() == [summary[name] for name in ("points", "objects", "particles", "lost")]
    assert [str(row["data-range"]) for row in page.all("th") if "data-range" in row][-1] == "all"


def test_points_of_each_range_are_counted_where_they_are() -> None:
    cloud = points()
    sensor = lidar()
    clear, seen = view_points(cloud, weathered(cloud, sensor), sensor)
    for row in counts_by_range(clear, seen)[:-1]:
        low, high = (float(word) for word in (row.label.replace("and more", "to inf")).split(" to "))
        ranges = clear.xyz_m.norm(dim=-1)
        assert row.clear == int(((ranges >= low) & (ranges < high)).sum())


def test_arrays_come_back_from_the_page_within_half_a_step(tmp_path: Path) -> None:
    cloud, sensor = points(), lidar()
    result = weathered(cloud, sensor)
    written(tmp_path / "a.html", cloud, sensor, result)
    data = data_of(tmp_path / "a.html")
    for name, wanted in zip(("clear", "weather"), view_points(cloud, result, sensor), strict=True):
        position, intensity, kind = arrays_of(data, name)
        assert np.abs(position - wanted.xyz_m.numpy()).max() <= data["step_m"] / 2 * (1 + 1e-6)
        assert np.abs(intensity - wanted.intensity.numpy()).max() <= data["intensity_full"] / 65535 / 2 * 1.001
        assert kind.tolist() == wanted.kind.tolist()
    assert data["step_m"] < 0.004  # 120 m in 15 bits


def test_without_weather_both_clouds_are_the_same(tmp_path: Path) -> None:
    cloud, sensor = points(), lidar()
    clear_air = parse_weather("snow:rate=0")
    summary, _ = written(tmp_path / "a.html", cloud, sensor, weathered(cloud, sensor, clear_air), weather=clear_air)
    data = data_of(tmp_path / "a.html")
    assert data["clear"] == data["weather"]
    assert (summary["particles"], summary["lost"]) == (0, 0)


def test_a_large_cloud_is_thinned_and_the_page_says_so(tmp_path: Path) -> None:
    cloud, sensor = points(), lidar(return_mode="dual")
    result = weathered(cloud, sensor)
    whole, _ = written(tmp_path / "whole.html", cloud, sensor, result)
    small, page = written(tmp_path / "small.html", cloud, sensor, result, most_points=400)
    assert max(small["shown_clear"], small["shown_weather"]) <= 400
    assert max(small["shown_clear"], small["shown_weather"]) > 200
    assert f"one beam in {small['stride']}" in page.words
    for name in ("points", "objects", "particles", "lost"):
        assert small[name] == whole[name]
    data = data_of(tmp_path / "small.html")
    assert data["clear"]["count"] == small["shown_clear"]


def test_the_same_beams_are_shown_in_clear_air_and_in_weather() -> None:
    cloud, sensor = points(), lidar()
    clear, seen, stride = thinned(*view_points(cloud, weathered(cloud, sensor), sensor), 500)
    assert stride > 1
    assert set(clear.beam.tolist()) == set(seen.beam.tolist())


def test_a_page_has_at_most_nine_bytes_a_point(tmp_path: Path) -> None:
    assert inspect.signature(write_cloud_view).parameters["most_points"].default == MOST_POINTS == 300_000
    cloud, sensor, most = points(rows=70_000), lidar(), 30_000
    result = weathered(cloud, sensor, parse_weather("fog:mor=500"))
    summary, _ = written(tmp_path / "a.html", cloud, sensor, result, most_points=most)
    # Two clouds in base64, a third more than their bytes, and 60 kB of page.
    assert summary["bytes"] < 2 * most * 9 * 4 / 3 + 60_000
    assert most / 2 < summary["shown_clear"] <= most


def test_names_and_notes_are_text_and_not_markup(tmp_path: Path) -> None:
    cloud, sensor = points(200), lidar()
    evil = "</script><script>alert(1)</script>.bin"
    _, page = written(
        tmp_path / "a.html", cloud, sensor, weathered(cloud, sensor), name=evil, notes=[evil], sensor_name=evil
    )
    text = (tmp_path / "a.html").read_text(encoding="utf-8")
    assert "<script>alert" not in text
    assert len(page.all("script")) == 3
    assert evil in page.words
    assert not page.mistakes


def test_a_cloud_without_intensity_offers_no_colour_by_intensity(tmp_path: Path) -> None:
    cloud, sensor = points(200), replace(lidar(), intensity_unit="none")
    cloud[:, 3] = 1.0
    _, page = written(tmp_path / "a.html", cloud, sensor, weathered(cloud, sensor))
    assert {button.get("data-colour") for button in page.all("button")} == {None, "0", "2"}


@pytest.mark.parametrize("rows", [0, 1])
def test_an_empty_cloud_has_a_page(tmp_path: Path, rows: int) -> None:
    cloud, sensor = torch.zeros(rows, 4), lidar()
    summary, page = written(tmp_path / "a.html", cloud, sensor, weathered(cloud, sensor))
    assert summary["points"] == summary["objects"] == 0
    assert not page.mistakes


def test_mistakes_leave_no_page(tmp_path: Path) -> None:
    cloud, sensor = points(100), lidar()
    result = weathered(cloud, sensor)
    with pytest.raises(ValueError, match="most_points"):
        written(tmp_path / "a.html", cloud, sensor, result, most_points=0)
    with pytest.raises(ValueError, match="without batch"):
        written(tmp_path / "a.html", cloud[None], sensor, weathered(cloud[None], sensor))
    with pytest.raises(TorchweatherError, match="no folder"):
        written(tmp_path / "none" / "a.html", cloud, sensor, result)
    assert not list(tmp_path.iterdir())


def test_shares_never_round_to_none_or_all() -> None:
    assert share_text(0, 10) == "0 %"
    assert share_text(10, 10) == "100 %"
    assert "100" not in share_text(999_999, 1_000_000)
    assert share_text(1, 1_000_000) == "< 0.1 %"
    assert weather_words(parse_weather("snow:rate=1+fog:mor=200")) == "fog of 200 m visibility and snow of 1 mm/h"


@pytest.mark.real_data
def test_a_real_sweep_in_snow_loses_far_points_and_gains_near_ones(tmp_path: Path) -> None:
    file = recording("kitti_13/velodyne/000008.bin")
    cloud, sensor = read_kitti_points(file), lidar()
    result = weathered(cloud, sensor, parse_weather("snow:rate=1"))
    summary, page = written(tmp_path / "a.html", cloud, sensor, result, weather=parse_weather("snow:rate=1"))
    assert summary["points"] == len(cloud)
    assert summary["bytes"] < 4e6
    assert_self_contained(page, (tmp_path / "a.html").read_text(encoding="utf-8"))
    clear, seen = view_points(cloud, result, sensor)
    rows = counts_by_range(clear, seen)[:-1]
    left = [row.objects / row.clear for row in rows if row.clear > 500]
    assert left == sorted(left, reverse=True)  # fog and snow dim the far ones more
    assert rows[0].particles > 0.5 * summary["particles"]
    assert math.isclose(sum(row.clear for row in rows), len(cloud))
