"""``augment`` with a mask of the own vehicle over each drive: the same for any number of workers, and on resuming."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
import torch

from tests.lidar.sweep.own_car_drive import SENSOR, hidden, mirror, sweep
from torchweather.atmosphere.weather import Fog
from torchweather.datasets.augment import augment
from torchweather.datasets.augment.manifest import NAME, Manifest, Row
from torchweather.io import read_points, write_points
from torchweather.lidar import own_vehicle_mask
from torchweather.recipes import save_recipe
from torchweather.transforms import LidarFog

PLACES = (0.0, 0.9, 1.7, 2.8, 4.1)


@pytest.fixture
def source(tmp_path: Path) -> Path:
    """A drive of five sweeps, and another one of two."""
    root = tmp_path / "source"
    for folder, places in (("drive", PLACES), ("short", PLACES[:2])):
        (root / folder).mkdir(parents=True)
        for number, place in enumerate(places):
            write_points(root / folder / f"{number:06d}.bin", sweep(place)[0])
    return root


@pytest.fixture
def recipe(tmp_path: Path) -> str:
    path = tmp_path / "fog.yaml"
    save_recipe(LidarFog(Fog(mor_m=5.0), SENSOR, complete_scan=True), path, title="thick fog")
    return str(path)


def results(target: Path) -> dict[str, bytes]:
    files = (path for path in target.rglob("*.bin"))
    return {path.relative_to(target).as_posix(): path.read_bytes() for path in files}


def manifest(target: Path) -> tuple[dict[str, str], dict[str, Row]]:
    with Manifest(target) as found:
        return found.settings(), {row.frame: row for row in found.rows()}


def test_a_drive_gets_a_mask_for_any_number_of_workers(source: Path, recipe: str, tmp_path: Path) -> None:
    for workers in (0, 1):  # two of them: test_killed.py
        summary = augment(source, tmp_path / f"out{workers}", recipe, workers=workers)
        assert not summary.broken
    assert results(tmp_path / "out0") == results(tmp_path / "out1")
    settings, rows = manifest(tmp_path / "out0")
    kept = json.loads(settings["own_vehicle_masks"])
    assert list(kept) == ["drive/"]  # two sweeps are too few
    assert kept["drive/"]["beams"] == int(hidden().sum() + mirror().sum() * 14 // 12)
    assert kept["drive/"]["sweeps"] == 5
    for name, row in rows.items():
        said = [text for text in row.notes if "own vehicle from 5 sweeps" in text]
        assert len(said) == (1 if name.startswith("drive/") else 0), name
    cloud, returned = sweep(PLACES[3])
    own = torch.from_numpy(mirror()[returned])
    out = read_points(tmp_path / "out0/drive/000003.bin").points
    assert torch.equal(out[: len(cloud)][own], cloud[own])


def test_a_run_goes_on_with_the_mask_that_it_began_with(source: Path, recipe: str, tmp_path: Path) -> None:
    target = tmp_path / "out"
    augment(source, target, recipe, workers=0)
    before, masks = results(target), manifest(target)[0]["own_vehicle_masks"]
    (target / "drive/000001.bin").unlink()
    for number in range(5, 9):  # in which the car hides nothing
        write_points(source / f"drive/{number:06d}.bin", sweep(number, car=False)[0])
    summary = augment(source, target, recipe, workers=0)
    assert summary.done == 5
    after, (settings, _) = results(target), manifest(target)
    assert settings["own_vehicle_masks"] == masks
    assert {name: after[name] for name in before} == before
    with pytest.raises(ValueError, match="was begun with --own-vehicle ''; got 'none'"):
        augment(source, target, recipe, workers=0, own_vehicle="none")


def test_a_file_and_none_are_taken(source: Path, recipe: str, tmp_path: Path) -> None:
    own_vehicle_mask([sweep(place)[0] for place in PLACES], SENSOR).save(tmp_path / "car.npz")
    for name, drives in ((str(tmp_path / "car.npz"), ["drive/", "short/"]), ("none", []), ("drive", ["drive/"])):
        target = tmp_path / f"out {Path(name).stem}"
        augment(source, target, recipe, workers=0, own_vehicle=name)
        assert list(json.loads(manifest(target)[0]["own_vehicle_masks"])) == drives
    with pytest.raises(ValueError, match="--own-vehicle drive: own_vehicle_mask: expected 5 or more sweeps"):
        augment(source / "short", tmp_path / "too few", recipe, workers=0, own_vehicle="drive")
    assert not results(tmp_path / "too few")


def test_a_broken_sweep_is_no_part_of_the_mask(source: Path, recipe: str, tmp_path: Path) -> None:
    write_points(source / "drive/000005.bin", sweep(5.0)[0])
    (source / "drive/000002.bin").write_bytes(b"no cloud")
    summary = augment(source, tmp_path / "out", recipe, workers=0)
    assert list(summary.broken) == ["drive/000002.bin"]
    assert json.loads(manifest(tmp_path / "out")[0]["own_vehicle_masks"])["drive/"]["sweeps"] == 5
    assert (tmp_path / "out" / NAME).exists()
