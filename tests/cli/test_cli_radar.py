"""``torchweather apply --sensor radar``: detections back as they came, weaker, fewer, or with the rain's own."""

from __future__ import annotations

import json
import math
import sys
import types
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from torch import Tensor

from torchweather.atmosphere.weather import Rain, parse_weather
from torchweather.io import (
    RADAR_COLUMNS,
    PointCloud,
    RadarPoints,
    read_image,
    read_points,
    read_radar,
    write_image,
    write_points,
    write_radar,
)
from torchweather.io.pcd import read_pcd
from torchweather.radar import FmcwRadar
from torchweather.radar.fmcw.range_doppler import map_noise_dbm
from torchweather.report.radar_picture import HEADING_PX, TITLE_PX
from torchweather.report.radar_section import WALKING
from torchweather.scenes import fog_tunnel, radar_view, test_track
from torchweather.sensors import Radar
from torchweather.stages import PointKind
from torchweather.transforms import RadarAttenuation

RADAR = Radar.preset("imaging-77ghz")
IMAGING = ("--sensor", "radar:imaging-77ghz")
RAIN = "rain:rate=50"
SMALL = Radar.preset("awr1843-like")
SMALL_RADAR = ("--sensor", "radar:awr1843-like")


def detections(rows: int = 60) -> Tensor:
    """Targets at 5 to 75 m, from far above the detection threshold to just above it."""
    random = torch.Generator().manual_seed(4)
    range_m = torch.linspace(5, 75, rows)
    azimuth = torch.rand(rows, generator=random) - 0.5
    over_db = torch.linspace(0.5, 40.0, rows)[torch.randperm(rows, generator=random)]
    power = RADAR.floor_db + RADAR.detection_snr_db + over_db
    xyz = [range_m * azimuth.cos(), range_m * azimuth.sin(), torch.zeros(rows)]
    rcs = torch.rand(rows, generator=random) * 20 - 10
    return torch.stack([*xyz, torch.randn(rows, generator=random), power, rcs], -1)


def expected(points: Tensor, weather: str = RAIN, seed: int = 0, sensor: Radar = RADAR, **options: Any) -> Any:
    transform = RadarAttenuation(parse_weather(weather), sensor, **options)
    return transform.run(points, transform.draw(points, seed=seed))


@pytest.mark.parametrize("name", ["a.pcd", "a.npz", "a.csv"])
def test_detections_come_back_in_their_format_with_what_the_transform_gives(
    run: Any, tmp_path: Path, name: str
) -> None:
    points = detections()
    write_radar(tmp_path / name, points)
    before = (tmp_path / name).read_bytes()
    out = tmp_path / "out"
    code, text, err = run(
        "apply", *IMAGING, "--weather", RAIN, tmp_path / name, "--out", out, "--seed", 7, "--json", "--quiet"
    )
    assert (code, err) == (0, "")
    (entry,) = json.loads(text)["files"]
    result = expected(points, seed=7)
    kept = result.kind == PointKind.OBJECT
    again = read_radar(out / name)
    assert torch.equal(again.points, result.points[kept])
    assert again.columns == read_radar(tmp_path / name).columns
    assert (tmp_path / name).read_bytes() == before
    assert [path.name for path in out.iterdir()] == [name]
    assert [entry["objects"], entry["lost"], entry["particles"]] == [int(kept.sum()), int((~kept).sum()), 0]
    assert entry["lost"] > 0
    assert (entry["points"], entry["empty_rows"], entry["seed"]) == (60, 0, 7)
    # 60 targets spread evenly over 5 to 75 m: 40 m in the mean, and back.
    assert entry["attenuation_db_mean"] == pytest.approx(2 * 0.040 * entry["attenuation_db_per_km"], rel=1e-3)
    assert entry["attenuation_db_per_km"] == pytest.approx(18.76, abs=0.01)  # ITU-R P.838-3 at 77 GHz, horizontal
    assert [entry[key] for key in ("power_source", "rcs_source", "speed_source")] == ["file"] * 3


@pytest.mark.parametrize("weather", ["rain:rate=0", "fog:mor=inf", "snow:rate=0"])
@pytest.mark.parametrize("name", ["a.pcd", "a.npz"])
def test_no_weather_gives_the_file_back_bit_for_bit(run: Any, tmp_path: Path, name: str, weather: str) -> None:
    write_radar(tmp_path / name, detections())
    code, text, _ = run("apply", *IMAGING, "--weather", weather, tmp_path / name, "-o", tmp_path / "out", "--json")
    assert code == 0
    assert (tmp_path / "out" / name).read_bytes() == (tmp_path / name).read_bytes()
    (entry,) = json.loads(text)["files"]
    assert (entry["objects"], entry["lost"], entry["attenuation_db_mean"]) == (60, 0, 0)


def test_rows_without_a_detection_stay_as_the_file_has_them(run: Any, tmp_path: Path) -> None:
    rows = ["x_m,y_m,z_m,speed_m_per_s,power_dbm,rcs_dbsm,quality", "nan,nan,nan,nan,nan,nan,3", "40,0,0,1,-100,5,7"]
    (tmp_path / "a.csv").write_text("\n".join(rows) + "\n")
    code, text, _ = run("apply", *IMAGING, "--weather", RAIN, tmp_path / "a.csv", "-o", tmp_path / "out", "--json")
    assert code == 0
    (entry,) = json.loads(text)["files"]
    assert (entry["points"], entry["objects"], entry["lost"], entry["empty_rows"]) == (2, 1, 0, 1)
    header, empty, target = (tmp_path / "out" / "a.csv").read_text().splitlines()
    assert (header, empty.lower()) == (rows[0], rows[1])
    values = [float(value) for value in target.split(",")]
    assert values == pytest.approx([40, 0, 0, 1, -100 - 2 * 0.040 * 18.7565, 5, 7], abs=1e-3)


def test_lost_detections_leave_the_file_or_stay_as_nan(run: Any, tmp_path: Path) -> None:
    points = detections()
    write_radar(tmp_path / "a.pcd", points)
    lost = expected(points).kind == PointKind.LOST
    rows = {}
    for lost_as in ("zero", "drop", "nan"):
        out = tmp_path / lost_as
        given = ("--weather", RAIN, tmp_path / "a.pcd", "-o", out, "--lost", lost_as)
        assert run("apply", *IMAGING, *given)[0] == 0
        rows[lost_as] = read_pcd(out / "a.pcd").rows
    assert (rows["zero"], rows["drop"], rows["nan"]) == (60 - int(lost.sum()), 60 - int(lost.sum()), 60)


def test_frames_of_a_folder_take_seed_plus_their_number_and_a_line_each(run: Any, tmp_path: Path) -> None:
    folder = tmp_path / "in"
    folder.mkdir()
    points = detections()
    for name in ("b.csv", "a.pcd"):
        write_radar(folder / name, points)
    (folder / "note.txt").write_text("no detections")
    # Only the rain's own detections are random.
    given = ("--weather", RAIN, "--clutter", "--ego-speed-m-per-s", 8)
    code, text, err = run("apply", *IMAGING, *given, folder, "--out", tmp_path / "out", "--seed", 4)
    assert (code, err) == (0, f"torchweather: left out: 1 file or folder of those given: {folder / 'note.txt'}.\n")
    lines = text.strip().splitlines()
    assert [line.split()[0] for line in lines] == [str(folder / "a.pcd"), str(folder / "b.csv")]
    for word in ("rows 60: objects", "particles", "lost", "empty 0", "detection threshold 0", "dB/km", "two way"):
        assert word in lines[0]
    found = {}
    for name, seed in (("a.pcd", 4), ("b.csv", 5)):
        result = expected(points, seed=seed, clutter=True, ego_speed_m_per_s=8.0)
        wanted = result.points[result.kind != PointKind.LOST]
        found[name] = read_radar(tmp_path / "out" / name).points
        assert torch.allclose(found[name], wanted, rtol=1e-6)
        assert int((result.kind == PointKind.PARTICLE).sum()) > 0
        assert f"seed {seed}" in lines[seed - 4]
    assert found["a.pcd"].shape != found["b.csv"].shape or not torch.equal(found["a.pcd"], found["b.csv"])


def test_labels_hold_the_truth_of_each_row(run: Any, tmp_path: Path) -> None:
    points = detections()
    write_radar(tmp_path / "a.npz", points)
    code, text, _ = run(
        "apply", *IMAGING, "--weather", RAIN, tmp_path / "a.npz", "-o", tmp_path / "out", "--clutter", "--labels",
        "npz", "--json",
    )  # fmt: skip
    assert code == 0
    (entry,) = json.loads(text)["files"]
    result = expected(points, clutter=True)
    with np.load(entry["labels"]) as truth:
        assert set(truth) == {"kind", "source", "snr_db", "attenuation_db"}
        for name in truth:
            assert np.array_equal(truth[name], getattr(result, name).numpy()), name
        assert int((truth["kind"] != PointKind.LOST).sum()) == len(read_radar(entry["output"]).points)


def test_a_file_of_cross_sections_gets_its_power_by_the_radar_equation_and_says_so(run: Any, tmp_path: Path) -> None:
    # One dB over the threshold in clear air, at boresight; 50 mm/h of rain take 2.6 dB on 70 m and back.
    faint = RADAR.floor_db + RADAR.detection_snr_db + 1.0 - RADAR.constant_db + 40 * math.log10(70.0)
    header = "range_m,azimuth_deg,elevation_deg,speed_m_per_s,rcs_dbsm"
    rows = [header, "50,10,0,-3,10", f"70,0,0,2,{faint:.2f}"]
    for name in ("a.csv", "b.csv"):
        (tmp_path / name).write_text("\n".join(rows) + "\n")
    inputs = (tmp_path / "a.csv", tmp_path / "b.csv")
    code, text, err = run("apply", *IMAGING, "--weather", RAIN, *inputs, "-o", tmp_path / "out", "--json")
    assert code == 0
    (line,) = err.strip().splitlines()
    assert "radar equation" in line
    for entry in json.loads(text)["files"]:
        assert (entry["power_source"], entry["rcs_source"]) == ("radar equation", "file")
        assert (entry["objects"], entry["lost"], entry["floored_points"]) == (1, 1, 0)
        first, kept = Path(entry["output"]).read_text().splitlines()
        assert first == header
        assert [float(value) for value in kept.split(",")] == [50, 10, 0, -3, 10]


def test_a_sweep_with_velocities_keeps_them_and_gets_the_rains_own(run: Any, tmp_path: Path) -> None:
    names = ("x", "y", "z", "id", "rcs", "vx", "vy", "vx_comp", "vy_comp")
    random = torch.Generator().manual_seed(2)
    table = torch.randint(-8, 9, (30, 9), generator=random).float()
    table[:, 0] = torch.linspace(8, 70, 30)
    write_points(tmp_path / "a.pcd", PointCloud(table, names))
    given = ("apply", *IMAGING, tmp_path / "a.pcd", "--quiet", "--json", "--seed", 1)
    assert run(*given, "--weather", "rain:rate=0", "--out", tmp_path / "none")[0] == 0
    assert (tmp_path / "none" / "a.pcd").read_bytes() == (tmp_path / "a.pcd").read_bytes()
    code, text, _ = run(*given, "--weather", RAIN, "--clutter", "--speed", "compensated", "--out", tmp_path / "out")
    assert code == 0
    (entry,) = json.loads(text)["files"]
    assert (entry["objects"], entry["speed_source"]) == (30, "compensated")
    found = read_points(tmp_path / "out" / "a.pcd", intensity="none")
    columns = {name: found.column(name) for name in names}
    for place, name in enumerate(names):
        assert torch.equal(columns[name][:30], table[:, place]), name
    clutter = expected(read_radar(tmp_path / "a.pcd", RADAR).points, seed=1, clutter=True)
    rain = clutter.points[clutter.kind == PointKind.PARTICLE]
    assert entry["particles"] == len(rain) == len(found.points) - 30 > 0
    assert torch.allclose(columns["x"][30:], rain[:, 0])
    toward = (columns["x"] * columns["vx_comp"] + columns["y"] * columns["vy_comp"])[30:] / rain[:, :3].norm(dim=-1)
    assert torch.allclose(toward, rain[:, 3], atol=1e-5)


def test_arguments_replace_what_the_preset_says(run: Any, tmp_path: Path) -> None:
    points = detections()
    write_radar(tmp_path / "a.npz", points)
    sensor = Radar.preset("imaging-77ghz", frequency_ghz=60.0, polarisation="v", noise_floor_db=-145.0)
    code, text, _ = run(
        "apply", *IMAGING, "--weather", RAIN, tmp_path / "a.npz", "-o", tmp_path / "out", "--frequency-ghz", 60,
        "--polarisation", "v", "--noise-floor-db", -145, "--radome-film-db", 0.5, "--radome-loss-db", 1, "--json",
    )  # fmt: skip
    assert code == 0
    wanted = expected(points, sensor=sensor, radome_film_db=0.5, radome_loss_db=1.0)
    kept = wanted.kind == PointKind.OBJECT
    assert torch.equal(read_radar(tmp_path / "out" / "a.npz").points, wanted.points[kept])
    (entry,) = json.loads(text)["files"]
    film = 1.0 + 0.5 * 50 ** (1 / 3)
    assert entry["attenuation_db_mean"] == pytest.approx(2 * 0.040 * entry["attenuation_db_per_km"] + film, rel=1e-3)


def test_a_recipe_sets_sensor_and_options_and_arguments_come_first(run: Any, tmp_path: Path) -> None:
    points = detections()
    write_radar(tmp_path / "a.pcd", points)
    argv = ("apply", tmp_path / "a.pcd", "-o", tmp_path / "out", "--json", "--quiet")
    code, text, _ = run(*argv, "--recipe", "imaging-rain-10mm-per-h-wet-radome")
    assert code == 0
    (entry,) = json.loads(text)["files"]
    assert entry["attenuation_db_mean"] == pytest.approx(
        2 * 0.040 * entry["attenuation_db_per_km"] + 10 ** (1 / 3), rel=1e-3
    )
    code, text, _ = run(*argv, "--recipe", "imaging-rain-10mm-per-h-wet-radome", "--radome-film-db", 0)
    (entry,) = json.loads(text)["files"]
    assert entry["attenuation_db_mean"] == pytest.approx(2 * 0.040 * entry["attenuation_db_per_km"], rel=1e-3)
    code, _, err = run(*argv, "--recipe", "imaging-fog-20m", "--weather", "rain:rate=5")
    assert code == 2
    assert "expected --weather or --recipe" in err


def test_a_power_column_below_the_sensors_floor_is_said(run: Any, tmp_path: Path) -> None:
    points = detections()
    points[:, 4] -= 100
    write_radar(tmp_path / "a.csv", points)
    code, _, err = run("apply", *IMAGING, "--weather", RAIN, tmp_path / "a.csv", "-o", tmp_path / "out")
    assert code == 0
    (line,) = err.strip().splitlines()
    assert "noise_floor_db" in line


@pytest.mark.parametrize(
    ("argv", "said"),
    [
        (["{a}", "-o", "{out}", "--lost", "gone"], "drop"),
        (["{a}", "-o", "{out}", "--depth", "30"], "--depth is for a camera"),
        (["{a}", "-o", "{out}", "--return-mode", "last"], "--return-mode is for a lidar"),
        (["{a}", "-o", "{out}", "--labels", "label"], "--labels npz"),
        (["{a}", "-o", "{out}", "--labels-in", "{here}"], "--labels-in is for a lidar"),
        (["{a}", "-o", "{here}"], "overwritten"),
        (["{a}", "{other}", "-o", "{out}"], "both"),
        (["{cut}", "-o", "{out}"], "cut.pcd"),
        (["{nothing}", "-o", "{out}"], "power"),
        (["{bin}", "-o", "{out}"], "rows of seven float32 numbers"),
        (["{none}", "-o", "{out}"], "no such file"),
        (["{empty}", "-o", "{out}"], "no radar detections"),
        (["{a}", "-o", "{out}", "--frequency-ghz", "5000"], "frequency_ghz"),
        (["{a}", "-o", "{out}", "--polarisation", "x"], "h, v"),
        (["{a}", "-o", "{out}", "--speed", "fast"], "compensated"),
        (["{a}", "-o", "{out}", "--gain", "all"], "boresight"),
        (["{a}", "-o", "{out}", "--radome-loss-db", "-1"], "loss_db"),
        (["{a}", "-o", "{out}", "--sensor", "radar:imaging"], "imaging-77ghz"),
        (["{a}", "-o", "{out}", "--sensor", "lidar:velodyne-hdl-64e", "--clutter"], "--clutter is for a radar"),
        (["{a}", "-o", "{out}", "--recipe", "lidar/os1-fog-50m"], "is for a lidar"),
    ],
)
def test_a_mistake_gives_one_line_exit_code_2_and_no_file(run: Any, tmp_path: Path, argv: list[str], said: str) -> None:
    here = tmp_path / "here"
    (here / "empty").mkdir(parents=True)
    (here / "other").mkdir()
    write_radar(here / "a.pcd", detections())
    write_radar(here / "other" / "a.pcd", detections())
    (here / "cut.pcd").write_bytes((here / "a.pcd").read_bytes()[:-3])
    (here / "nothing.csv").write_text("x_m,y_m,z_m,speed_m_per_s\n1,2,3,4\n")
    (here / "a.bin").write_bytes(bytes(16))
    before = {path: path.read_bytes() for path in here.rglob("*") if path.is_file()}
    out = tmp_path / "out"
    names = {
        "a": here / "a.pcd", "other": here / "other" / "a.pcd", "cut": here / "cut.pcd", "bin": here / "a.bin",
        "nothing": here / "nothing.csv", "none": here / "none.pcd", "empty": here / "empty", "here": here, "out": out,
    }  # fmt: skip
    sensor = () if "--sensor" in argv else IMAGING
    weather = () if "--recipe" in argv else ("--weather", RAIN)
    code, text, err = run("apply", *sensor, *weather, *(part.format(**names) for part in argv))
    assert (code, text) == (2, "")
    (line,) = err.strip().splitlines()
    assert line.startswith("torchweather: error: ")
    assert said.format(**names) in line
    assert {path: path.read_bytes() for path in here.rglob("*") if path.is_file()} == before
    assert not out.exists() or not list(out.iterdir())


def test_a_radar_without_a_preset_names_its_own(run: Any, tmp_path: Path) -> None:
    write_radar(tmp_path / "a.csv", detections())
    given = ("--weather", RAIN, tmp_path / "a.csv", "-o", tmp_path / "out")
    code, _, err = run("apply", *given)
    assert code == 2
    assert "radar:PRESET" in err
    code, _, err = run("apply", *given, "--sensor", "radar")
    assert code == 0
    assert "radar:imaging-77ghz" in err


@pytest.mark.parametrize("rows", [0, 1])
def test_an_empty_list_and_one_detection_are_results(run: Any, tmp_path: Path, rows: int) -> None:
    write_radar(tmp_path / "a.csv", RadarPoints(detections()[20 : 20 + rows], RADAR_COLUMNS))
    given = ("--weather", RAIN, tmp_path / "a.csv", "-o", tmp_path / "out", "--labels", "npz", "--json")
    code, text, _ = run("apply", *IMAGING, *given)
    assert code == 0
    (entry,) = json.loads(text)["files"]
    assert entry["points"] == rows
    assert entry["objects"] == len(read_radar(entry["output"]).points)
    assert (entry["attenuation_db_mean"] is None) == (rows == 0)


def test_demo_takes_a_radar_for_the_embedded_scene_only(
    run: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked: list[dict[str, Any]] = []
    module = types.ModuleType("torchweather.report.demo")

    def write_demo(out_dir: Path, **options: Any) -> dict[str, Any]:
        asked.append(options)
        return {}

    module.write_demo = write_demo  # type: ignore[attr-defined]
    monkeypatch.setitem(sys.modules, "torchweather.report.demo", module)
    assert run("demo", "--radar", "radar:awr1843-like", "--lidar", "velodyne-vlp-16", "-o", tmp_path)[0] == 0
    assert (asked[0]["radar"], asked[0]["lidar"]) == ("awr1843-like", "velodyne-vlp-16")
    write_image(tmp_path / "frame.png", torch.full((1, 8, 8), 9, dtype=torch.uint16))
    code, _, err = run("demo", tmp_path / "frame.png", "--radar", "awr1843-like", "-o", tmp_path)
    assert code == 2
    assert "--radar belongs to the embedded scene" in err


def test_list_knows_the_radar(run: Any) -> None:
    _, text, _ = run("list")
    for name in ("radar/imaging-rain-25mm-per-h", "radar:imaging-77ghz", "radar:awr1843-like"):
        assert name in text
    names = json.loads(run("list", "--json")[1])
    assert {"PathAttenuation", "WetRadome", "VolumeClutter", "RadarDetection", "ToRadarPoints"} <= set(names["stages"])
    transforms = [recipe for recipe in names["recipes"] if recipe["kind"] == "transform"]
    recipes = [recipe for recipe in transforms if recipe["name"].startswith("radar/")]
    assert len(recipes) >= 6
    assert {recipe["transform"] for recipe in recipes} == {"RadarAttenuation"}
    assert {recipe["sensor"] for recipe in recipes} == {"radar:imaging-77ghz", "radar:awr1843-like"}
    assert math.isfinite(sum(recipe["weather"].get("rate_mm_per_h", 0.0) for recipe in recipes))


@pytest.mark.usefixtures("undrawn")
def test_a_scene_is_simulated_clear_and_in_the_weather_with_the_same_noise(run: Any, tmp_path: Path) -> None:
    out = tmp_path / "out"
    code, text, err = run(
        "apply", "scene:test-track", *SMALL_RADAR, "--weather", "rain:rate=25", "-o", out, "--seed", 5, "--json",
        "--ego-speed-m-per-s", 1, "--frequency-ghz", 78, "--radome-film-db", 0.5, "--quiet",
    )  # fmt: skip
    assert (code, err) == (0, "")
    (entry,) = json.loads(text)["files"]
    assert sorted(path.name for path in out.iterdir()) == ["test-track.npz", "test-track.png", "test-track_clear.npz"]
    radar = Radar.preset("awr1843-like", frequency_ghz=78.0)
    scatterers = radar_view(test_track(), radar, ego_speed_m_per_s=1.0, velocity_m_per_s=WALKING).scatterers
    rainy = FmcwRadar(radar, Rain(rate_mm_per_h=25), ego_speed_m_per_s=1.0, radome_film_db=0.5)
    for name, simulator, points, of_scene in (
        ("clear", FmcwRadar(radar), entry["points_clear"], entry["points_clear_scene"]),
        ("output", rainy, entry["points"], entry["points_scene"]),
    ):
        found = read_radar(entry[name])
        wanted = simulator(scatterers, simulator.draw(scatterers, seed=5))
        # The simulator works in single precision on one thread here and on all of them there.
        assert torch.allclose(found.points[:, :6], wanted, rtol=1e-4, atol=1e-3)
        assert (points, of_scene) == (len(wanted), int((found.column("kind") == PointKind.OBJECT).sum()))
        assert found.power_source == "file"
    assert entry["radome_db"] == pytest.approx(0.5 * 25 ** (1 / 3))
    assert rainy.path is not None
    assert entry["attenuation_db_per_km"] == pytest.approx(float(rainy.path.attenuation_db_per_km(1)), rel=1e-6)
    assert entry["attenuation_db_per_km"] == pytest.approx(11.4, abs=0.1)  # ITU-R P.838-3 at 78 GHz, horizontal
    assert (entry["sensor"], entry["seed"], entry["ego_speed_m_per_s"]) == ("radar:awr1843-like", 5, 1)


@pytest.mark.usefixtures("undrawn")
def test_a_corner_of_the_scene_loses_what_fog_and_cover_take(run: Any, tmp_path: Path) -> None:
    given = ("--weather", "fog:mor=10", "--radome-loss-db", 6, "-o", tmp_path)
    code, text, _ = run("apply", "scene:test-track", *SMALL_RADAR, *given, "--json")
    assert code == 0
    (entry,) = json.loads(text)["files"]
    power = []
    for name in ("clear", "output"):
        points = read_radar(entry[name]).points
        near = torch.linalg.vector_norm(points[:, :2] - torch.tensor([19.692, -3.5]), dim=-1) < 1.0
        power.append(float(points[near, 4].max()))
    lost = 6 + 2 * 0.020 * entry["attenuation_db_per_km"]
    # Noise of a beam, three standard deviations along the weaker signal; fog has no echo of its own.
    noise_dbm = map_noise_dbm(SMALL, "hann") - 10 * math.log10(SMALL.virtual_channels)
    ratio = 10 ** ((noise_dbm - power[1]) / 20)
    assert power[0] - power[1] == pytest.approx(lost, abs=20 * math.log10(1 + 3 * ratio / math.sqrt(2)))


@pytest.mark.usefixtures("undrawn")
def test_points_of_the_scene_are_told_from_those_of_the_rain(run: Any, tmp_path: Path) -> None:
    code, text, _ = run("apply", "scene:fog-tunnel", *SMALL_RADAR, "--weather", RAIN, "-o", tmp_path, "--json")
    assert code == 0
    (entry,) = json.loads(text)["files"]
    found = read_radar(entry["output"])
    range_m = torch.linalg.vector_norm(found.points[:, :3], dim=-1)
    rain = found.column("kind") == PointKind.PARTICLE
    at = radar_view(fog_tunnel(), SMALL).scatterers.range_m
    nearest = (range_m[:, None] - at.to(range_m)).abs().amin(-1)
    # Everything of the tunnel stands still, 8 m away or more: what moves is rain, and so is what is nearer.
    moves = found.points[:, 3].abs() > 3 * SMALL.speed_resolution_m_per_s
    assert int(moves.sum()) > 3
    assert bool(rain[moves].all())
    assert bool(rain[range_m < 7].all())
    # The widest window's main lobe is two cells to either side.
    assert float(nearest[~rain].max()) < 2 * SMALL.range_resolution_m
    assert entry["points"] - entry["points_scene"] == int(rain.sum())


def test_the_picture_of_a_scene_has_clear_and_weather_side_by_side(run: Any, tmp_path: Path) -> None:
    halves = {}
    for weather in ("rain:rate=0", RAIN):
        code, text, _ = run("apply", "scene:fog-tunnel", *SMALL_RADAR, "--weather", weather, "-o", tmp_path, "--json")
        assert code == 0
        picture = read_image(json.loads(text)["files"][0]["picture"])[0]
        assert picture.shape[-1] == 1280
        # Below the headings, above the bars of the colours.
        drawn = picture[..., TITLE_PX + HEADING_PX : 1500, :]
        halves[weather] = drawn[..., :640], drawn[..., 640:]
        if weather == "rain:rate=0":
            clear, weathered = (read_radar(tmp_path / f"fog-tunnel{end}.npz").points for end in ("_clear", ""))
            assert torch.equal(clear, weathered)
    assert torch.equal(*halves["rain:rate=0"])
    assert torch.equal(halves[RAIN][0], halves["rain:rate=0"][0])
    # The map is a quarter of it; the rain's echo is seen on the nearest tenth of the ranges and more.
    assert float((halves[RAIN][0] != halves[RAIN][1]).any(0).double().mean()) > 0.025


@pytest.mark.usefixtures("undrawn")
def test_a_recipe_sets_the_weather_and_the_models_of_a_scene(run: Any, tmp_path: Path) -> None:
    given = ("apply", "scene:fog-tunnel", "--recipe", "awr1843-rain-25mm-per-h-d34", "-o", tmp_path)
    code, text, _ = run(*given)
    assert code == 0
    for said in ("scene:fog-tunnel ->", "fog-tunnel_clear.npz", "points clear", "in the weather", "dB/km"):
        assert said in text
    (entry,) = json.loads(run(*given, "--json")[1])["files"]
    published = RadarAttenuation(Rain(rate_mm_per_h=25), SMALL, variant="d3_4").attenuation_db_per_km
    assert entry["attenuation_db_per_km"] == pytest.approx(float(published), rel=1e-6)
    assert entry["attenuation_db_per_km"] != pytest.approx(11.4, abs=0.5)  # ITU-R P.838-3
    assert (entry["sensor"], entry["weather"]["rate_mm_per_h"]) == ("radar:awr1843-like", 25)


@pytest.mark.parametrize(
    ("argv", "said"),
    [
        (["scene:test-trak", *SMALL_RADAR], "Did you mean 'test-track'?"),
        (["scene:test-track"], "torchweather demo"),
        (["scene:test-track", "--sensor", "camera:lucid-triton"], "give --sensor radar:PRESET"),
        (["scene:test-track", "--sensor", "lidar"], "torchweather demo"),
        (["scene:test-track", "a.csv", *SMALL_RADAR], "run apply for each"),
        (["scene:test-track", "scene:test-track", *SMALL_RADAR], "both"),
        (["scene:test-track", *SMALL_RADAR, "--clutter"], "always in the samples"),
        (["scene:test-track", *SMALL_RADAR, "--lost", "nan"], "--lost"),
        (["scene:test-track", *SMALL_RADAR, "--labels", "npz"], "--labels"),
        (["scene:test-track", *SMALL_RADAR, "--speed", "relative"], "--speed"),
        (["scene:test-track", *SMALL_RADAR, "--gain", "pattern"], "--gain"),
        (["scene:test-track", *SMALL_RADAR, "--noise-floor-db", "-120"], "--noise-floor-db"),
        (["scene:test-track", *SMALL_RADAR, "--ego-speed-m-per-s", "500"], "ego_speed_m_per_s"),
        (["scene:test-track", *SMALL_RADAR, "--depth", "30"], "--depth is for a camera"),
        (["scene:test-track", "--recipe", "lidar/os1-fog-50m"], "torchweather demo"),
    ],
)
def test_a_mistake_with_a_scene_gives_one_line_exit_code_2_and_no_file(
    run: Any, tmp_path: Path, argv: list[str], said: str
) -> None:
    weather = () if "--recipe" in argv else ("--weather", RAIN)
    code, text, err = run("apply", *weather, *argv, "-o", tmp_path / "out")
    assert (code, text) == (2, "")
    (line,) = err.strip().splitlines()
    assert line.startswith("torchweather: error: apply: ") or "ego_speed" in line
    assert said in line
    assert not (tmp_path / "out").exists()
