"""``torchweather apply --own-vehicle``: a mask of the car over the sweeps of a drive."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from tests.lidar.sweep.own_car_drive import SENSOR, hidden, mirror, sweep
from tests.recordings import recording
from torchweather.atmosphere.weather import Fog
from torchweather.cli import main
from torchweather.io import read_points, write_points
from torchweather.lidar import own_vehicle_mask
from torchweather.lidar.sweep.drive_sweeps import MOST_SWEEPS, evenly_chosen
from torchweather.recipes import save_recipe
from torchweather.transforms import LidarFog

PLACES = (0.0, 0.9, 1.7, 2.8, 4.1)


@pytest.fixture
def drive(tmp_path: Path) -> Path:
    folder = tmp_path / "drive"
    folder.mkdir()
    for number, place in enumerate(PLACES):
        write_points(folder / f"{number:06d}.bin", sweep(place)[0])
    return folder


@pytest.fixture
def recipe(tmp_path: Path) -> Path:
    path = tmp_path / "fog.yaml"
    save_recipe(LidarFog(Fog(mor_m=5.0), SENSOR, complete_scan=True), path, title="thick fog")
    return path


@pytest.fixture
def apply(capsys: pytest.CaptureFixture[str], tmp_path: Path, recipe: Path) -> Any:
    def call(*argv: object) -> list[dict[str, Any]]:
        call.out = tmp_path / f"out{len(list(tmp_path.iterdir()))}"  # type: ignore[attr-defined]
        arguments = ["apply", *argv, "--recipe", recipe, "--json", "-o", call.out]  # type: ignore[attr-defined]
        assert main([str(one) for one in arguments]) == 0
        found: list[dict[str, Any]] = json.loads(capsys.readouterr().out)["files"]
        return found

    return call


def test_a_folder_of_five_sweeps_gives_a_mask_that_the_manifest_counts(apply: Any, drive: Path) -> None:
    entries = apply(drive)
    wide = int(mirror().sum()) * 14 // 12  # the cells on both sides of the mirror's twelve see it too
    for place, entry in zip(PLACES, entries, strict=True):
        assert entry["own_vehicle"] == {"beams": int(hidden().sum()) + wide, "sweeps": 5, "views": 5.0}
        assert "own vehicle from 5 sweeps" in entry["scan"]
        cloud, returned = sweep(place)
        own = torch.from_numpy(mirror()[returned])
        assert entry["own_vehicle_points"] == int(own.sum())
        out = read_points(Path(entry["output"])).points
        same = {tuple(row) for row in out.tolist()}
        assert all(tuple(row) in same for row in cloud[own].tolist())


def test_the_order_of_the_files_does_not_matter(apply: Any, drive: Path) -> None:
    files = sorted(drive.iterdir())
    forward, backward = apply(*files), apply(*reversed(files))
    for entry, other in zip(forward, reversed(backward), strict=True):
        assert entry["input"] == other["input"]
        for key in ("own_vehicle", "beam_ends", "own_vehicle_points", "scan"):
            assert entry[key] == other[key]


def test_few_sweeps_a_standing_car_and_none_leave_each_sweep_to_itself(apply: Any, drive: Path) -> None:
    plain = apply(*sorted(drive.iterdir())[:2])
    assert all("own_vehicle" not in entry and "own_vehicle_points" not in entry for entry in plain)
    assert all("own_vehicle" not in entry for entry in apply(drive, "--own-vehicle", "none"))
    for file in drive.iterdir():
        write_points(file, sweep(0.0, seed=int(file.stem))[0])
    assert all("own_vehicle" not in entry for entry in apply(drive))


def test_a_mask_file_is_taken_for_any_number_of_sweeps(apply: Any, drive: Path, tmp_path: Path) -> None:
    mask = own_vehicle_mask([sweep(place)[0] for place in PLACES], SENSOR)
    mask.save(tmp_path / "car.npz")
    (entry,) = apply(drive / "000003.bin", "--own-vehicle", tmp_path / "car.npz")
    assert entry["own_vehicle"]["beams"] == mask.beams
    over_all = apply(drive)[3]
    assert (entry["beam_ends"], entry["scan"]) == (over_all["beam_ends"], over_all["scan"])


@pytest.mark.parametrize(
    ("argument", "said"),
    [
        ("drive", "expected 5 or more sweeps that differ"),
        ("{tmp}/no.npz", "no.npz"),
        ("{tmp}/fog.yaml", "expected a mask"),
    ],
)
def test_a_mask_that_cannot_be_had_is_an_error(
    argument: str, said: str, drive: Path, recipe: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    argv = ["apply", drive / "000000.bin", "--recipe", recipe, "-o", tmp_path / "out"]
    assert main([str(one) for one in (*argv, "--own-vehicle", argument.format(tmp=tmp_path))]) == 2
    assert said in capsys.readouterr().err
    assert not (tmp_path / "out").exists() or not list((tmp_path / "out").iterdir())


def test_no_more_than_50_sweeps_are_taken_evenly() -> None:
    files = [Path(f"{number:04d}.bin") for number in range(1234)]
    chosen = evenly_chosen(files)
    assert (len(chosen), chosen[0], chosen[-1]) == (MOST_SWEEPS, files[0], files[-1])
    steps = np.diff([int(path.stem) for path in chosen])
    assert steps.min() >= 25
    assert steps.max() <= 26
    assert evenly_chosen(files[::-1]) == chosen


@pytest.mark.long  # beside a folder of made sweeps
@pytest.mark.real_data
def test_kittis_sweeps_get_one_mask(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder = recording("kitti_13/velodyne")
    argv = ["apply", folder, "--sensor", "lidar:velodyne-hdl-64e", "--intensity-unit", "reflectivity"]
    argv += ["--weather", "snow:rate=1", "--complete-scan", "--json", "-o", tmp_path / "out"]
    assert main([str(one) for one in argv]) == 0
    entries = json.loads(capsys.readouterr().out)["files"]
    assert {entry["own_vehicle"]["sweeps"] for entry in entries} == {13}
    own = [entry["beam_ends"]["own_vehicle"] for entry in entries]
    assert np.std(own) < 200
    assert all(entry["own_vehicle_points"] < 35 for entry in entries)
