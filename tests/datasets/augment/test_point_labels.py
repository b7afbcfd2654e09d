"""Labels of points follow the points: SemanticKITTI with instances, nuScenes' lidarseg and panoptic, columns."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
import torch

from tests.datasets.augment.data_sets import FOG, cloud, nuscenes, recipe
from torchweather.cli import main
from torchweather.datasets.augment import Manifest, augment
from torchweather.io import PointLabels, read_labels, read_points, write_labels, write_points

THICK = FOG.replace("mor_m: 100.0", "mor_m: 30.0")


def notes(target: Path) -> dict[str, str]:
    with Manifest(target) as manifest:
        return {row.frame: " ".join(row.notes) for row in manifest.rows()}


def kinds(before: torch.Tensor, after: torch.Tensor) -> torch.Tensor:
    """0 an object, 1 a particle, 2 lost, by the positions alone."""
    lost = (after[:, :3] == 0).all(dim=1)
    same = (before[:, :3] == after[:, :3]).all(dim=1)
    return torch.where(lost, 2, torch.where(same, 0, 1))


@pytest.mark.parametrize("tables", [True, False])
def test_nuscenes_labels_are_written_anew(tmp_path: Path, tables: bool) -> None:
    source, target = nuscenes(tmp_path / "clear"), tmp_path / "out"
    token = "samples/LIDAR_TOP/a.pcd.bin"
    if not tables:  # the files' names hold the token
        text = (source / "v1.0-mini/sample_data.json").read_text().replace(f'"token": "{token}"', '"token": "tok"')
        (source / "v1.0-mini/sample_data.json").write_text(text)
    seg, pan = "lidarseg/v1.0-mini/tok_lidarseg.bin", "panoptic/v1.0-mini/tok_panoptic.npz"
    for path in (seg, pan):
        (source / path).parent.mkdir(parents=True)
    classes = torch.arange(300) % 15 + 17
    write_labels(source / seg, PointLabels(classes, torch.zeros_like(classes)))
    write_labels(source / pan, PointLabels(classes, torch.arange(300)))
    assert (source / seg).stat().st_size == 300
    assert np.load(source / pan)["data"].dtype == np.uint16
    for name, path in (("lidarseg", seg), ("panoptic", pan)) if tables else ():
        row = [{"token": "t", "sample_data_token": token, "filename": path}]
        (source / f"v1.0-mini/{name}.json").write_text(json.dumps(row))
    assert not augment(source, target, recipe(tmp_path, THICK), workers=0).broken
    before, after = (read_points(root / token).points for root in (source, target))
    kind = kinds(before, after)
    assert {0, 1} <= set(kind.tolist())
    wanted = torch.where(kind == 0, classes, 0)
    assert read_labels(target / seg, 300).classes.tolist() == wanted.tolist()
    panoptic = read_labels(target / pan, 300)
    assert panoptic.classes.tolist() == wanted.tolist()
    assert panoptic.instances.tolist() == torch.where(kind == 0, torch.arange(300), 0).tolist()
    said = notes(target)["sample/s"]
    assert "labels *_lidarseg.bin: particles are class 0 (noise)" in said
    assert "labels *_panoptic.npz: particles are class 0 (noise)" in said


def test_labels_of_another_number_of_points_break_the_frame(tmp_path: Path) -> None:
    source = nuscenes(tmp_path / "clear")
    seg = source / "lidarseg/v1.0-mini/samples/LIDAR_TOP/a.pcd.bin_lidarseg.bin"
    seg.parent.mkdir(parents=True)
    seg.write_bytes(bytes(299))
    summary = augment(source, tmp_path / "out", recipe(tmp_path, THICK), workers=0)
    assert "expected 300 labels of 1 byte (class); got 299 bytes" in summary.broken["sample/s"]


def test_instances_of_particles_go_and_the_class_is_in_the_manifest(tmp_path: Path) -> None:
    (tmp_path / "src/velodyne").mkdir(parents=True)
    (tmp_path / "src/labels").mkdir()
    write_points(tmp_path / "src/velodyne/0.bin", cloud(0))
    instances = torch.arange(300) + 1
    write_labels(tmp_path / "src/labels/0.label", PointLabels(torch.full((300,), 10), instances))
    augment(tmp_path / "src", tmp_path / "out", recipe(tmp_path, THICK), workers=0, layout="folder")
    kind = kinds(cloud(0), read_points(tmp_path / "out/velodyne/0.bin").points)
    found = read_labels(tmp_path / "out/labels/0.label", 300)
    assert found.classes.tolist() == torch.where(kind == 0, 10, torch.where(kind == 1, 110, 0)).tolist()
    assert found.instances.tolist() == torch.where(kind == 0, instances, 0).tolist()
    said = notes(tmp_path / "out")["velodyne/0.bin"]
    assert "labels *.label: particles are class 110 (falling snow), lost points class 0" in said


@pytest.mark.parametrize("command", ["augment", "apply"])
def test_columns_that_label_points_follow_too(tmp_path: Path, command: str) -> None:
    (tmp_path / "src").mkdir()
    points = torch.cat([cloud(0), torch.full((300, 1), 10.0), torch.arange(300)[:, None] + 1.0, torch.ones(300, 1)], 1)
    names = ("x", "y", "z", "intensity", "label", "instance_id", "ring")
    write_points(tmp_path / "src/a.pcd", points, columns=names)
    if command == "augment":
        augment(tmp_path / "src", tmp_path / "out", recipe(tmp_path, THICK), workers=0)
        assert "labels of particles: column label 110, column instance_id 0" in notes(tmp_path / "out")["a.pcd"]
    else:
        asked = ("--sensor", "lidar:velodyne-hdl-64e", "--intensity-unit", "reflectivity", "--lost", "zero")
        assert (
            main(["apply", str(tmp_path / "src/a.pcd"), *asked, "--weather", "fog:mor=30", "-o", str(tmp_path / "out")])
            == 0
        )
    found = read_points(tmp_path / "out/a.pcd")
    kind = kinds(points, found.points)
    assert {0, 1} <= set(kind.tolist())
    assert found.column("label").tolist() == torch.where(kind == 0, 10, torch.where(kind == 1, 110, 0)).tolist()
    assert found.column("instance_id").tolist() == torch.where(kind == 0, torch.arange(300) + 1, 0).tolist()
    assert found.column("ring").tolist() == [1] * 300


def test_labels_that_a_format_cannot_hold_are_refused(tmp_path: Path) -> None:
    labels = PointLabels(torch.tensor([300]), torch.tensor([0]))
    with pytest.raises(Exception, match="holds a value of class of at most 255; got 300"):
        write_labels(tmp_path / "a_lidarseg.bin", labels)
    with pytest.raises(Exception, match="holds a value of class of at most 65; got 300"):
        write_labels(tmp_path / "a_panoptic.npz", labels)
    with pytest.raises(Exception, match="holds a value of instance of at most 0; got 7"):
        write_labels(tmp_path / "a_lidarseg.bin", PointLabels(torch.tensor([3]), torch.tensor([7])))
    np.savez(tmp_path / "b_panoptic.npz", other=np.zeros(3))
    with pytest.raises(Exception, match="expected 3 whole numbers in data"):
        read_labels(tmp_path / "b_panoptic.npz", 3)
