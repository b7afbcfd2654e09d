"""Whole data sets in one process: what is written, what is recorded, what is refused, how a run goes on."""

from __future__ import annotations

import errno
import json
import os
import shutil
from pathlib import Path
from typing import Any

import pytest
import torch
from torch import Tensor

import torchweather
import torchweather.datasets.augment.lidar_file as lidar_file
import torchweather.datasets.augment.work as work
from tests.datasets.augment.data_sets import (
    BOTH,
    BOXES,
    FOG,
    MANIFEST,
    cloud,
    folder,
    image,
    kitti,
    nuscenes,
    recipe,
    tree,
)
from torchweather.camera.depth import CompletedDepth
from torchweather.cli import main
from torchweather.core.errors import TorchweatherError
from torchweather.core.random import sample_seed
from torchweather.datasets.augment import Manifest, Row, Summary, augment
from torchweather.datasets.augment.frames import Frame
from torchweather.io import read_image, read_labels, read_points, write_image, write_points
from torchweather.recipes import load_recipe


def run(source: Path, target: Path, text: str = BOTH, **more: Any) -> Summary:
    return augment(source, target, recipe(source.parent, text), **{"workers": 0, **more})


def rows(target: Path) -> dict[str, Row]:
    with Manifest(target) as manifest:
        return {row.frame: row for row in manifest.rows()}


@pytest.fixture
def computed(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """Names of the frames that were worked on."""
    names: list[str] = []
    process = work.Worker.process

    def noted(self: work.Worker, frame: Frame) -> Row:
        names.append(frame.name)
        return process(self, frame)

    monkeypatch.setattr(work.Worker, "process", noted)
    return names


# ---- what is written -----------------------------------------------------------------------------------------------


def test_a_folder_keeps_its_tree_and_each_frame_has_one_weather(tmp_path: Path) -> None:
    source, target = folder(tmp_path / "clear"), tmp_path / "rainy"
    summary = run(source, target, seed=5)
    assert (summary.layout, summary.frames, summary.copies, summary.done) == ("folder", 3, 1, 4)
    assert set(tree(source)) == set(tree(target))
    assert (target / "notes.txt").read_bytes() == (source / "notes.txt").read_bytes()
    found = rows(target)
    rates = {row.weather["rate_mm_per_h"] for row in found.values() if row.weather}
    assert len(rates) == 3
    assert all(5 <= rate <= 100 for rate in rates)
    # What one gets by hand with the seed in the manifest.
    row = found["001"]
    assert row.seed == sample_seed(5, "001", 0)
    points = (
        load_recipe(recipe(tmp_path))
        .specs["points"]
        .build(torchweather.atmosphere.weather.weather_from_dict(row.weather))
    )
    clear = read_points(source / "day/clouds/001.bin").points
    seed = torchweather.core.random.derived_seed(row.seed, "points")
    expected = points(clear, points.draw(clear, seed=seed))
    assert torch.equal(read_points(target / "day/clouds/001.bin").points, expected)
    assert not torch.equal(read_image(target / "day/images/001.png")[0], image(1))


def test_the_manifest_names_what_else_was_drawn(tmp_path: Path) -> None:
    source, target = folder(tmp_path / "clear", 1), tmp_path / "foggy"
    text = FOG.replace("intensity_unit", "near_full_m: {uniform: [5.0, 30.0]}, intensity_unit")
    run(source, target, text, seed=5)
    [row] = [row for row in rows(target).values() if row.weather]
    assert row.weather is not None
    weather = dict(row.weather)
    [drawn] = weather.pop("nuisances").values()
    assert 5.0 < drawn["sensor.near_full_m"] < 30.0
    [spec] = torchweather.Compose({"points": load_recipe(recipe(tmp_path, text))}).specs.values()
    points = spec.build(torchweather.atmosphere.weather.weather_from_dict(weather), drawn)
    [file] = source.rglob("*.bin")
    clear = read_points(file).points
    seed = torchweather.core.random.derived_seed(row.seed, "points")
    expected = points(clear, points.draw(clear, seed=seed))
    assert torch.equal(read_points(target / file.relative_to(source)).points, expected)


def test_labels_of_points_say_what_the_weather_did(tmp_path: Path) -> None:
    source, target = folder(tmp_path / "clear", 1), tmp_path / "foggy"
    run(source, target, FOG)
    before, after = cloud(0)[:, :3], read_points(target / "day/clouds/000.bin").points[:, :3]
    classes = read_labels(target / "day/clouds/000.label", len(after)).classes
    lost = (after == 0).all(-1)
    kept = torch.isclose(before, after, atol=1e-3).all(-1)
    assert bool((classes[kept] == 40).all())
    assert bool((classes[lost] == 0).all())
    assert bool((classes[~lost & ~kept] == 110).all())
    assert 0 < int(kept.sum()) < len(after)


def test_a_recipe_of_one_sensor_carries_the_others_along(tmp_path: Path) -> None:
    source, target = kitti(tmp_path / "clear"), tmp_path / "foggy"
    summary = run(source, target, FOG)
    assert (summary.layout, summary.frames) == ("kitti", 2)
    before, after = tree(source), tree(target)
    assert {path for path in before if before[path] != after[path]} == {
        "training/velodyne/000000.bin",
        "training/velodyne/000001.bin",
    }


def by_hand(folder: Path, row: Row, key: str, text: str) -> Tensor:
    """Image 0 in the weather of a row, with the depth of cloud 0 and the intrinsics of the tables."""
    spec = load_recipe(recipe(folder, text)).specs["image"]
    camera = torchweather.Camera.from_intrinsics(40, 40, 19.5, 11.5, 40, 24, height_m=1.65)
    lidar_axes = [[0, -1, 0, 0], [0, 0, -1, 0], [1, 0, 0, 0], [0, 0, 0, 1]]
    depth = CompletedDepth(cloud(0), torch.tensor(lidar_axes)).scene(camera, 24, 40, image=image(0))
    transform = spec.build(torchweather.atmosphere.weather.weather_from_dict(row.weather))
    noise = transform.draw(image(0), seed=torchweather.core.random.derived_seed(row.seed, key))
    found: Tensor = transform(image(0), depth, noise)
    return found


@pytest.mark.filterwarnings("ignore:.*no sky in the frame")
def test_kitti_takes_the_depth_of_its_cloud_and_its_own_calibration(tmp_path: Path) -> None:
    source, target = kitti(tmp_path / "clear", 1), tmp_path / "rainy"
    run(source, target, seed=3)
    row = rows(target)["training/000000"]
    after = read_image(target / "training/image_2/000000.png")[0]
    assert torch.equal(after, by_hand(tmp_path, row, "image", BOTH))
    assert "image: depth completed" in row.notes
    # Another depth is another image.
    run(source, tmp_path / "near", seed=3, depth="4")
    assert not torch.equal(after, read_image(tmp_path / "near/training/image_2/000000.png")[0])


def test_kitti_boxes_are_counted_in_the_manifest_and_their_files_stay(tmp_path: Path) -> None:
    source, target = kitti(tmp_path / "clear", 1), tmp_path / "foggy"
    run(source, target, FOG)
    car, unseen = rows(target)["training/000000"].boxes or []
    assert car["points_before"] == 51
    assert 0 < car["points_left"] <= 51
    assert 0 < car["transmission"] < 1
    assert unseen == {"name": "Car", "points_before": 0, "points_left": 0, "transmission": None, "particles": 0}
    assert (target / "training/label_2/000000.txt").read_text(encoding="utf-8") == BOXES


@pytest.mark.filterwarnings("ignore:.*no sky in the frame")
def test_nuscenes_shares_a_weather_in_a_sample_and_counts_its_boxes(tmp_path: Path) -> None:
    source, target = nuscenes(tmp_path / "clear"), tmp_path / "stormy"
    heavy = BOTH.replace("{kind: rain, rate_mm_per_h: {log_uniform: [5.0, 100.0]}}", "{kind: fog, mor_m: 12.0}")
    summary = run(source, target, heavy)
    assert (summary.layout, summary.frames) == ("nuscenes", 2)
    assert set(tree(source)) == set(tree(target))
    found = rows(target)
    assert found["sample/s"].seed == found["sweeps/LIDAR_TOP/b.pcd.bin"].seed
    assert found["sample/s"].boxes is not None
    box = found["sample/s"].boxes[0]
    assert (box["token"], box["points_before"]) == ("car", 51)
    table = json.loads((target / "v1.0-mini/sample_annotation.json").read_text(encoding="utf-8"))
    assert table[0]["num_lidar_pts"] == box["points_left"] < 51
    assert table[0]["translation"] == [100, 220, -0.2]
    # The camera looks along the LiDAR's x.
    after = read_image(target / "samples/CAM_FRONT/a.png")[0]
    assert torch.equal(after, by_hand(tmp_path, found["sample/s"], "CAM_FRONT", heavy))
    assert run(source, target, heavy).to_do == 0


def test_clear_frames_stay_as_they_are(tmp_path: Path) -> None:
    source, target = folder(tmp_path / "clear", 2), tmp_path / "same"
    run(source, target, BOTH.replace("p: 1.0", "p: 0.0"))
    assert tree(source) == tree(target)


def test_clear_frames_go_through_the_mosaic_where_the_recipe_says_so(tmp_path: Path) -> None:
    source, target = folder(tmp_path / "clear", 1), tmp_path / "same"
    text = BOTH.replace("p: 1.0", "p: 0.0\nmosaic_clear: true").replace(
        "rgb: true", "rgb: true\n    through_mosaic: true"
    )
    run(source, target, text)
    after = read_image(target / "day/images/000.png")[0]
    camera = load_recipe(recipe(tmp_path, text)).specs["image"]
    rain = torchweather.AsBayer(camera.kind(torchweather.Rain(5.0), camera.sensor, depth=30.0), through_mosaic=True)
    assert torch.equal(after, rain.without_weather(image(0)))
    assert not torch.equal(after, image(0))
    assert tree(source)["day/clouds/000.bin"] == tree(target)["day/clouds/000.bin"]


def test_results_of_a_folder_may_have_another_format(tmp_path: Path) -> None:
    source, target = folder(tmp_path / "clear", 1), tmp_path / "rainy"
    run(source, target, formats={"camera": ".npy", "lidar": ".pcd"})
    assert read_image(target / "day/images/000.npy")[0].shape == (3, 24, 40)
    assert len(read_points(target / "day/clouds/000.pcd").points) == 300
    with pytest.raises(ValueError, match="layout is kitti, which has its own formats"):
        run(kitti(tmp_path / "kitti"), tmp_path / "other", formats={"lidar": ".pcd"})


# ---- going on ------------------------------------------------------------------------------------------------------


def test_what_is_done_is_not_done_again(tmp_path: Path, computed: list[str]) -> None:
    source, target = folder(tmp_path / "clear"), tmp_path / "rainy"
    run(source, target)
    before = tree(target)
    assert sorted(computed) == ["000", "001", "002", "notes.txt"]
    computed.clear()
    assert run(source, target).skipped == 4
    assert computed == []
    # Another input, a result that is missing, and one that was cut off.
    write_points(source / "day/clouds/000.bin", cloud(9))
    (target / "day/images/001.png").unlink()
    (target / "notes.txt").write_text("as", encoding="utf-8")
    run(source, target)
    assert sorted(computed) == ["000", "001", "notes.txt"]
    after = tree(target)
    assert {path for path in before if before[path] != after[path]} == {
        "day/clouds/000.bin",
        "day/clouds/000.label",
    } | {path for path in ("day/images/000.png",) if before[path] != after[path]}
    # A new date alone is no other input.
    computed.clear()
    os.utime(source / "day/clouds/002.bin", (1, 1))
    assert run(source, target).to_do == 0


def test_another_version_of_the_library_does_it_again(
    tmp_path: Path, computed: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    source, target = folder(tmp_path / "clear", 1), tmp_path / "rainy"
    run(source, target)
    computed.clear()
    monkeypatch.setattr(torchweather, "__version__", "99.0")
    run(source, target)
    assert computed == ["000", "notes.txt"]


def test_another_recipe_or_seed_in_the_same_place_is_refused(tmp_path: Path) -> None:
    source, target = folder(tmp_path / "clear", 1), tmp_path / "rainy"
    run(source, target)
    before = tree(target)
    for text, more, said in (
        (FOG, {}, "was begun with --recipe"),
        (BOTH, {"depth": "30"}, "was begun with --depth"),
        (BOTH, {"seed": 1}, "was begun with --seed '0'; got '1'"),
    ):
        with pytest.raises(ValueError, match=f"{said}.*another DST, or --restart"):
            run(source, target, text, **more)
    assert tree(target) == before
    run(source, target, seed=1, restart=True)
    run(source, tmp_path / "alone", seed=1)
    assert tree(target) == tree(tmp_path / "alone") != before


def test_leftovers_of_a_killed_run_are_cleaned_and_nothing_else(tmp_path: Path) -> None:
    source, target = folder(tmp_path / "clear", 1), tmp_path / "rainy"
    run(source, target)
    leftover = target / "day/images" / f".000.{'0123456789abcdef' * 2}.png"
    leftover.write_bytes(b"half")
    (target / work.ATTEMPTS).mkdir()
    (target / work.ATTEMPTS / "7").write_bytes(b".")
    (target / ".mine.png").write_bytes(b"a file of one's own")
    run(source, target)
    assert not leftover.exists()
    assert not (target / work.ATTEMPTS).exists()
    assert (target / ".mine.png").exists()


def test_an_interrupted_run_goes_on(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: Any) -> None:
    source, target = folder(tmp_path / "clear"), tmp_path / "rainy"
    process = work.Worker.process

    def interrupted(self: work.Worker, frame: Frame) -> Row:
        if frame.name == "001":
            raise KeyboardInterrupt
        return process(self, frame)

    command = ["augment", str(source), str(target), "--recipe", recipe(tmp_path), "--workers", "0"]
    with monkeypatch.context() as patch:
        patch.setattr(work.Worker, "process", interrupted)
        assert main(command) == 130
    assert "stopped after 1 of 4; the same command goes on from there" in capsys.readouterr().err
    assert set(rows(target)) == {"000"}
    assert main(command) == 0
    assert "1 done before, 3 done now" in capsys.readouterr().out


# ---- what goes wrong -----------------------------------------------------------------------------------------------


def test_a_broken_file_is_reported_and_the_rest_goes_on(tmp_path: Path, capsys: Any) -> None:
    source, target = folder(tmp_path / "clear"), tmp_path / "rainy"
    whole = (source / "day/clouds/001.bin").read_bytes()
    (source / "day/clouds/001.bin").write_bytes(whole[:-3])
    command = ["augment", str(source), str(target), "--recipe", recipe(tmp_path), "--workers", "0"]
    assert main([*command, "--json"]) == 1
    printed = capsys.readouterr()
    assert "broken: 001: " in printed.err
    assert json.loads(printed.out)["exit_code"] == 1
    assert list(json.loads(printed.out)["broken"]) == ["001"]
    row = rows(target)["001"]
    assert row.status == "failed"
    assert "001.bin" in str(row.error)
    assert row.outputs == {}
    # Neither the cloud nor the image that was read with it, and no temporary name.
    assert not list(target.rglob("*001*"))
    assert (target / "day/images/002.png").exists()
    # Mended, it is done by the next run, and it alone.
    (source / "day/clouds/001.bin").write_bytes(whole)
    assert main(command) == 0
    assert "3 done before, 1 done now, 0 broken" in capsys.readouterr().out


def test_a_full_disk_stops_the_run_with_nothing_half_written(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: Any
) -> None:
    source, target = folder(tmp_path / "clear"), tmp_path / "rainy"
    writer = lidar_file.write_points
    room = [1]

    def full(path: Path, points: Any) -> None:
        if not room:
            Path(path).with_name(f".{Path(path).stem}.{'ab' * 16}.bin").write_bytes(b"half")
            raise OSError(errno.ENOSPC, "No space left on device", str(path))
        room.pop()
        writer(path, points)

    command = ["augment", str(source), str(target), "--recipe", recipe(tmp_path), "--workers", "0"]
    with monkeypatch.context() as patch:
        patch.setattr(lidar_file, "write_points", full)
        assert main(command) == 3
    said = capsys.readouterr().out
    assert "1 done now" in said
    assert "stopped, the disk is full" in said
    assert "3 left to do" in said
    assert set(tree(target)) == {f"day/{name}" for name in ("images/000.png", "clouds/000.bin", "clouds/000.label")}
    assert set(rows(target)) == {"000"}
    assert main(command) == 0
    run(source, tmp_path / "unbroken")
    assert tree(target) == tree(tmp_path / "unbroken")


def test_folders_that_cannot_be_are_refused(tmp_path: Path) -> None:
    source = folder(tmp_path / "clear", 1)
    before = tree(source)
    for target, said in [(source, "same folder"), (source / "day", "lie in each other"), (tmp_path, "in each other")]:
        with pytest.raises(ValueError, match=said):
            run(source, target)
    with pytest.raises(ValueError, match="SRC must be a folder"):
        run(tmp_path / "nowhere", tmp_path / "out")
    (tmp_path / "used").mkdir()
    (tmp_path / "used/a.txt").write_text("mine", encoding="utf-8")
    with pytest.raises(ValueError, match="DST must be empty"):
        run(source, tmp_path / "used")
    (tmp_path / "empty").mkdir()
    with pytest.raises(ValueError, match="no images, no clouds"):
        run(tmp_path / "empty", tmp_path / "out")
    assert not (tmp_path / "out").exists()
    assert tree(source) == before


def test_a_recipe_for_another_sensor_is_refused(tmp_path: Path) -> None:
    (tmp_path / "clear").mkdir()
    write_points(tmp_path / "clear/a.bin", cloud(0))
    with pytest.raises(ValueError, match=r"recipe fog-30m is for a camera; .* \(found: 1 for a lidar\)"):
        augment(tmp_path / "clear", tmp_path / "out", "fog-30m", workers=0)


def test_a_path_outside_the_root_is_refused(tmp_path: Path) -> None:
    secret = tmp_path / "secret.png"
    secret.write_bytes(b"not yours")
    source = folder(tmp_path / "clear", 1)
    (source / "link.png").symlink_to(secret)
    with pytest.raises(TorchweatherError, match="lies outside"):
        run(source, tmp_path / "out")
    # In a table.
    data = nuscenes(tmp_path / "nuscenes")
    table = data / "v1.0-mini/sample_data.json"
    table.write_text(table.read_text(encoding="utf-8").replace("samples/CAM_FRONT/a.png", "../secret.png"))
    with pytest.raises(TorchweatherError, match=r"'\.\./secret.png' lies outside"):
        run(data, tmp_path / "out")
    # In a manifest.
    (source / "link.png").unlink()
    run(source, tmp_path / "out")
    with Manifest(tmp_path / "out") as manifest:
        row = next(row for row in manifest.rows() if row.frame == "notes.txt")
        manifest.record(Row(**{**vars(row), "outputs": {"../secret.png": ["", 9]}}))
    run(source, tmp_path / "out", restart=True)  # deletes what the manifest names, but nothing outside
    assert secret.read_bytes() == b"not yours"


def test_a_manifest_that_is_none_and_a_folder_in_use_are_refused(tmp_path: Path) -> None:
    source, target = folder(tmp_path / "clear", 1), tmp_path / "rainy"
    run(source, target)
    with Manifest(target), pytest.raises(TorchweatherError, match="another run is at work here"):
        run(source, target)
    (target / MANIFEST).write_text("no database, but long enough to look like one" * 50, encoding="utf-8")
    with pytest.raises(TorchweatherError, match="expected a manifest of torchweather"):
        run(source, target)


def test_files_of_one_name_cannot_be_joined_twice(tmp_path: Path) -> None:
    source = folder(tmp_path / "clear", 1)
    shutil.copytree(source / "day", source / "night")
    with pytest.raises(ValueError, match=r"both of a (camera|lidar) and named 000"):
        run(source, tmp_path / "out")


# ---- the command ---------------------------------------------------------------------------------------------------


def test_a_dry_run_counts_and_writes_nothing(tmp_path: Path, capsys: Any) -> None:
    source, target = folder(tmp_path / "clear"), tmp_path / "rainy"
    command = ["augment", str(source), str(target), "--recipe", recipe(tmp_path), "--workers", "0", "--dry-run"]
    assert main(command) == 0
    assert "3 frames, 1 files carried along; 0 done before, 4 to do" in capsys.readouterr().out
    assert not target.exists()
    run(source, target)
    assert main(command) == 0
    assert "4 done before, 0 to do" in capsys.readouterr().out


def test_warnings_stand_with_their_frame_and_one_is_shown(tmp_path: Path, capsys: Any) -> None:
    source = folder(tmp_path / "clear")
    other = FOG.replace("reflectivity}", "uint8_linear}")
    assert (
        main(["augment", str(source), str(tmp_path / "o"), "--recipe", recipe(tmp_path, other), "--workers", "0"]) == 0
    )
    assert capsys.readouterr().err.count("warning: ") == 1
    noted = [row for row in rows(tmp_path / "o").values() if row.notes]
    assert len(noted) == 3


def test_a_mistake_in_what_is_asked_has_exit_code_2(tmp_path: Path, capsys: Any) -> None:
    source = folder(tmp_path / "clear", 1)
    assert main(["augment", str(source), str(source), "--recipe", "fog-30m"]) == 2
    assert main(["augment", str(source), str(tmp_path / "o"), "--recipe", "fog-30", "--workers", "0"]) == 2
    assert "Did you mean" in capsys.readouterr().err
    assert main(["augment", str(source), str(tmp_path / "o"), "--recipe", "fog-30m", "--format", "docx"]) == 2


def test_a_disk_that_is_full_for_the_manifest_stops_the_run_too(tmp_path: Path) -> None:
    source, target = folder(tmp_path / "clear"), tmp_path / "rainy"

    for name in ("001", "002"):
        (source / f"day/clouds/{name}.bin").write_bytes(b"broken")
    with pytest.MonkeyPatch.context() as patch:
        # A row of a megabyte, where there is room for 40 pages.
        patch.setattr(work, "one_line", lambda error: "x" * 1_000_000)
        patch.setattr(Manifest, "settings", lambda self: (self._file.execute("pragma max_page_count = 40"), {})[1])
        summary = run(source, target)
    assert "No space left" in summary.stopped
    assert set(rows(target)) == {"000"}
    assert run(source, target).done == 1


def test_depth_maps_in_the_source_are_carried_along(tmp_path: Path) -> None:
    source, target = folder(tmp_path / "clear", 1), tmp_path / "foggy"
    (source / "depth").mkdir()
    write_image(source / "depth/000.npy", torch.full((1, 24, 40), 30.0))
    summary = augment(source, target, "fog-30m", workers=0, depth=str(source / "depth"))
    assert (summary.frames, summary.broken) == (1, {})
    assert tree(source)["depth/000.npy"] == tree(target)["depth/000.npy"]
    assert tree(source)["day/images/000.png"] != tree(target)["day/images/000.png"]


def test_results_of_a_file_that_has_broken_since_do_not_stay(tmp_path: Path) -> None:
    source, target = folder(tmp_path / "clear", 2), tmp_path / "rainy"
    run(source, target)
    (source / "day/clouds/001.bin").write_bytes(b"broken")
    assert list(run(source, target).broken) == ["001"]
    assert not list(target.rglob("001.*"))
    assert (target / "day/images/000.png").exists()
