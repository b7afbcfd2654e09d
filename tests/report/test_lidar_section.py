"""The LiDAR's part of the demo page: clouds, pictures and numbers that belong together."""

from __future__ import annotations

import base64
import io
import json
import math
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from PIL import Image
from torch import Tensor

from torchweather.atmosphere.weather import Fog, Rain, Snow
from torchweather.io import read_points
from torchweather.lidar.scan import scan_directions
from torchweather.report import demo as demo_module
from torchweather.report import parts, radar_section
from torchweather.report.cloud_counts import cloud_counts, has_return
from torchweather.report.demo import SECTIONS, write_demo
from torchweather.report.lidar_figures import COLOURS, _cells, _colours, birds_eye_uri, range_images_uri
from torchweather.report.lidar_section import COLUMNS, lidar_part
from torchweather.report.lidar_views import LidarScene, WeatherCloud, lidar_scene
from torchweather.report.radar_section import RADAR_WEATHERS
from torchweather.report.report import Section
from torchweather.scenes import test_track as track
from torchweather.sensors import Camera, Lidar
from torchweather.stages import PointKind
from torchweather.transforms import LidarWeather

Written = tuple[Path, dict[str, Any], Section]
# A few rings and columns show the same in a fraction of the time.
SMALL: dict[str, Any] = {
    "elevations_deg": (2.0, 0.0, -1.0, -3.0, -6.0, -12.0),
    "columns": 240,
    "azimuth_offsets_deg": None,
    "origin_heights_m": None,
}
LIDAR = Lidar.preset("ouster-os1-128", **SMALL)


@pytest.fixture(scope="module")
def seen() -> LidarScene:
    return lidar_scene(track(), LIDAR, 0, ("car 28 m",))


def decoded(uri: str) -> Any:
    data = base64.b64decode(uri.removeprefix("data:image/png;base64,"))
    return np.asarray(Image.open(io.BytesIO(data)).convert("RGB")).astype(int)


def pixels_of(picture: Any, colour: str) -> int:
    """Pixels within a few grey levels of a colour."""
    wanted = np.array([int(colour[k : k + 2], 16) for k in (1, 3, 5)])
    return int((np.abs(picture - wanted).max(-1) <= 6).sum())


def test_the_numbers_of_a_cloud_are_those_of_its_points(seen: LidarScene) -> None:
    cloud = seen.render(Snow(2.0), seed=3)
    transform = LidarWeather(Snow(2.0), LIDAR)
    points = seen.view.points
    result = transform.run(points, transform.draw(points, seed=3), directions=seen.view.directions)
    assert isinstance(result.kind, Tensor)
    assert isinstance(result.points, Tensor)
    assert torch.equal(cloud.kind, result.kind)
    assert torch.equal(cloud.points, result.points)
    hit, numbers = seen.view.hit, cloud.numbers
    assert numbers["objects"] == int((cloud.kind == PointKind.OBJECT).sum())
    # A beam with a point in clear air keeps it, shows a flake, or is lost.
    assert numbers["share_objects"] + numbers["share_replaced"] + numbers["share_lost"] == pytest.approx(1, abs=1e-12)
    assert numbers["lost"] == int(cloud.lost.sum()) == round(numbers["share_lost"] * int(hit.sum()))
    particle = cloud.kind == PointKind.PARTICLE
    assert numbers["particles"] == int(particle.sum()) > 0
    assert numbers["share_particles_empty"] == pytest.approx(float((particle & ~hit).sum() / (~hit).sum()))
    assert numbers["particle_range_m"] == pytest.approx(float(cloud.points[particle, :3].norm(dim=-1).median()))
    assert numbers["extinction_per_m"] == pytest.approx(float(transform.extinction_per_m))
    assert seen.clear.numbers["points_car 28 m"] >= numbers["points_car 28 m"]
    assert seen.clear.numbers["points_car 28 m"] > 0


def test_counts_are_the_same_whether_lost_points_stay_or_go() -> None:
    points = torch.tensor([[60.0, 0.0, 0.0, 5.0], [0.0, 0.0, 0.0, 0.0], [1e-25, 0.0, 0.0, 0.0]]).repeat(200, 1)
    points[::3, 0] = torch.linspace(2, 110, 200)
    found = []
    for lost in ("zero", "nan", "drop"):
        transform = LidarWeather(Rain(40.0), LIDAR, lost=lost)
        result = transform.run(points, transform.draw(points, seed=1))
        found.append(cloud_counts(has_return(points, LIDAR), result))
    assert found[0]["empty_beams"] == 400
    assert found[0]["lost"] > 0
    assert found[0]["objects"] + found[0]["particles"] + found[0]["lost"] == 200
    # Where rows are gone, so are their transmissions.
    for one in found:
        one.pop("transmission_mean")
    assert found[0] == found[1] == found[2]


def test_every_beam_has_a_cell_of_its_own_in_the_range_image() -> None:
    for lidar in (LIDAR, Lidar.preset("ouster-os1-128"), Lidar.preset("velodyne-hdl-64e")):
        assert lidar.elevations_deg is not None
        assert lidar.columns is not None
        grid = (len(lidar.elevations_deg), lidar.columns)
        directions = scan_directions(lidar).reshape(-1, 3)
        rows, columns, elevations = _cells(directions, grid)
        assert len(set(zip(rows.tolist(), columns.tolist(), strict=True))) == grid[0] * grid[1]
        # Rows rise with elevation; columns run from behind over the left.
        assert (np.diff(elevations) >= 0).all()
        azimuth = torch.rad2deg(torch.atan2(directions[:, 1], directions[:, 0])).numpy()
        off = (180 - columns * 360 / grid[1] - azimuth + 180) % 360 - 180
        assert np.abs(off).max() <= 360 / grid[1] * (1 + 1e-3)
        sine = directions[:, 2].double().numpy()
        assert np.abs(np.rad2deg(np.arcsin(sine)) - elevations[rows]).max() < 1e-3


def few_points(kind: PointKind, lost: bool = False) -> WeatherCloud:
    points = torch.zeros(400, 5)
    points[:, 0], points[:, 1] = torch.linspace(20, 60, 400), 5.0
    kinds = torch.full((400,), int(kind), dtype=torch.int8)
    return WeatherCloud(points, kinds, torch.full((400,), lost), {}, {})


@pytest.mark.parametrize("name", ["object", "particle", "lost"])
def test_each_kind_of_point_has_its_colour(name: str) -> None:
    clear = few_points(PointKind.OBJECT)
    cloud = {
        "object": clear,
        "particle": few_points(PointKind.PARTICLE),
        "lost": few_points(PointKind.LOST, lost=True),
    }[name]
    picture = decoded(birds_eye_uri(cloud, clear))
    empty = decoded(birds_eye_uri(few_points(PointKind.LOST), clear))  # letters are dark too
    for other, colour in COLOURS.items():
        # A line of points covers some hundred pixels.
        found = pixels_of(picture, colour) - pixels_of(empty, colour)
        assert found > 40 if other == name else abs(found) < 10, other
    colour = COLOURS[name]
    if name != "object":  # which is grey by range there
        wanted = [int(colour[k : k + 2], 16) for k in (1, 3, 5)]
        assert np.abs(255 * _colours(cloud) - wanted).max() < 0.01


def test_left_is_left_and_ahead_is_up() -> None:
    cloud = few_points(PointKind.PARTICLE)
    picture = decoded(birds_eye_uri(cloud, cloud))
    wanted = np.array([int(COLOURS["particle"][k : k + 2], 16) for k in (1, 3, 5)])
    row, column = (axis.mean() for axis in np.nonzero(np.abs(picture - wanted).max(-1) <= 6))
    assert row < picture.shape[0] / 2  # 20 to 60 m ahead
    assert column < 0.56 * picture.shape[1]  # 5 m to the left of the middle, which the axis moves to 0.56


def test_objects_are_lighter_the_farther_they_are_and_nothing_is_white() -> None:
    near, far = (few_points(PointKind.OBJECT) for _ in range(2))
    far.points[:, 0] += 30
    assert (_colours(far)[:, 0] > _colours(near)[:, 0]).all()
    assert _colours(far).max() < 0.85
    assert (_colours(few_points(PointKind.LOST)) == 1).all()


def test_range_images_stand_one_below_the_other(seen: LidarScene) -> None:
    assert seen.view.grid is not None
    fog = seen.render(Fog(mor_m=30.0), 0)
    clouds = [("Clear", seen.clear), ("Fog", fog)]
    picture = decoded(range_images_uri(clouds, seen.view.directions, seen.view.grid))
    top, bottom = np.array_split(picture, 2)
    assert pixels_of(top, COLOURS["particle"]) < 100
    assert pixels_of(bottom, COLOURS["particle"]) > 0.2 * bottom.shape[0] * bottom.shape[1]


@pytest.fixture(scope="module")
def part(seen: LidarScene, tmp_path_factory: pytest.TempPathFactory) -> Written:
    folder = tmp_path_factory.mktemp("part")
    steps: list[int] = []
    weathers = [("rain-50", "Rain 50 mm/h", "rain", Rain(50.0)), ("fog-30", "Fog 30 m", "fog", Fog(mor_m=30.0))]
    summary, page = lidar_part(seen, "lidar:small", weathers, ["fog-30"], 0, folder, "track", steps.append)
    assert steps == [1, 1]
    return folder, summary, page


def test_clouds_are_written_with_their_kind(part: Written) -> None:
    folder, summary, _ = part
    files = {record["name"]: record.get("file") for record in summary["weathers"]}
    assert files == {"clear": "clouds/track_clear.pcd", "rain-50": None, "fog-30": "clouds/track_fog-30.pcd"}
    for record in summary["weathers"]:
        if "file" not in record:
            continue
        cloud = read_points(folder / record["file"])
        assert cloud.columns == ("x", "y", "z", "intensity", "ring", "kind")
        kind = cloud.column("kind")
        assert int((kind == PointKind.OBJECT).sum()) == record["numbers"]["objects"]
        assert int((kind == PointKind.PARTICLE).sum()) == record["numbers"]["particles"]
        assert bool((cloud.points[:, :3].norm(dim=-1) > 0).all())
    json.dumps(summary, allow_nan=False)


def test_the_table_has_a_row_for_each_weather_in_per_cent_and_milliseconds(part: Written) -> None:
    _, summary, section = part
    (table,) = (one for one in section.parts if isinstance(one, parts.Table))
    assert [label for label, *_ in table.rows] == ["Clear", "Rain 50 mm/h", "Fog 30 m"]
    for record, (_, *cells) in zip(summary["weathers"], table.rows, strict=True):
        values = {**record["numbers"], **record["times_s"]}
        written = {}
        for (key, _, _), cell in zip(COLUMNS, cells, strict=True):
            assert isinstance(cell, parts.Cell)
            wanted = {"lidar-key": key, "lidar-value": values[key]} if values.get(key) is not None else {}
            assert cell.data == wanted
            written[key] = cell.text
        share = values["share_objects"]
        assert float(written["share_objects"]) == pytest.approx(100 * share, abs=0.051)
        if "render_s" in values:
            shown = float(written["render_s"].replace(" ", ""))
            assert shown == pytest.approx(1000 * values["render_s"], rel=6e-3)
        else:
            assert written["render_s"] == "–"


@pytest.fixture(scope="module")
def page(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, dict[str, Any], str]:
    folder = tmp_path_factory.mktemp("demo")
    patch = pytest.MonkeyPatch()
    # Frames of camera and radar have tests of their own: few of their weathers are enough here.
    patch.setattr(demo_module, "SECTIONS", tuple(section for section in SECTIONS if section.kind in ("rain", "fog")))
    few = tuple(one for one in RADAR_WEATHERS if one[0] in ("rain-25", "fog-10"))  # of which the page speaks
    for module in (demo_module, radar_section):
        patch.setattr(module, "RADAR_WEATHERS", few)
    patch.setattr(demo_module, "lidar_scene", lambda scene, lidar, *more: lidar_scene(scene, LIDAR, *more))
    camera = Camera.preset("lucid-triton").resized(64, 48)
    try:
        summary = write_demo(
            folder, seed=2, camera=camera, progress=False, lidar="velodyne-vlp-16", radar="awr1843-like"
        )
    finally:
        patch.undo()
    return folder, summary, (folder / "index.html").read_text(encoding="utf-8")


def test_the_page_shows_the_scene_of_the_camera_to_the_lidar(page: tuple[Path, dict[str, Any], str]) -> None:
    folder, summary, text = page
    lidar = summary["subjects"][0]["lidar"]
    assert "lidar" not in summary["subjects"][1]  # the tunnel
    labels = [record["label"] for record in lidar["weathers"]]
    assert labels[0] == "Clear"
    assert labels[1:] == [record["label"] for record in summary["subjects"][0]["weathers"]]
    assert lidar["sensor"] == "lidar:velodyne-vlp-16"
    assert text.count('id="test-track-lidar"') == 1
    assert 'href="#test-track-lidar"' in text
    for record in lidar["weathers"]:
        if "file" in record:
            assert (folder / record["file"]).is_file()
            assert record["file"] in text
    shown = re.findall(r'data-lidar-key="([^"]*)" data-lidar-value="([^"]*)"', text)
    wanted = [
        (key, value)
        for record in lidar["weathers"]
        for key, value in {**record["numbers"], **record["times_s"]}.items()
        if not isinstance(value, dict)
    ]
    assert len(shown) > 50
    assert {(key, float(value)) for key, value in shown} <= {(key, value) for key, value in wanted}


def test_the_page_says_that_rain_shows_almost_no_drop(page: tuple[Path, dict[str, Any], str]) -> None:
    _, summary, text = page
    heaviest = [r for r in summary["subjects"][0]["lidar"]["weathers"] if r.get("kind") == "rain"][-1]
    drops = heaviest["numbers"]["particles"]
    assert drops <= 3  # of 1440 beams, at 1e-4 of them
    said = " ".join(text.split())
    assert "Almost no raindrop is seen, and that is right." in said
    assert re.search(rf"{'none' if drops == 0 else drops} of 1.440 beams reports? one \(Rain 50 mm/h\)", said)


@pytest.mark.usefixtures("undrawn")
def test_frames_of_a_user_bring_no_lidar(tmp_path: Path) -> None:
    from torchweather.io import write_image

    write_image(tmp_path / "a.png", torch.full((1, 24, 32), 900, dtype=torch.int32).to(torch.uint16))
    patch = pytest.MonkeyPatch()
    patch.setattr(demo_module, "SECTIONS", SECTIONS[1:2])
    try:
        summary = write_demo(tmp_path / "page", images=[tmp_path / "a.png"], depth=30.0, progress=False)
    finally:
        patch.undo()
    assert "lidar" not in summary["subjects"][0]
    assert not (tmp_path / "page" / "clouds").exists()
    assert "LiDAR" not in (tmp_path / "page" / "index.html").read_text(encoding="utf-8")


def test_ranges_are_of_the_scene(seen: LidarScene) -> None:
    clear = seen.clear
    assert isinstance(clear.points, Tensor)
    assert not bool(clear.lost.any())
    assert math.isclose(clear.numbers["share_objects"], 1.0)
