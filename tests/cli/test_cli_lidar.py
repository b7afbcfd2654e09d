"""``torchweather apply`` on point clouds: every format back as it came, with its truth beside it on request."""

from __future__ import annotations

import json
import math
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from torch import Tensor

import torchweather.io as io
from torchweather.atmosphere.weather import parse_weather
from torchweather.explain import explain
from torchweather.io import PointCloud, PointLabels, read_labels, read_points, write_labels, write_points
from torchweather.io.ouster import OusterFrame
from torchweather.sensors import Lidar
from torchweather.stages import PointKind
from torchweather.transforms import LidarWeather

STORM = "rain:rate=20+snow:rate=1"
HDL = ("--sensor", "lidar:velodyne-hdl-64e")


def cloud(columns: int = 4, rows: int = 400) -> Tensor:
    """Points all around at 3 to 60 m, whole intensities, whole further columns."""
    random = torch.Generator().manual_seed(3)
    way = torch.randn(rows, 3, generator=random) * torch.tensor([1.0, 1.0, 0.1])
    xyz = way / way.norm(dim=-1, keepdim=True) * (3 + 57 * torch.rand(rows, 1, generator=random))
    more = torch.randint(1, 60, (rows, columns - 3), generator=random).float()
    return torch.cat([xyz, more], -1)


def expected(points: Tensor, sensor: Lidar, weather: str = STORM, seed: int = 0, **options: Any) -> Any:
    options = {"lost": "drop", **options}  # of a file that holds returns only
    transform = LidarWeather(parse_weather(weather), sensor, **options)
    return transform.run(points, transform.draw(points, seed=seed))


def without_open_air(said: str) -> list[str]:
    """Lines of standard error beside the share of beams into open air."""
    return [line for line in said.splitlines() if "beams into open air" not in line]


@pytest.mark.parametrize("name", ["a.bin", "a.pcd.bin", "a.pcd", "a.ply", "a.npz", "a.csv"])
def test_a_cloud_comes_back_in_its_format_with_what_the_transform_gives(run: Any, tmp_path: Path, name: str) -> None:
    points = cloud(4 if name == "a.bin" else 5)
    write_points(tmp_path / name, points)
    before = (tmp_path / name).read_bytes()
    out = tmp_path / "out"
    code, text, err = run(
        "apply", *HDL, "--weather", STORM, tmp_path / name, "--out", out, "--seed", 7, "--json", "--quiet"
    )
    assert (code, err) == (0, "")
    (entry,) = json.loads(text)["files"]
    sensor = Lidar.preset("velodyne-hdl-64e")
    result = expected(points, sensor, seed=7)
    again = read_points(out / name)
    assert torch.equal(again.points, result.points)
    assert again.columns == read_points(tmp_path / name).columns
    assert (tmp_path / name).read_bytes() == before
    assert [path.name for path in out.iterdir()] == [name]
    rows = expected(points, sensor, seed=7, lost="zero")
    kinds = [int((rows.kind == kind).sum()) for kind in PointKind]
    assert [entry["objects"], entry["particles"], entry["lost"]] == kinds
    assert min(kinds) > 0
    assert (entry["input"], entry["output"], entry["seed"]) == (str(tmp_path / name), str(out / name), 7)
    assert (entry["points"], entry["empty_beams"]) == (400, 0)
    assert entry["floored_points"] == int(result.floored_points)
    assert entry["extinction_per_m"] == pytest.approx(
        float(LidarWeather(parse_weather(STORM), sensor).extinction_per_m), rel=1e-6
    )
    assert entry["mor_m"] == pytest.approx(explain(STORM, sensor)["mor_m"])
    assert entry["weather"]["kind"] == "mixture"


def test_frames_of_a_folder_take_seed_plus_their_number_and_a_line_each(run: Any, tmp_path: Path) -> None:
    folder = tmp_path / "in"
    folder.mkdir()
    points = cloud()
    for name in ("b.bin", "a.pcd"):
        write_points(folder / name, points)
    (folder / "note.txt").write_text("no cloud")
    code, text, err = run("apply", *HDL, "--weather", "snow:rate=2", folder, "--out", tmp_path / "out", "--seed", 4)
    assert code == 0
    open_air, left_out = err.splitlines()
    assert left_out == f"torchweather: left out: 1 file or folder of those given: {folder / 'note.txt'}."
    assert open_air.startswith("torchweather: Of beams into open air ")
    assert open_air.endswith(" %, as the near response is not measured.")
    lines = text.strip().splitlines()
    assert [line.split()[0] for line in lines] == [str(folder / "a.pcd"), str(folder / "b.bin")]
    assert "seed 4" in lines[0]
    assert "seed 5" in lines[1]
    for word in ("points 400: objects", "particles", "lost", "empty beams 0", "detection floor", "1/m", "visibility"):
        assert word in lines[0]
    for name, seed in (("a.pcd", 4), ("b.bin", 5)):
        wanted = expected(points, Lidar.preset("velodyne-hdl-64e"), "snow:rate=2", seed).points
        assert torch.equal(read_points(tmp_path / "out" / name).points, wanted)


@pytest.mark.parametrize("weather", ["rain:rate=0", "fog:mor=inf", "snow:rate=0"])
@pytest.mark.parametrize("name", ["a.bin", "a.pcd"])
def test_no_weather_gives_the_file_back_bit_for_bit(run: Any, tmp_path: Path, name: str, weather: str) -> None:
    write_points(tmp_path / name, cloud())
    code, text, _ = run("apply", *HDL, "--weather", weather, tmp_path / name, "-o", tmp_path / "out", "--json")
    assert code == 0
    assert (tmp_path / "out" / name).read_bytes() == (tmp_path / name).read_bytes()
    (entry,) = json.loads(text)["files"]
    assert (entry["objects"], entry["lost"], entry["mor_m"]) == (400, 0, None)


def test_lost_points_become_zero_nan_or_are_left_out(run: Any, tmp_path: Path) -> None:
    points = cloud()
    write_points(tmp_path / "a.pcd", points)
    kind = expected(points, Lidar.preset("velodyne-hdl-64e"), lost="zero").kind
    lost = kind == PointKind.LOST
    found = {}
    for lost_as in ("zero", "nan", "drop"):
        out = tmp_path / lost_as
        assert run("apply", *HDL, "--weather", STORM, tmp_path / "a.pcd", "-o", out, "--lost", lost_as)[0] == 0
        found[lost_as] = read_points(out / "a.pcd")
    assert found["zero"].nan_rows == 0
    assert (found["zero"].points[lost, :3] == 0).all()
    assert found["nan"].nan_rows == int(lost.sum())
    assert torch.equal(found["drop"].points, found["zero"].points[~lost])


def test_a_file_that_marks_empty_beams_by_nan_gets_its_lost_points_so(run: Any, tmp_path: Path) -> None:
    points = cloud()
    points[::7] = 0
    missing = torch.zeros_like(points, dtype=torch.bool)
    missing[::7, :3] = True
    write_points(tmp_path / "a.pcd", PointCloud(points, ("x", "y", "z", "intensity"), (20, 20), missing))
    code, text, err = run("apply", *HDL, "--weather", STORM, tmp_path / "a.pcd", "-o", tmp_path / "out", "--json")
    assert code == 0
    (line,) = without_open_air(err)
    assert "58 rows without a return have no direction" in line
    (entry,) = json.loads(text)["files"]
    again = read_points(tmp_path / "out" / "a.pcd")
    assert entry["empty_beams"] == 58
    assert entry["lost"] > 0
    assert entry["objects"] + entry["particles"] + entry["lost"] + 58 == 400
    assert again.nan_rows == entry["lost"] + 58
    assert again.grid == (20, 20)


def test_dual_returns_get_a_file_of_their_own_row_by_row(run: Any, tmp_path: Path) -> None:
    points = cloud(rows=3000)
    write_points(tmp_path / "a.bin", points)
    code, text, _ = run(
        "apply", *HDL, "--weather", "snow:rate=3", tmp_path / "a.bin", "-o", tmp_path / "out", "--return-mode", "dual",
        "--labels", "npz", "--json",
    )  # fmt: skip
    assert code == 0
    (entry,) = json.loads(text)["files"]
    result = expected(points, Lidar.preset("velodyne-hdl-64e", return_mode="dual"), "snow:rate=3", lost="zero")
    second = read_points(entry["second"]).points
    assert Path(entry["second"]).name == "a_second.bin"
    assert torch.equal(second, result.second)
    assert entry["second_objects"] + entry["second_particles"] == int((second[:, :3] != 0).any(-1).sum()) > 0
    with np.load(entry["labels"]) as truth:
        assert set(truth) == {"kind", "source", "transmission", "second_kind", "second_source"}
        for name in truth:
            assert np.array_equal(truth[name], getattr(result, name).numpy()), name


def test_labels_of_the_clear_cloud_are_carried_on(run: Any, tmp_path: Path) -> None:
    points = cloud()
    write_points(tmp_path / "a.bin", points)
    (tmp_path / "labels").mkdir()
    classes = torch.arange(400) % 50 + 1
    write_labels(tmp_path / "labels" / "a.label", PointLabels(classes, classes + 5))
    given = ("--labels", "label", "--labels-in", tmp_path / "labels", "--lost", "drop")
    code, _, _ = run("apply", *HDL, "--weather", STORM, tmp_path / "a.bin", "-o", tmp_path / "out", *given)
    assert code == 0
    result = expected(points, Lidar.preset("velodyne-hdl-64e"), lost="drop")
    found = read_labels(tmp_path / "out" / "a.label", len(result.points))
    is_object = result.kind == PointKind.OBJECT
    assert torch.equal(found.classes, torch.where(is_object, classes[result.source], 110))
    assert torch.equal(found.instances, torch.where(is_object, classes[result.source] + 5, 0))
    # Without labels of the input a particle is all that a label tells.
    assert run("apply", *HDL, "--weather", STORM, tmp_path / "a.bin", "-o", tmp_path / "out", *given[:2])[0] == 0
    kind = expected(points, Lidar.preset("velodyne-hdl-64e")).kind
    assert torch.equal(read_labels(tmp_path / "out" / "a.label").classes, torch.where(kind == 1, 110, 0))


def test_a_complete_scan_adds_the_beams_between_the_points(run: Any, tmp_path: Path) -> None:
    # One ring at 1 degree elevation of 1808 columns with every fourth point gone.
    angle = torch.arange(1808) * (2 * math.pi / 1808)
    rise = math.radians(1.0)
    way = torch.stack(
        [angle.cos() * math.cos(rise), angle.sin() * math.cos(rise), torch.full_like(angle, math.sin(rise))], -1
    )
    points = torch.cat([20 * way, torch.full((1808, 1), 30.0), torch.full((1808, 1), 8.0)], -1)
    points = points[torch.arange(1808) % 4 != 0]
    write_points(tmp_path / "a.pcd", points)
    code, text, _ = run(
        "apply", "--sensor", "lidar:velodyne-vlp-16", "--weather", "fog:mor=30", tmp_path / "a.pcd", "-o",
        tmp_path / "out", "--complete-scan", "--labels", "npz", "--json", "--quiet",
    )  # fmt: skip
    assert code == 0
    (entry,) = json.loads(text)["files"]
    assert entry["points"] == 1356
    assert entry["empty_beams"] == 452
    again = read_points(tmp_path / "out" / "a.pcd")
    assert len(again.points) == entry["objects"] + entry["particles"]
    # They end between the returns at 20 m, where in fog of 30 m nearly every beam returns the fog.
    assert entry["beam_ends"] == {"obstacle": 452}
    assert entry["scan"].startswith("completed from the scan pattern with 452 beams, which end: 452 at an obstacle")
    with np.load(entry["labels"]) as truth:
        assert (truth["source"] == -1).sum() > 0.9 * 452
        assert (truth["kind"][truth["source"] == -1] == PointKind.PARTICLE).all()


def test_a_cloud_without_intensity_keeps_its_columns(run: Any, tmp_path: Path) -> None:
    points = cloud(5)
    write_points(tmp_path / "a.csv", points[:, [0, 1, 2, 4]], columns=("x", "y", "z", "ring"))
    argv = ("apply", *HDL, "--weather", STORM, tmp_path / "a.csv", "-o", tmp_path / "out", "--quiet")
    code, _, err = run(*argv)
    assert code == 2
    assert "a.csv" in err
    assert run(*argv, "--intensity", "none")[0] == 0
    again = read_points(tmp_path / "out" / "a.csv", intensity="none")
    assert again.columns == ("x", "y", "z", "ring")
    ones = torch.cat([points[:, :3], torch.ones(400, 1)], -1)
    wanted = expected(ones, Lidar.preset("velodyne-hdl-64e", intensity_unit="none"))
    assert torch.equal(again.points[:, :3], wanted.points[:, :3])


def test_frames_of_a_recording_become_files_with_their_number(
    run: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    points = cloud(5, 60)
    way = points[:, :3] / points[:, :3].norm(dim=-1, keepdim=True)
    points[::2, :4] = 0
    (tmp_path / "drive.pcap").write_bytes(b"")
    asked: list[dict[str, Any]] = []

    def read_ouster(path: Path, meta: Path | None, **options: Any) -> Iterator[OusterFrame]:
        asked.append({"path": path, "meta": meta, **options})
        one = PointCloud(points, ("x", "y", "z", "intensity", "ring"), (6, 10))
        for number in range(2):
            yield OusterFrame(one, way, torch.zeros_like(way), number, torch.zeros(10, dtype=torch.int64))

    monkeypatch.setattr(io, "read_ouster", read_ouster)
    code, text, err = run(
        "apply", "--sensor", "lidar:ouster-os1-128", "--weather", "fog:mor=20", tmp_path / "drive.pcap", "-o",
        tmp_path / "out", "--json",
    )  # fmt: skip
    assert (code, without_open_air(err)) == (0, [])
    assert asked == [{"path": tmp_path / "drive.pcap", "meta": None, "intensity": "reflectivity"}]
    first, second = json.loads(text)["files"]
    assert [Path(entry["output"]).name for entry in (first, second)] == ["drive_0000.pcd", "drive_0001.pcd"]
    assert [(entry["frame"], entry["seed"]) for entry in (first, second)] == [(0, 0), (1, 1)]
    assert first["empty_beams"] == 30
    # The recording knows where its empty beams look: fog returns there too.
    transform = LidarWeather(parse_weather("fog:mor=20"), Lidar.preset("ouster-os1-128"))
    wanted = transform.run(points, transform.draw(points, seed=0), directions=way)
    assert isinstance(wanted.kind, Tensor)
    assert isinstance(wanted.points, Tensor)
    assert bool((wanted.kind[::2] == PointKind.PARTICLE).any())
    again = read_points(first["output"])
    assert again.grid == (6, 10)
    assert torch.equal(again.points, wanted.points)


def test_a_recipe_sets_sensor_and_options_and_arguments_come_first(run: Any, tmp_path: Path) -> None:
    points = cloud()
    write_points(tmp_path / "a.bin", points)
    argv = (
        "apply",
        "--recipe",
        "hdl64-fog-50m-hahner",
        tmp_path / "a.bin",
        "-o",
        tmp_path / "out",
        "--json",
        "--quiet",
    )
    code, text, _ = run(*argv)
    assert code == 0
    hdl = Lidar.preset("velodyne-hdl-64e")
    wanted = expected(points, hdl, "fog:mor=50", variant="hahner").points
    assert torch.equal(read_points(tmp_path / "out" / "a.bin").points, wanted)
    assert json.loads(text)["files"][0]["extinction_per_m"] == pytest.approx(math.log(20) / 50, rel=1e-4)
    code, text, _ = run(*argv, "--return-mode", "last", "--near-full-m", 20)
    assert code == 0
    later = Lidar.preset("velodyne-hdl-64e", return_mode="last", near_full_m=20.0)
    wanted = expected(points, later, "fog:mor=50", variant="hahner").points
    assert torch.equal(read_points(tmp_path / "out" / "a.bin").points, wanted)


def test_intensities_that_do_not_fit_the_sensor_are_said_once(run: Any, tmp_path: Path) -> None:
    points = cloud()
    points[:, 3] = torch.rand(400, generator=torch.Generator().manual_seed(1))
    for name in ("a.bin", "b.bin"):
        write_points(tmp_path / name, points)
    argv = ("apply", *HDL, "--weather", "rain:rate=5", tmp_path / "a.bin", tmp_path / "b.bin", "-o", tmp_path / "out")
    code, _, err = run(*argv, "--force")
    assert code == 0
    lines = without_open_air(err)
    assert len(lines) == 2
    assert any("reflectivity (0-1)" in line for line in lines)
    assert any("--intensity-unit" in line for line in lines)
    assert without_open_air(run(*argv, "--intensity-unit", "reflectivity")[2]) == []


@pytest.mark.parametrize(
    ("argv", "said"),
    [
        (["{a}", "-o", "{out}", "--return-mode", "all"], "strongest"),
        (["{a}", "-o", "{out}", "--intensity-unit", "volts"], "uint8_linear"),
        (["{a}", "-o", "{out}", "--lost", "gone"], "drop"),
        (["{a}", "-o", "{out}", "--lost", "nan"], "{out}"),
        (["{a}", "-o", "{out}", "--depth", "30"], "--depth is for a camera"),
        (["{a}", "-o", "{out}", "--labels-in", "{here}"], "--labels label"),
        (["{a}", "-o", "{out}", "--labels", "label", "--labels-in", "{here}"], "a.label"),
        (["{a}", "-o", "{here}"], "overwritten"),
        (["{a}", "{other}", "-o", "{out}"], "both"),
        (["{cut}", "-o", "{out}"], "cut.bin"),
        (["{bad}", "-o", "{out}"], "bad.pcd"),
        (["{negative}", "-o", "{out}"], "negative.bin"),
        (["{image}", "-o", "{out}"], "--sensor camera"),
        (["{none}", "-o", "{out}"], "no such file"),
        (["{empty}", "-o", "{out}"], "no point clouds"),
        (["{pcap}", "-o", "{out}"], "json"),
        (["{a}", "-o", "{out}", "--complete-scan", "--columns", "0"], "columns"),
        (["{a}", "-o", "{out}", "--sensor", "lidar:velodyne-hdl-64"], "velodyne-hdl-64e"),
        (["{a}", "-o", "{out}", "--sensor", "sonar"], "camera, lidar or radar"),
        (["{a}", "-o", "{out}", "--recipe", "camera/fog-30m"], "is for a camera"),
    ],
)
def test_a_mistake_gives_one_line_exit_code_2_and_no_file(run: Any, tmp_path: Path, argv: list[str], said: str) -> None:
    here = tmp_path / "here"
    (here / "empty").mkdir(parents=True)
    (here / "other").mkdir()
    write_points(here / "a.bin", cloud())
    write_points(here / "other" / "a.bin", cloud())
    (here / "cut.bin").write_bytes((here / "a.bin").read_bytes()[:-3])
    write_points(here / "bad.pcd", cloud(), encoding="binary")
    (here / "bad.pcd").write_bytes((here / "bad.pcd").read_bytes()[:-8])
    negative = cloud()
    negative[5, 3] = -1.0
    write_points(here / "negative.bin", negative)
    (here / "image.png").write_bytes(b"")
    (here / "drive.pcap").write_bytes(b"")
    before = {path: path.read_bytes() for path in here.rglob("*") if path.is_file()}
    out = tmp_path / "out"
    names = {
        "a": here / "a.bin", "other": here / "other" / "a.bin", "cut": here / "cut.bin", "bad": here / "bad.pcd",
        "negative": here / "negative.bin", "image": here / "image.png", "none": here / "none.bin",
        "empty": here / "empty", "pcap": here / "drive.pcap", "here": here, "out": out,
    }  # fmt: skip
    sensor = () if "--sensor" in argv else HDL
    weather = () if "--recipe" in argv else ("--weather", STORM)
    code, text, err = run("apply", *sensor, *weather, *(part.format(**names) for part in argv))
    assert (code, text) == (2, "")
    (line,) = err.strip().splitlines()
    assert line.startswith("torchweather: error: ")
    assert said.format(**names) in line
    assert {path: path.read_bytes() for path in here.rglob("*") if path.is_file()} == before
    assert not out.exists() or not list(out.iterdir())


def test_a_cloud_without_a_sensor_asks_for_one_and_a_lidar_without_a_preset_names_its_own(
    run: Any, tmp_path: Path
) -> None:
    write_points(tmp_path / "a.bin", cloud())
    argv = ("apply", "--weather", "rain:rate=5", tmp_path / "a.bin", "-o", tmp_path / "out")
    code, _, err = run(*argv)
    assert code == 2
    assert "--sensor lidar:PRESET" in err
    code, _, err = run(*argv, "--sensor", "lidar")
    assert code == 0
    assert "lidar:ouster-os1-128" in err
    code, _, err = run("apply", "--weather", "rain:rate=5", tmp_path / "a.bin", "-o", tmp_path / "out", "--lost", "nan")
    assert code == 2


@pytest.mark.parametrize("rows", [0, 1])
def test_an_empty_cloud_and_one_point_are_results(run: Any, tmp_path: Path, rows: int) -> None:
    write_points(tmp_path / "a.pcd", cloud()[:rows])
    given = ("--labels", "label", "--return-mode", "dual")
    code, text, _ = run("apply", *HDL, "--weather", STORM, tmp_path / "a.pcd", "-o", tmp_path / "out", "--json", *given)
    assert code == 0
    (entry,) = json.loads(text)["files"]
    assert entry["points"] == rows == len(read_points(entry["output"]).points)


def test_list_and_explain_know_the_lidar(run: Any) -> None:
    _, text, _ = run("list")
    assert "lidar/os1-fog-50m" in text
    assert "lidar:pandar64-wads" in text
    names = json.loads(run("list", "--json")[1])
    assert {"ToEnergy", "ParticleReturns", "Detection", "ToPoints"} <= set(names["stages"])
    sensors = {recipe["sensor"] for recipe in names["recipes"] if recipe["kind"] == "transform"}
    assert {"lidar:ouster-os1-128", "lidar:velodyne-hdl-64e", "lidar:pandar64-wads"} <= sensors


def test_a_cloud_whose_intensities_contradict_the_sensor_stops_the_run(run: Any, tmp_path: Path) -> None:
    rows = torch.zeros(200, 4)
    rows[:, 0] = torch.linspace(20.0, 60.0, 200)
    rows[:, 3] = 1e-4  # per cent would be plausible, a reflectivity of 1e-4 at 20 m is not
    write_points(tmp_path / "a.bin", rows)
    argv = ("apply", tmp_path / "a.bin", "--sensor", "lidar:velodyne-hdl-64e", "--intensity-unit", "reflectivity")
    argv = (*argv, "--weather", "fog:mor=100", "--out", tmp_path / "out")
    code, _, err = run(*argv)
    assert code == 2
    assert "200 of 200 points are, by their intensity, fainter than the sensor can detect" in err
    assert "--intensity-unit" in err
    assert "--force" in err
    code, _, err = run(*argv, "--force")
    assert code == 0
    assert (tmp_path / "out/a.bin").is_file()


def test_a_file_of_returns_only_gets_no_rows_of_zeros_and_one_with_rows_of_zeros_keeps_them(
    run: Any, tmp_path: Path
) -> None:
    points = cloud()
    write_points(tmp_path / "returns.bin", points)
    with_empty = torch.cat([points, torch.zeros(5, 4)])
    write_points(tmp_path / "rows.bin", with_empty)
    for name in ("returns.bin", "rows.bin"):
        assert run("apply", *HDL, "--weather", STORM, tmp_path / name, "-o", tmp_path / "out", "--quiet")[0] == 0
    returns = read_points(tmp_path / "out" / "returns.bin").points
    assert len(returns) < 400
    assert bool((returns[:, :3] != 0).any(-1).all())
    assert len(read_points(tmp_path / "out" / "rows.bin").points) == 405


def test_sky_only_belongs_to_complete_scan(run: Any, tmp_path: Path) -> None:
    write_points(tmp_path / "a.bin", cloud())
    argv = ("apply", *HDL, "--weather", STORM, tmp_path / "a.bin", "-o", tmp_path / "out", "--sky-only")
    code, _, err = run(*argv)
    assert code == 2
    assert "give --complete-scan too" in err
