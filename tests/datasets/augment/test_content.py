"""What the files and rows hold, where a mistake would show in nothing else."""

from __future__ import annotations

import shutil
from pathlib import Path

import torch

from tests.datasets.augment.data_sets import BOTH, FOG, MANIFEST, folder, kitti, nuscenes, recipe, tree
from torchweather.datasets.augment import Manifest, augment
from torchweather.io import read_image, read_points

SNOW = FOG.replace("LidarFog", "LidarSnow").replace("{kind: fog, mor_m: 40.0}", "{kind: snow, rate_mm_per_h: 3.0}")


def test_the_manifest_has_the_hash_of_every_file(tmp_path: Path) -> None:
    source, target = kitti(tmp_path / "clear", 1), tmp_path / "out"
    augment(source, target, recipe(tmp_path), workers=0)
    with Manifest(target) as manifest:
        rows = list(manifest.rows())
        text = manifest.settings()["recipe_text"]
    written = {path: sha256 for row in rows for path, (sha256, *_) in row.outputs.items()}
    read = {path: sha256 for row in rows for path, (sha256, _, _) in row.inputs.items()}
    assert written == tree(target)
    assert read == tree(source)
    assert text == BOTH
    assert not (source / MANIFEST).exists()


def test_a_sweep_has_drops_of_its_own(tmp_path: Path) -> None:
    source, target = nuscenes(tmp_path / "clear"), tmp_path / "out"
    sample, sweep = "samples/LIDAR_TOP/a.pcd.bin", "sweeps/LIDAR_TOP/b.pcd.bin"
    shutil.copyfile(source / sample, source / sweep)  # so that only the drops differ
    assert SNOW != FOG
    assert augment(source, target, recipe(tmp_path, SNOW), workers=0).layout == "nuscenes"
    first, second = read_points(target / sample).points, read_points(target / sweep).points
    assert not torch.equal(first, read_points(source / sample).points)
    assert not torch.equal(first, second)


def test_a_recipe_of_raw_frames_takes_colour_images_through_their_mosaic(tmp_path: Path) -> None:
    source = folder(tmp_path / "clear", 1)
    raw = BOTH.replace("    rgb: true\n", "")
    assert raw != BOTH
    for name, text in (("colour", BOTH), ("raw", raw)):
        assert augment(source, tmp_path / name, recipe(tmp_path, text), workers=0).broken == {}
    image = "day/images/000.png"
    found = read_image(tmp_path / "raw" / image)[0]
    assert found.shape == (3, 24, 40)
    assert torch.equal(found, read_image(tmp_path / "colour" / image)[0])
    assert not torch.equal(found, read_image(source / image)[0])
