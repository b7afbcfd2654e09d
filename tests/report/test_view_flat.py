"""Side view and angles of the page of a cloud: particles under the ground are counted and marked."""

from __future__ import annotations

import re
import shutil
import subprocess
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from PIL import Image
from torch import Tensor

from tests.recordings import recording
from tests.report.parsed_page import Page
from tests.report.test_cloud_view import data_of, written
from torchweather.atmosphere.weather import parse_weather
from torchweather.datasets import read_kitti_points
from torchweather.lidar import fit_ground
from torchweather.report.view_flat import BELOW_COLOUR, flat_view, under_ground
from torchweather.report.view_points import ViewPoints, view_points
from torchweather.sensors import Lidar
from torchweather.stages import PointKind
from torchweather.transforms import LidarResult, LidarWeather

HEIGHT_M = 1.8
SENSOR = Lidar(905.0, intensity_unit="reflectivity")


def road(slope_x: float = 0.02, slope_y: float = -0.03) -> Tensor:
    """A road 40 m around, ``(N, 4)``, that rises ahead and falls to the left."""
    random = torch.Generator().manual_seed(1)
    xy = 80.0 * (torch.rand(6000, 2, generator=random) - 0.5)
    xy = xy[xy.norm(dim=-1) > 3.0]
    z = -HEIGHT_M + slope_x * xy[:, 0] + slope_y * xy[:, 1]
    return torch.cat([xy, z[:, None], torch.full((len(xy), 1), 0.3)], -1)


def with_flakes(cloud: Tensor, flakes: Tensor) -> LidarResult:
    """A result whose last rows are flakes of beams that were appended."""
    transform = LidarWeather(parse_weather("snow:rate=0"), SENSOR)
    plain = transform.run(cloud, transform.draw(cloud, seed=0))
    rows = torch.cat([flakes, torch.full((len(flakes), 1), 0.1)], -1)
    more: dict[str, Any] = {}
    for name, added in (
        ("points", rows),
        ("kind", torch.full((len(flakes),), int(PointKind.PARTICLE), dtype=torch.int8)),
        ("source", torch.full((len(flakes),), -1)),
        ("transmission", torch.ones(len(flakes))),
    ):
        value = getattr(plain, name)
        assert isinstance(value, Tensor)
        more[name] = torch.cat([value, added.to(value)])
    return replace(plain, **more)


# Above the road, a little and far under it, and under it but farther than the plane holds.
FLAKES = torch.tensor(
    [[5.0, 0.0, -1.0], [5.0, 5.0, -1.8], [10.0, -4.0, -1.7], [-8.0, 2.0, -5.0], [3.0, 20.0, -3.0], [45.0, 0.0, -8.0]]
)
UNDER = 2


def test_particles_under_the_ground_are_counted(tmp_path: Path) -> None:
    cloud = road()
    result = with_flakes(cloud, FLAKES)
    clear, seen = view_points(cloud, result, SENSOR)
    _, plane = flat_view(clear, seen, 50.0)
    assert plane is not None
    # The slower count, point by point.
    slow = sum(
        x * x + y * y < 40.0**2 and z < -HEIGHT_M + 0.02 * x - 0.03 * y - 0.3 for x, y, z in FLAKES.double().tolist()
    )
    assert under_ground(seen, plane) == slow == UNDER
    summary, page = written(tmp_path / "a.html", cloud, SENSOR, result)
    assert summary["under_ground"] == UNDER
    assert [str(found["data-under"]) for found in page.all("strong") if "data-under" in found] == [str(UNDER)]
    assert "2 of 6 particles" in page.words
    assert not page.mistakes


def test_the_ground_of_the_page_is_the_road(tmp_path: Path) -> None:
    cloud = road()
    written(tmp_path / "a.html", cloud, SENSOR, with_flakes(cloud, FLAKES))
    flat = data_of(tmp_path / "a.html")["flat"]
    ground = flat["ground"]
    assert [ground[key] for key in ("height_m", "slope_x", "slope_y")] == pytest.approx([-1.8, 0.02, -0.03], abs=5e-3)
    low, high = flat["side_z_m"]
    assert low < -5.0  # as deep as the deepest flake near the sensor
    assert high >= 5.0
    assert flat["side_x_m"] == [-50.0, 50.0] or flat["side_x_m"][1] >= 40.0
    assert flat["elevation_deg"][0] < -20.0


def test_without_a_ground_the_page_says_so(tmp_path: Path) -> None:
    random = torch.Generator().manual_seed(2)
    cloud = torch.cat([20 + torch.rand(300, 3, generator=random), torch.ones(300, 1)], -1)
    summary, page = written(tmp_path / "a.html", cloud, SENSOR, with_flakes(cloud, FLAKES))
    assert summary["under_ground"] is None
    assert "No ground was found" in page.words


def test_a_cloud_in_the_vehicles_frame_is_seen_from_the_sensor() -> None:
    cloud = road()
    away = torch.tensor([1.43, 0.0, 2.18])
    moved = torch.cat([cloud[:, :3] + away, cloud[:, 3:]], -1)
    sensor = Lidar(905.0, intensity_unit="reflectivity", origin_m=(1.43, 0.0, 2.18))
    transform = LidarWeather(parse_weather("snow:rate=0"), sensor)
    clear, _ = view_points(moved, transform.run(moved, transform.draw(moved, seed=0)), sensor)
    assert torch.allclose(clear.xyz_m, cloud[:, :3], atol=1e-5)


def test_an_empty_cloud_has_axes() -> None:
    nothing = ViewPoints(torch.zeros(0, 3), torch.zeros(0), torch.zeros(0, dtype=torch.uint8), torch.zeros(0))
    flat, plane = flat_view(nothing, nothing, 0.0)
    assert plane is None
    assert all(low < high for low, high in (flat["side_x_m"], flat["side_z_m"], flat["elevation_deg"]))


def screenshot(page: Path, picture: Path, width: int, height: int) -> np.ndarray[Any, Any]:
    browser = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
    if browser is None:
        pytest.skip("no Chromium here")
    flags = ["--headless=new", "--no-sandbox", "--use-gl=angle", "--use-angle=swiftshader", "--hide-scrollbars"]
    more = [f"--window-size={width},{height}", "--virtual-time-budget=8000", f"--screenshot={picture}", page.as_uri()]
    subprocess.run([browser, *flags, *more], check=True, capture_output=True, timeout=120)
    return np.asarray(Image.open(picture).convert("RGB"))


@pytest.mark.parametrize("width", [1400, 500])
def test_the_browser_marks_them_under_a_line(tmp_path: Path, width: int) -> None:
    """Pixels of the mark are on the page where flakes are under the road, and only then."""
    height = 3200 if width < 900 else 1500
    frames = ""
    for name, flakes in (("under", FLAKES[3:5]), ("above", FLAKES[:1])):
        page = tmp_path / f"{name}.html"
        written(page, road(), SENSOR, with_flakes(road(), flakes))
        assert len(re.findall("<canvas", page.read_text(encoding="utf-8"))) == 3
        frames += f'<iframe src="{page.as_uri()}" width="{width}" height="{height}" style="border:0"></iframe>'
    # Side by side, each as wide as in a window of its own: a browser takes a second to start.
    both = tmp_path / "both.html"
    both.write_text(f'<body style="margin:0;display:flex">{frames}</body>', encoding="utf-8")
    image = screenshot(both, tmp_path / "both.png", 2 * width, height).astype(int)
    colour = [int(BELOW_COLOUR[at : at + 2], 16) for at in (1, 3, 5)]
    # The dot of the caption has the colour too.
    marked = [int((np.abs(half - colour).sum(-1) < 6).sum()) for half in np.split(image, 2, axis=1)]
    assert marked[0] - marked[1] >= 8  # two flakes of four pixels or more, in two pictures
    assert marked[1] < 120


@pytest.mark.real_data
def test_beams_to_the_maximum_range_show_flakes_under_the_road() -> None:
    """What the view was made for: of KITTI's sweep a third of the flakes lay under the road."""
    cloud = read_kitti_points(recording("kitti_13/velodyne/000008.bin"))
    sensor = Lidar.preset("velodyne-hdl-64e", intensity_unit="reflectivity")
    assert fit_ground(cloud.numpy()) is not None
    shares = []
    for beam_ends in ("max_range", "scene"):
        transform = LidarWeather(parse_weather("snow:rate=1"), sensor, complete_scan=True, beam_ends=beam_ends)
        clear, seen = view_points(cloud, transform.run(cloud, transform.draw(cloud, seed=1)), sensor)
        particles = int((seen.kind == PointKind.PARTICLE).sum())
        shares.append(under_ground(seen, flat_view(clear, seen, 50.0)[1]) / particles)
    assert shares[0] > 0.2
    assert shares[1] < 0.002


def test_the_page_is_parsed(tmp_path: Path) -> None:
    cloud = road()
    written(tmp_path / "a.html", cloud, SENSOR, with_flakes(cloud, FLAKES))
    page = Page((tmp_path / "a.html").read_text(encoding="utf-8"))
    assert {str(canvas["id"]) for canvas in page.all("canvas")} == {"canvas", "side", "angles"}
