"""What the files and rows hold, where a mistake would show in nothing else."""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import Any

import pytest
import torch

from tests.datasets.augment.data_sets import BOTH, FOG, MANIFEST, folder, kitti, nuscenes, recipe, tree
from torchweather.camera.depth import CompletedDepth, SceneDepth
from torchweather.core.errors import InputValueError
from torchweather.datasets.augment import Manifest, augment
from torchweather.io import read_image, read_points, write_image

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


def test_depth_is_found_only_for_frames_with_a_weather(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    source = kitti(tmp_path / "clear", 6)
    half = recipe(tmp_path, BOTH.replace("p: 1.0", "p: 0.5"))
    found, scene = [], CompletedDepth.scene

    def counted(self: CompletedDepth, *args: Any, **more: Any) -> SceneDepth:
        found.append(scene(self, *args, **more))
        return found[-1]

    monkeypatch.setattr(CompletedDepth, "scene", counted)
    assert augment(source, tmp_path / "out", half, workers=0, seed=3).broken == {}
    with Manifest(tmp_path / "out") as manifest:
        rows = [row for row in manifest.rows() if row.kind == "weather"]
    wet = [row for row in rows if row.weather is not None]
    assert len(found) == len(wet)
    assert 0 < len(wet) < len(rows)
    for row in rows:  # a frame that stays clear has the bytes that it came with
        same = all((tmp_path / "out" / path).read_bytes() == (source / path).read_bytes() for path in row.outputs)
        assert same == (row.weather is None)


def test_the_level_of_png_changes_bytes_and_no_pixel(tmp_path: Path) -> None:
    source, name = kitti(tmp_path / "clear", 1), "training/image_2/000000.png"
    write_image(source / name, torch.full((3, 24, 40), 90, dtype=torch.uint8))
    sizes = {}
    for level in (0, 9):
        target = tmp_path / str(level)
        augment(source, target, recipe(tmp_path), workers=0, png_level=level)
        sizes[level] = (target / name).stat().st_size
    assert sizes[9] < sizes[0]
    assert torch.equal(read_image(tmp_path / "0" / name)[0], read_image(tmp_path / "9" / name)[0])
    with pytest.raises(InputValueError, match="--png-level '0'"):
        augment(source, tmp_path / "0", recipe(tmp_path), workers=0, png_level=9)
    with pytest.raises(InputValueError, match="png_level"):
        augment(source, tmp_path / "10", recipe(tmp_path), workers=0, png_level=10)
