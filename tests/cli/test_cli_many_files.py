"""Runs over many files: seeds that share no storm, broken and left-out files, safe names, and the record."""

from __future__ import annotations

import itertools
import json
import os
import signal
import sys
from pathlib import Path
from typing import Any

import pytest
import torch

import torchweather
from torchweather.cli import apply_camera
from torchweather.cli.output import printable
from torchweather.cli.run_record import NAME as RECORD
from torchweather.core.random import sample_seed
from torchweather.io import write_image, write_points
from torchweather.sensors import Lidar

SNOW = ("--weather", "snow:rate=2", "--depth", 30, "--airlight", 0.7, 0.7, 0.7, "--quiet")


AS_TYPED = True  # seeds and records as users have them


def frames(folder: Path, *names: str) -> Path:
    folder.mkdir(parents=True, exist_ok=True)
    for name in names:
        write_image(folder / name, torch.full((3, 24, 32), 120, dtype=torch.uint8))
    return folder


def files_of(text: str) -> list[dict[str, Any]]:
    found: list[dict[str, Any]] = json.loads(text)["files"]
    return found


# ---- seeds ---------------------------------------------------------------------------------------------------------


def test_runs_of_four_seeds_share_no_storm(run: Any, tmp_path: Path) -> None:
    folder = frames(tmp_path / "in", *(f"{number}.png" for number in range(5)))
    seeds: dict[int, list[int]] = {}
    pictures: dict[tuple[int, str], bytes] = {}
    for seed in range(4):
        out = tmp_path / f"out{seed}"
        code, text, _ = run("apply", folder, *SNOW, "--seed", seed, "-o", out, "--json")
        assert code == 0
        seeds[seed] = [entry["seed"] for entry in files_of(text)]
        pictures |= {(seed, f"{number}.png"): (out / f"{number}.png").read_bytes() for number in range(5)}
    assert seeds[1] == [sample_seed(1, f"{number}.png") for number in range(5)]
    assert len(set(itertools.chain(*seeds.values()))) == 20
    assert len(set(pictures.values())) == 20  # the frames are alike: what differs is the storm
    # The same seed gives the same files, also where a frame is done alone.
    assert run("apply", folder / "3.png", *SNOW, "--seed", 2, "-o", tmp_path / "again")[0] == 0
    assert (tmp_path / "again" / "3.png").read_bytes() == pictures[2, "3.png"]


def test_the_old_rule_of_seeds_stays_by_name(run: Any, tmp_path: Path) -> None:
    folder = frames(tmp_path / "in", "0.png", "1.png")
    old = [
        files_of(run("apply", folder, *SNOW, "--seed", seed, "--seed-rule", "added", "-o", tmp_path / "o", "--json")[1])
        for seed in (0, 1)
    ]
    assert [[entry["seed"] for entry in entries] for entries in old] == [[0, 1], [1, 2]]


@pytest.mark.usefixtures("undrawn")
def test_sweeps_of_two_seeds_share_no_storm(run: Any, tmp_path: Path) -> None:
    write_points(tmp_path / "a.bin", torch.rand(200, 4, generator=torch.Generator().manual_seed(1)) * 20)
    common = (tmp_path / "a.bin", "--sensor", "lidar:velodyne-hdl-64e", "--weather", "snow:rate=1,5", "--seeds", 3)
    drawn = []
    for seed in (0, 1):
        argv = (*common, "--metrics", "mde", "--force", "--seed", seed, "-o", tmp_path / f"s{seed}", "--json")
        code, text, _ = run("sweep", *argv, "--quiet")
        assert code == 0
        drawn.append(json.loads(text)["seeds"])
    assert drawn[0] == [sample_seed(0, k) for k in range(3)]
    assert not set(drawn[0]) & set(drawn[1])
    (record,) = json.loads((tmp_path / "s1" / RECORD).read_text())["runs"]
    assert (record["seed"], record["seeds"], record["command"]) == (1, drawn[1], "sweep")
    assert record["sensors"] == [json.loads(json.dumps(Lidar.preset("velodyne-hdl-64e").to_dict()))]
    assert [weather["rate_mm_per_h"] for weather in record["weather"]] == [1, 5]


# ---- what is asked for ---------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("weather", "said"),
    [
        ("snow", "Give e.g. snow:rate=1."),
        ("rain", "Give e.g. rain:rate=25."),
        ("fog", "Give e.g. fog:mor=100."),
        ("rain:rate=5+fog", "weather 'fog': expected a visibility in metres"),
        ("snow:size_distribution=gunn-marshall", "expected a rate in mm/h"),
    ],
)
def test_a_weather_without_its_intensity_is_refused(run: Any, tmp_path: Path, weather: str, said: str) -> None:
    folder = frames(tmp_path / "in", "0.png")
    for argv in (("apply", folder, "-o", tmp_path / "out"), ("explain",)):
        code, out, err = run(*argv, "--weather", weather)
        assert (code, out) == (2, "")
        assert said in err
    assert not (tmp_path / "out").exists()


def test_a_weather_beside_a_recipe_is_refused(run: Any, tmp_path: Path) -> None:
    folder = frames(tmp_path / "in", "0.png")
    code, _, err = run("apply", folder, "--weather", "rain:rate=5", "--recipe", "camera/fog-30m", "-o", tmp_path / "o")
    assert code == 2
    assert "expected --weather or --recipe" in err
    assert not (tmp_path / "o").exists()


# ---- broken, hidden and other files --------------------------------------------------------------------------------


def test_a_broken_file_does_not_stop_the_others(run: Any, tmp_path: Path) -> None:
    folder = frames(tmp_path / "in", "a.png", "c.png")
    (folder / "b.png").write_bytes((folder / "a.png").read_bytes()[:60])
    code, text, err = run("apply", folder, *SNOW, "-o", tmp_path / "out", "--json")
    assert code == 1
    found = json.loads(text)
    assert [Path(entry["output"]).name for entry in found["files"]] == ["a.png", "c.png"]
    assert list(found["broken"]) == [str(folder / "b.png")]
    assert "1 of 3 files are broken" in err.replace("\n", " ")
    assert not (tmp_path / "out" / "b.png").exists()
    # The storm of a frame is that of its name: the broken one shifts none.
    assert [entry["seed"] for entry in found["files"]] == [sample_seed(0, name) for name in ("a.png", "c.png")]


@pytest.mark.parametrize("kind", ["lidar", "radar"])
def test_a_broken_cloud_or_list_does_not_stop_the_others(run: Any, tmp_path: Path, kind: str) -> None:
    folder = tmp_path / "in"
    folder.mkdir()
    if kind == "lidar":
        for name in ("a.bin", "c.bin"):
            write_points(folder / name, torch.rand(200, 4, generator=torch.Generator().manual_seed(1)) * 20)
        (folder / "b.bin").write_bytes(b"123")
        sensor = "lidar:velodyne-hdl-64e"
    else:
        for name in ("a.csv", "c.csv"):
            (folder / name).write_text("x_m,y_m,z_m,speed_m_per_s,rcs_dbsm\n20,1,0,0,5\n")
        (folder / "b.csv").write_text("x_m,y_m,z_m,speed_m_per_s,rcs_dbsm\n20,1,0,0\n")
        sensor = "radar:imaging-77ghz"
    argv = ("--sensor", sensor, "--weather", "snow:rate=1", "--quiet", "--json", "-o", tmp_path / "out")
    code, text, err = run("apply", folder, *argv, *(("--force",) if kind == "lidar" else ()))
    assert code == 1
    found = json.loads(text)
    assert len(found["files"]) == 2
    assert [Path(name).stem for name in found["broken"]] == ["b"]
    assert "Traceback" not in err


def test_where_every_file_is_broken_the_exit_code_is_2(run: Any, tmp_path: Path) -> None:
    folder = tmp_path / "in"
    folder.mkdir()
    for name in ("a.png", "b.png"):
        (folder / name).write_bytes(b"\x89PNG")
    code, out, err = run("apply", folder, *SNOW, "-o", tmp_path / "out")
    assert (code, out) == (2, "")
    assert "none of 2 files could be done" in err
    assert not (tmp_path / "out").exists()


def test_hidden_files_are_no_data_and_others_are_counted(run: Any, tmp_path: Path) -> None:
    folder = frames(tmp_path / "in", "0.png", "1.png")
    for name in ("._0.png", ".DS_Store"):
        (folder / name).write_bytes(b"Mac OS X")
    frames(folder / ".Trash-0", "old.png")
    frames(folder / "night", "2.png")
    (folder / "times.txt").write_text("0\n")
    argv = [*SNOW[:-1], "-o", tmp_path / "out"]
    code, text, err = run("apply", folder, *argv, "--json")
    assert code == 0
    assert len(files_of(text)) == 2
    assert json.loads(text)["left_out"] == [f"{folder / 'night'}/", str(folder / "times.txt")]
    assert "left out: 2 files or folders of those given" in err
    assert ".DS_Store" not in err


def test_names_cannot_steer_the_terminal(run: Any, tmp_path: Path) -> None:
    name = "a\x1b[2J\nb.png"
    folder = frames(tmp_path / "in", name, "z.png")
    (folder / "\x1b]0;x\x07.png").write_bytes(b"broken")
    code, out, err = run("apply", folder, *SNOW, "-o", tmp_path / "out")
    assert code == 1
    assert "\x1b" not in out + err
    assert "\x07" not in out + err
    assert len(out.strip().splitlines()) == 2  # one a frame
    assert r"a\x1b[2J\nb.png" in out
    assert printable("a\u202eb\udcff") == r"a\u202eb\udcff"


@pytest.mark.skipif(os.name == "nt", reason="names are UTF-16 there")
def test_a_name_that_is_no_unicode_does_not_stop_the_run(run: Any, tmp_path: Path) -> None:
    folder = frames(tmp_path / "in", "0.png")
    bad = os.fsdecode(b"\xff\xfe.png")
    os.rename(folder / "0.png", folder / bad)
    frames(folder, "1.png")
    code, out, err = run("apply", folder, *SNOW, "-o", tmp_path / "out")
    assert (code, err) == (0, "")
    assert len(out.strip().splitlines()) == 2
    assert sorted(os.listdir(tmp_path / "out")) == sorted(["1.png", bad, RECORD])


# ---- the record ----------------------------------------------------------------------------------------------------


def test_a_record_beside_the_results_says_what_was_made_how(run: Any, tmp_path: Path) -> None:
    folder = frames(tmp_path / "in", "0.png", "1.png")
    out = tmp_path / "out"
    assert run("apply", folder, *SNOW, "--seed", 3, "-o", out)[0] == 0
    content = json.loads((out / RECORD).read_text())
    assert content["format"] == "torchweather-record/1"
    (record,) = content["runs"]
    assert (record["command"], record["torchweather"]) == ("apply", torchweather.__version__)
    assert (record["seed"], record["seed_rule"], record["depth"]) == (3, "hashed", "30")
    assert record["weather"]["rate_mm_per_h"] == 2
    assert (record["sensors"][0]["width"], record["sensors"][0]["height"]) == (32, 24)
    assert record["options"]["airlight"] == [0.7, 0.7, 0.7]
    assert [entry["seed"] for entry in record["files"]] == [sample_seed(3, "0.png"), sample_seed(3, "1.png")]
    # A later run in the same folder replaces what it wrote anew, and nothing else.
    assert run("apply", folder / "1.png", *SNOW, "--seed", 4, "-o", out)[0] == 0
    runs = json.loads((out / RECORD).read_text())["runs"]
    assert [(one["seed"], [Path(entry["output"]).name for entry in one["files"]]) for one in runs] == [
        (3, ["0.png"]),
        (4, ["1.png"]),
    ]


def test_the_record_says_where_an_airlight_was_guessed(run: Any, tmp_path: Path) -> None:
    """A frame without sky and without ``--airlight``: the warning stands beside each frame that it is about."""
    folder = frames(tmp_path / "in", "0.png", "1.png")
    argv = ("--weather", "fog:mor=50", "--depth", 30, "--quiet")
    code, _, err = run("apply", folder, *argv, "-o", tmp_path / "out")
    assert (code, err.count("no airlight given")) == (0, 1)
    (record,) = json.loads((tmp_path / "out" / RECORD).read_text())["runs"]
    assert len(record["files"]) == 2
    for entry in record["files"]:
        (text,) = entry["warnings"]
        assert "no sky in the frame and no airlight given" in text
    assert run("apply", folder, *SNOW, "-o", tmp_path / "given")[0] == 0
    (record,) = json.loads((tmp_path / "given" / RECORD).read_text())["runs"]
    assert all("warnings" not in entry for entry in record["files"])


def test_no_record_leaves_it_out_and_a_damaged_one_is_refused_first(run: Any, tmp_path: Path) -> None:
    folder = frames(tmp_path / "in", "0.png")
    assert run("apply", folder, *SNOW, "-o", tmp_path / "out", "--no-record")[0] == 0
    assert [path.name for path in (tmp_path / "out").iterdir()] == ["0.png"]
    for content in ("{", "[" * 100_000, "[]", '{"format": 1}', '{"format": "torchweather-record/1", "runs": [1]}'):
        (tmp_path / "out" / RECORD).write_text(content)
        code, _, err = run("apply", folder, *SNOW, "-o", tmp_path / "out")
        assert code == 2
        assert "--no-record" in err
        assert (tmp_path / "out" / RECORD).read_text() == content


def test_a_cloud_s_record_holds_its_sensor(run: Any, tmp_path: Path) -> None:
    write_points(tmp_path / "a.bin", torch.rand(200, 4, generator=torch.Generator().manual_seed(1)) * 20)
    argv = ("--sensor", "lidar:velodyne-hdl-64e", "--max-range-m", 60, "--lost", "nan", "--force", "--quiet")
    assert run("apply", tmp_path / "a.bin", "--weather", "fog:mor=50", *argv, "-o", tmp_path / "out")[0] == 0
    (record,) = json.loads((tmp_path / "out" / RECORD).read_text())["runs"]
    assert record["sensors"][0]["max_range_m"] == 60
    assert record["options"] == {"lost": "nan"}
    assert record["files"][0]["mor_m"] == pytest.approx(50, rel=1e-3)


# ---- extras, tables ------------------------------------------------------------------------------------------------


def test_what_needs_an_extra_says_so_in_a_line_and_stops_nothing(
    run: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name in ("ouster", "ouster.sdk", "ray", "ray.data"):
        monkeypatch.setitem(sys.modules, name, None)
    folder = tmp_path / "in"
    folder.mkdir()
    write_points(folder / "a.bin", torch.rand(50, 4, generator=torch.Generator().manual_seed(1)) * 20)
    (folder / "b.pcap").write_bytes(b"x")
    (folder / "b.json").write_text("{}")
    argv = ("--sensor", "lidar:ouster-os1-128", "--weather", "snow:rate=1", "-o", tmp_path / "out", "--quiet")
    code, out, err = run("apply", folder / "b.pcap", *argv)
    assert (code, out, len(err.strip().splitlines())) == (2, "", 1)
    assert "torchweather[ouster]" in err
    code, out, err = run("apply", folder, *argv)
    assert (code, len(out.strip().splitlines())) == (1, 1)
    assert "torchweather[ouster]" in err
    (folder / "b.pcap").unlink()
    code, out, err = run("augment", folder, tmp_path / "dst", "--recipe", "lidar/os1-fog-50m", "--engine", "ray")
    assert (code, out, len(err.strip().splitlines())) == (2, "", 1)
    assert "torchweather[scale]" in err
    assert not (tmp_path / "dst").exists()


def test_a_run_that_is_interrupted_leaves_the_record_of_what_it_did(
    run: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = frames(tmp_path / "in", "0.png", "1.png", "2.png")
    real = apply_camera.write_image

    def interrupted(path: Path, image: Any, **options: Any) -> None:
        if path.name == "1.png":
            os.kill(os.getpid(), signal.SIGTERM)
        real(path, image, **options)

    monkeypatch.setattr(apply_camera, "write_image", interrupted)
    code, _, err = run("apply", folder, *SNOW, "-o", tmp_path / "out")
    assert code == 143
    assert err == "torchweather: interrupted by SIGTERM\n"
    (record,) = json.loads((tmp_path / "out" / RECORD).read_text())["runs"]
    assert [Path(entry["output"]).name for entry in record["files"]] == ["0.png"]
    assert signal.getsignal(signal.SIGTERM) == signal.SIG_DFL


def test_scores_as_csv_hold_no_formulas(run: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    frames(tmp_path, "=a.png", "+b.png")
    monkeypatch.chdir(tmp_path)
    code, out, _ = run("metrics", "=a.png", "+b.png", "--csv", "--metrics", "psnr")
    assert code == 0
    assert out.splitlines()[1].startswith("'=a.png,'+b.png,")
