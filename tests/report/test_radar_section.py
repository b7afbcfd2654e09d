"""The radar's part of the demo page: frames, pictures and numbers that belong together."""

from __future__ import annotations

import base64
import io
import json
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from PIL import Image

from torchweather.atmosphere.weather import Rain
from torchweather.io import read_radar
from torchweather.radar import FmcwRadar, map_noise_dbm
from torchweather.report import demo as demo_module
from torchweather.report import parts
from torchweather.report.demo import SECTIONS, write_demo
from torchweather.report.lidar_views import lidar_scene
from torchweather.report.radar_figures import OTHER, above_uri, bar_uri, map_uri, power_scale
from torchweather.report.radar_section import COLUMNS, RADAR_WEATHERS, WALKING, radar_part
from torchweather.report.radar_views import LOSS_AT_M, RadarFrame, RadarScene, radar_scene
from torchweather.report.report import Section
from torchweather.scenes import radar_view
from torchweather.scenes import test_track as track
from torchweather.sensors import Camera, Lidar, Radar

Written = tuple[Path, dict[str, Any], Section]
RADAR = Radar.preset("awr1843-like")
# A few rings and columns are enough beside the radar.
LIDAR = Lidar.preset("velodyne-vlp-16", elevations_deg=(0.0, -3.0), columns=60, azimuth_offsets_deg=None)


@pytest.fixture(scope="module")
def seen() -> RadarScene:
    return radar_scene(track(), RADAR, WALKING)


@pytest.fixture(scope="module")
def rain(seen: RadarScene) -> RadarFrame:
    return seen.render("rain:rate=25", seed=3)


def decoded(uri: str) -> Any:
    data = base64.b64decode(uri.removeprefix("data:image/png;base64,"))
    return np.asarray(Image.open(io.BytesIO(data)).convert("RGB")).astype(int)


def pixels_of(picture: Any, colour: str) -> int:
    """Pixels within a few grey levels of a colour."""
    wanted = np.array([int(colour[k : k + 2], 16) for k in (1, 3, 5)])
    return int((np.abs(picture - wanted).max(-1) <= 6).sum())


def test_a_frame_is_what_the_simulator_gives(seen: RadarScene, rain: RadarFrame) -> None:
    simulator = FmcwRadar(RADAR, Rain(25.0))
    view = radar_view(track(), RADAR, velocity_m_per_s=WALKING)
    result = simulator.run(view.scatterers, simulator.draw(view.scatterers, seed=3))
    assert isinstance(result.points, torch.Tensor)
    assert torch.equal(rain.points, result.points)
    assert torch.equal(rain.power_dbm, result.power_dbm)
    numbers = rain.numbers
    assert numbers["points_scene"] + numbers["points_other"] == len(rain.points)
    assert numbers["points_scene"] == int(rain.of_scene.sum())
    assert numbers["attenuation_db_per_km"] == pytest.approx(11.41, abs=0.01)  # ITU-R P.838-3 at 77 GHz, horizontal
    for distance in LOSS_AT_M:
        wanted = 2 * numbers["attenuation_db_per_km"] * distance / 1000
        assert numbers[f"loss_{distance}_m_db"] == pytest.approx(wanted)
    assert rain.warnings == ()


def test_points_are_of_the_scene_where_the_scene_is(seen: RadarScene) -> None:
    clear = seen.render(None, seed=0)
    assert clear.numbers["points_scene"] > 20
    # Noise alone gives 0.12 points a frame (200 frames); three or more come in 1 of 4000 frames.
    assert clear.numbers["points_other"] <= 2
    range_m = clear.points[clear.of_scene, :3].double().norm(dim=-1)
    gap = (range_m[:, None] - seen.view.scatterers.range_m).abs()
    assert float(gap.min(1).values.max()) < 2 * RADAR.range_resolution_m


def test_without_a_scene_every_point_is_weather() -> None:
    view = radar_view(track(), RADAR, reflectors=())
    nothing = RadarScene(RADAR, view, torch.zeros(12, 128, 256, dtype=torch.complex64))
    frame = nothing.render("rain:rate=50", seed=1)
    assert frame.numbers["points_scene"] == 0
    assert frame.numbers["points_other"] == len(frame.points) > 0


def test_rain_shows_near_the_radar_and_the_scene_stays(seen: RadarScene) -> None:
    frame = seen.render("rain:rate=50", seed=0)
    weather_m = frame.points[~frame.of_scene, :3].norm(dim=-1)
    assert len(weather_m) > 3
    assert float(weather_m.median()) < 15.0
    clear = seen.render(None, seed=0)
    # The faint ones near the rain's echoes are lost to the detector, whose threshold rises there.
    assert frame.numbers["points_scene"] > 0.5 * clear.numbers["points_scene"]


def test_the_corner_weakens_by_the_way_to_it_and_back(seen: RadarScene) -> None:
    clear, fog = (seen.render(weather, seed=0) for weather in (None, "fog:mor=10"))
    lost = clear.numbers["corner_45_m_dbm"] - fog.numbers["corner_45_m_dbm"]
    # 0.34 dB; the noise is the same in both frames, 35 dB below: what is left of it is some 1e-2 dB.
    assert lost == pytest.approx(2 * 0.045 * fog.numbers["attenuation_db_per_km"], abs=0.03)


def test_the_noise_of_the_receiver_is_the_same_in_all_frames(seen: RadarScene) -> None:
    """Which the page says: beyond the rain's reach the maps differ by the scene alone."""
    clear, fog = (seen.render(weather, seed=0).power_dbm for weather in (None, "fog:mor=10"))
    fast = slice(100, 120)  # 4.6 to 7 m/s, where nothing moves
    assert torch.allclose(clear[fast], fog[fast], atol=1e-2)
    assert not torch.allclose(clear, fog, atol=1e-2)
    assert not torch.allclose(clear[fast], seen.render(None, seed=1).power_dbm[fast], atol=1.0)


def test_a_rate_beyond_the_fit_is_said(seen: RadarScene) -> None:
    frame = seen.render("snow:rate=19,close_rate=true", seed=0)
    (said,) = frame.warnings
    assert "19 lies outside" in said


def test_a_scale_holds_noise_and_echoes(rain: RadarFrame) -> None:
    low, high = power_scale(rain.power_dbm, 0.5, 0.999)
    noise = map_noise_dbm(RADAR)
    assert low <= noise < low + 10
    assert high > noise + 10
    assert low % 10 == high % 10 == 0


def few_points(of_scene: bool) -> RadarFrame:
    points = torch.zeros(120, 6)
    points[:, 0], points[:, 1], points[:, 4] = torch.linspace(20, 60, 120), 5.0, -100.0
    cell = torch.stack([torch.full((120,), 90), torch.linspace(68, 205, 120).long()], -1)
    flat = torch.full((128, 256), -130.0)
    return RadarFrame(None, points, torch.full((120,), of_scene), cell, flat, {}, {}, ())


def test_points_of_the_weather_are_orange_in_both_pictures(seen: RadarScene) -> None:
    scale = (-130.0, -100.0)
    weather, scene = (few_points(of_scene) for of_scene in (False, True))
    assert pixels_of(decoded(map_uri(weather, RADAR, scale)), OTHER) > 100
    assert pixels_of(decoded(map_uri(scene, RADAR, scale)), OTHER) < 10
    assert pixels_of(decoded(above_uri(weather, seen.view.boxes, RADAR, scale)), OTHER) > 100
    assert pixels_of(decoded(above_uri(scene, seen.view.boxes, RADAR, scale)), OTHER) < 10


def test_left_is_left_ahead_is_up_and_receding_is_up(seen: RadarScene) -> None:
    wanted = np.array([int(OTHER[k : k + 2], 16) for k in (1, 3, 5)])
    no_boxes = torch.zeros(0, 7, dtype=torch.float64)
    for picture in (
        decoded(above_uri(few_points(False), no_boxes, RADAR, (-130.0, -100.0))),
        decoded(map_uri(few_points(False), RADAR, (-130.0, -100.0))),
    ):
        row, column = (axis.mean() for axis in np.nonzero(np.abs(picture - wanted).max(-1) <= 6))
        assert row < 0.5 * picture.shape[0]  # 20 to 60 of 75 m ahead; bin 90 of 128 is 3.3 m/s, receding
        # From above, 5 m to the left of the middle, which the axis moves to 0.565; on the map at 20 to 60 m.
        assert 0.3 * picture.shape[1] < column < 0.62 * picture.shape[1]


def test_boxes_of_road_users_are_drawn(seen: RadarScene) -> None:
    boxes, none = (
        pixels_of(decoded(above_uri(few_points(True), boxes, RADAR, (-130.0, -100.0))), "#8695a3")
        for boxes in (seen.view.boxes, seen.view.boxes[:0])
    )
    assert boxes > none + 100


def test_the_bars_are_pictures_of_their_own_colours() -> None:
    assert decoded(bar_uri("map", (-130.0, -90.0), "dBm")).shape == decoded(bar_uri("points", (0.0, 9.0), "x")).shape
    assert bar_uri("map", (-130.0, -90.0), "dBm") != bar_uri("points", (-130.0, -90.0), "dBm")


@pytest.fixture(scope="module")
def part(seen: RadarScene, tmp_path_factory: pytest.TempPathFactory) -> Written:
    folder = tmp_path_factory.mktemp("part")
    steps: list[int] = []
    summary, page = radar_part(seen, "radar:awr1843-like", 0, folder, "track", steps.append)
    assert steps == [1] * len(RADAR_WEATHERS)
    return folder, summary, page


def test_points_are_written_with_their_kind(part: Written) -> None:
    folder, summary, section = part
    *_, above = (one.figures for one in section.parts if isinstance(one, parts.Pictures))
    assert [record["name"] for record in summary["weathers"]] == ["clear", *(name for name, *_ in RADAR_WEATHERS)]
    for record, figure in zip(summary["weathers"], above, strict=True):
        found = read_radar(folder / record["file"])
        assert found.columns[:6] == ("x_m", "y_m", "z_m", "speed_m_per_s", "power_dbm", "rcs_dbsm")
        kind = found.column("kind")
        assert int((kind == 0).sum()) == record["numbers"]["points_scene"]
        assert int((kind == 1).sum()) == record["numbers"]["points_other"]
        assert figure.facts[0] == f"{record['numbers']['points_scene']} points of the scene"
    json.dumps(summary, allow_nan=False)


def test_more_weather_takes_more(part: Written) -> None:
    numbers = {record["name"]: record["numbers"] for record in part[1]["weathers"]}
    for names in (("clear", "rain-10", "rain-25", "rain-50"), ("clear", "fog-50", "fog-30", "fog-20", "fog-10")):
        losses = [numbers[name]["loss_56_m_db"] for name in names]
        assert losses == sorted(losses)
        assert len(set(losses)) == len(losses)
    assert numbers["snow-19"]["loss_56_m_db"] < numbers["rain-10"]["loss_56_m_db"]  # dry


def test_the_table_has_a_row_for_each_weather(part: Written) -> None:
    _, summary, section = part
    (table,) = (one for one in section.parts if isinstance(one, parts.Table))
    for record, (label, *cells) in zip(summary["weathers"], table.rows, strict=True):
        values = {**record["numbers"], **record["times_s"]}
        assert label == record["label"]
        for (key, _, _), cell in zip(COLUMNS, cells, strict=True):
            assert isinstance(cell, parts.Cell)
            assert cell.data == {"radar-key": key, "radar-value": values[key]}
            written = float(cell.text.replace("\u2212", "-").replace(" ", ""))
            # Three digits, or one decimal of a power.
            assert written == pytest.approx(values[key], rel=6e-3, abs=0.06 if key.endswith("dbm") else 0)


@pytest.fixture(scope="module")
def page(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, dict[str, Any], str]:
    folder = tmp_path_factory.mktemp("demo")
    patch = pytest.MonkeyPatch()
    # Camera and LiDAR have tests of their own: one kind of their weathers is enough here.
    patch.setattr(demo_module, "SECTIONS", tuple(section for section in SECTIONS if section.kind == "fog"))
    patch.setattr(demo_module, "lidar_scene", lambda scene, lidar, *more: lidar_scene(scene, LIDAR, *more))
    camera = Camera.preset("lucid-triton").resized(64, 48)
    try:
        summary = write_demo(folder, seed=2, camera=camera, progress=False, radar="awr1843-like")
    finally:
        patch.undo()
    return folder, summary, (folder / "index.html").read_text(encoding="utf-8")


def test_the_page_shows_the_scene_to_the_radar(page: tuple[Path, dict[str, Any], str]) -> None:
    folder, summary, text = page
    radar = summary["subjects"][0]["radar"]
    assert "radar" not in summary["subjects"][1]  # the tunnel
    assert radar["sensor"] == "radar:awr1843-like"
    assert text.count('id="test-track-radar"') == 1
    assert 'href="#test-track-radar"' in text
    for record in radar["weathers"]:
        assert (folder / record["file"]).is_file()
        assert text.count(f'alt="Range-Doppler map, {record["label"]}"') == 1
        assert text.count(f'alt="Radar points from above, {record["label"]}"') == 1
    shown = re.findall(r'data-radar-key="([^"]*)" data-radar-value="([^"]*)"', text)
    wanted = {
        (key, float(value))
        for record in radar["weathers"]
        for key, value in {**record["numbers"], **record["times_s"]}.items()
    }
    assert len(shown) == 7 * len(radar["weathers"])
    assert {(key, float(value)) for key, value in shown} <= wanted


def test_the_page_says_that_19_mm_per_h_of_snow_is_beyond_the_fit(page: tuple[Path, dict[str, Any], str]) -> None:
    _, summary, text = page
    (note,) = summary["subjects"][0]["radar"]["notes"]
    assert "19 lies outside" in note
    assert note in text


@pytest.mark.usefixtures("undrawn")
def test_frames_of_a_user_bring_no_radar(tmp_path: Path) -> None:
    from torchweather.io import write_image

    write_image(tmp_path / "a.png", torch.full((1, 24, 32), 900, dtype=torch.int32).to(torch.uint16))
    patch = pytest.MonkeyPatch()
    patch.setattr(demo_module, "SECTIONS", SECTIONS[1:2])
    try:
        summary = write_demo(tmp_path / "page", images=[tmp_path / "a.png"], depth=30.0, progress=False)
    finally:
        patch.undo()
    assert "radar" not in summary["subjects"][0]
    assert "Radar" not in (tmp_path / "page" / "index.html").read_text(encoding="utf-8")
