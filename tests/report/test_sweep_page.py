"""The folder of a sweep: table, summary and page hold the same numbers, and nothing is left where something fails."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import pytest
import torch

from tests.report.parsed_page import Page
from torchweather.core.errors import TorchweatherError
from torchweather.evaluation.sweep import CameraSubject, LidarSubject, parse_levels
from torchweather.io import read_table
from torchweather.report.sweep_page import write_sweep
from torchweather.scenes import lidar_view, test_track
from torchweather.scenes.raw_frame import raw_frame
from torchweather.sensors import Camera, Lidar

Written = tuple[Path, dict[str, Any]]


@pytest.fixture(scope="module")
def camera() -> CameraSubject:
    frame = raw_frame(test_track(), Camera.preset("lucid-triton").resized(96, 72))
    return CameraSubject("test-track", frame.bayer, frame.depth_m, frame.camera)


@pytest.fixture(scope="module")
def lidar() -> LidarSubject:
    sensor = Lidar.preset("ouster-os1-128", columns=32)
    view = lidar_view(test_track(), sensor, range_noise_seed=0)
    return LidarSubject("<track>", points=view.points, lidar=sensor, beams=view.directions)


@pytest.fixture(scope="module")
def of_camera(camera: CameraSubject, tmp_path_factory: pytest.TempPathFactory) -> Written:
    out = tmp_path_factory.mktemp("page") / "camera"
    levels = parse_levels("rain:rate=1,25") + parse_levels("fog:mor=400,30")
    summary = write_sweep(out, [camera], levels, [3, 4], ["psnr", "gmsd"], sensor="camera:x", progress=False)
    return out, summary


@pytest.fixture(scope="module")
def of_lidar(lidar: LidarSubject, tmp_path_factory: pytest.TempPathFactory) -> Written:
    out = tmp_path_factory.mktemp("page") / "lidar"
    summary = write_sweep(
        out, [lidar], parse_levels("rain:rate=1,5,10"), [0, 1], sensor="lidar:x", notes=["A & B."], progress=False
    )
    return out, summary


def page_of(written: Written) -> Page:
    return Page((written[0] / "index.html").read_text(encoding="utf-8"))


def test_the_folder_holds_table_summary_and_page(of_camera: Written) -> None:
    out, summary = of_camera
    assert {path.name for path in out.iterdir()} == {"scores.csv", "summary.json", "index.html"}
    assert json.loads((out / "summary.json").read_text(encoding="utf-8")) == summary
    assert [series["weather"] for series in summary["series"]] == ["rain", "fog"]
    assert [series["values"] for series in summary["series"]] == [[1.0, 25.0], [400.0, 30.0]]


def test_the_summary_s_means_are_those_of_the_table(of_camera: Written) -> None:
    out, summary = of_camera
    table = read_table(out / "scores.csv")
    rows = list(zip(*table.values(), strict=True))
    for series in summary["series"]:
        for name, metric in series["metrics"].items():
            for value, mean in zip(series["values"], metric["mean"], strict=True):
                scores = [row[8] for row in rows if row[2] == series["weather"] and row[4] == value and row[7] == name]
                assert len(scores) == 2
                assert mean == pytest.approx(sum(scores) / 2)


def test_all_scores_follow_and_the_page_says_so(of_camera: Written) -> None:
    page = page_of(of_camera)
    for series in of_camera[1]["series"]:
        assert (series["expected"], series["out_of"]) == (2, 2)
    words = page.words.replace("2 of 2 cores", "")  # the machine
    assert words.count("2 of 2") == 4  # in the overview and in each section
    assert "does not follow" not in page.words
    assert "a coin flip" in page.words  # of two levels


def test_the_page_is_whole(of_camera: Written, of_lidar: Written) -> None:
    for written, pictures in (
        (of_camera, 2 * (3 + 2)),
        (of_lidar, 4 + 2 + 6),
    ):  # clouds from above, two flat pictures, charts
        page = page_of(written)
        assert page.mistakes == []
        assert page.open == []
        images = [attrs for tag, attrs in page.elements if tag == "img"]
        assert len(images) == pictures
        assert all(str(image["src"]).startswith("data:image/") and image["alt"] for image in images)
        assert "built-in method" not in page.words
        links = [attrs["href"] for tag, attrs in page.elements if tag == "a"]
        ids = {attrs.get("id") for _, attrs in page.elements}
        for link in links:
            assert link is not None
            assert link[1:] in ids if link.startswith("#") else (written[0] / link).is_file()


def test_names_and_notes_are_escaped(of_lidar: Written) -> None:
    text = (of_lidar[0] / "index.html").read_text(encoding="utf-8")
    assert "<track>" not in text
    assert "&lt;track&gt;" in text
    assert "A &amp; B." in text


def test_a_miss_is_explained_on_the_page(of_lidar: Written) -> None:
    (series,) = of_lidar[1]["series"]
    misses = {name: metric["why"] for name, metric in series["metrics"].items() if not metric["follows"]}
    assert series["metrics"]["hd95"]["mean"] == [0.0] * 3
    assert "hd95" in misses
    page = page_of(of_lidar)
    for why in misses.values():
        assert why
        assert " ".join(why) in page.words
    follow = [metric for metric in series["metrics"].values() if metric["follows"]]
    assert all(metric["why"] == [] for metric in follow)


def test_numbers_that_are_not_finite_are_text(lidar: LidarSubject, tmp_path: Path) -> None:
    nothing = LidarSubject("empty", points=torch.zeros(5, 5), lidar=lidar.lidar)
    both = [LidarSubject("all", scene="s", points=lidar.points, lidar=lidar.lidar), nothing]
    levels = parse_levels("fog:mor=400,100")
    summary = write_sweep(tmp_path / "out", both, levels, [0], ["mde", "sdm"], sensor="lidar:x", progress=False)
    empty = summary["series"][1]
    assert empty["metrics"]["mde"]["mean"] == [0.0, 0.0]  # two empty clouds are alike
    assert empty["metrics"]["mde"]["std"] == ["nan", "nan"]  # of one seed
    assert "nan" in empty["facts_clear"].values() or "pair_distance_m" not in empty["facts_clear"]
    assert not any(isinstance(value, float) and not math.isfinite(value) for value in empty["facts"]["points"])


def test_parquet_holds_the_same_table(camera: CameraSubject, tmp_path: Path) -> None:
    pytest.importorskip("pyarrow")
    levels = parse_levels("fog:mor=400,30")
    for table in ("csv", "parquet"):
        write_sweep(tmp_path, [camera], levels, [0], ["psnr"], sensor="x", table=table, progress=False)
    assert read_table(tmp_path / "scores.csv") == read_table(tmp_path / "scores.parquet")


def test_nothing_is_left_where_a_sweep_fails(camera: CameraSubject, lidar: LidarSubject, tmp_path: Path) -> None:
    out = tmp_path / "deep" / "out"
    levels = parse_levels("fog:mor=400,30")
    with pytest.raises(TorchweatherError, match="161"):
        write_sweep(out, [camera], levels, [0], sensor="x", progress=False)
    with pytest.raises(ValueError, match="subjects of one sensor; got camera, lidar"):
        write_sweep(out, [camera, lidar], levels, [0], sensor="x", progress=False)
    with pytest.raises(ValueError, match="table"):
        write_sweep(out, [camera], levels, [0], ["psnr"], sensor="x", table="xlsx", progress=False)
    assert list(tmp_path.iterdir()) == []
