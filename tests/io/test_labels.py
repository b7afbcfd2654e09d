"""SemanticKITTI labels: bits, files, and the classes of points after weather."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import torch

from torchweather.core.errors import TorchweatherError
from torchweather.io.labels import FALLING_SNOW, LYING_SNOW, PointLabels, merge_kind, read_labels, write_labels
from torchweather.io.points import read_points


def labels(*classes: int) -> PointLabels:
    return PointLabels(torch.tensor(classes), torch.arange(len(classes)) + 1)


def test_class_and_instance_share_32_bits(tmp_path: Path) -> None:
    np.array([(7 << 16) | 110, 0xFFFFFFFF, 40], "<u4").tofile(tmp_path / "a.label")
    found = read_labels(tmp_path / "a.label", 3)
    assert found.classes.tolist() == [110, 65535, 40]
    assert found.instances.tolist() == [7, 65535, 0]
    write_labels(tmp_path / "b.label", found)
    assert (tmp_path / "b.label").read_bytes() == (tmp_path / "a.label").read_bytes()


def test_wrong_sizes_are_named(tmp_path: Path) -> None:
    (tmp_path / "a.label").write_bytes(bytes(10))
    with pytest.raises(TorchweatherError, match=r"a\.label: expected at least one labels.*got 10 bytes"):
        read_labels(tmp_path / "a.label")
    (tmp_path / "a.label").write_bytes(bytes(12))
    with pytest.raises(TorchweatherError, match=r"expected 4 labels.*belongs to another cloud"):
        read_labels(tmp_path / "a.label", 4)
    (tmp_path / "a.label").write_bytes(b"")
    with pytest.raises(TorchweatherError, match="got 0 bytes"):
        read_labels(tmp_path / "a.label")
    assert read_labels(tmp_path / "a.label", 0).classes.shape == (0,)
    with pytest.raises(TorchweatherError, match="cannot be read"):
        read_labels(tmp_path / "none.label")


def test_particles_and_lost_points_get_classes_of_their_own() -> None:
    merged = merge_kind(labels(40, 50, 10, 70), torch.tensor([0, 1, 2, 0], dtype=torch.int8))
    assert merged.classes.tolist() == [40, FALLING_SNOW, 0, 70]
    assert merged.instances.tolist() == [1, 0, 0, 4]
    merged = merge_kind(labels(40, 50, 10), torch.tensor([0, 1, 2]), particle_class=200, lost_class=1)
    assert merged.classes.tolist() == [40, 200, 1]


def test_dropped_and_appended_rows_follow_their_source() -> None:
    kind, source = torch.tensor([0, 1, 1, 0]), torch.tensor([2, 0, -1, -1])
    merged = merge_kind(labels(40, 50, 10), kind, source)
    assert merged.classes.tolist() == [10, 110, 110, 0]
    assert merged.instances.tolist() == [3, 0, 0, 0]
    with pytest.raises(ValueError, match="Give source"):
        merge_kind(labels(40, 50, 10), kind)
    with pytest.raises(ValueError, match=r"-1\.\.2"):
        merge_kind(labels(40, 50, 10), kind, torch.tensor([3, 0, 0, 0]))


def test_a_batch_equals_its_samples() -> None:
    classes = torch.arange(12).reshape(3, 4)
    kind = torch.tensor([[0, 1, 2, 0], [2, 2, 0, 0], [1, 0, 0, 1]])
    whole = merge_kind(PointLabels(classes, classes), kind)
    for row in range(3):
        one = merge_kind(PointLabels(classes[row], classes[row]), kind[row])
        assert torch.equal(whole.classes[row], one.classes)
        assert torch.equal(whole.instances[row], one.instances)


def test_labels_that_do_not_fit_16_bits_are_refused(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match=r"classes must lie in 0\.\.65535"):
        PointLabels(torch.tensor([70000]), torch.tensor([0]))
    with pytest.raises(TypeError, match="whole numbers"):
        PointLabels(torch.tensor([1.5]), torch.tensor([0]))
    with pytest.raises(ValueError, match="one shape"):
        PointLabels(torch.tensor([1]), torch.tensor([0, 0]))
    with pytest.raises(ValueError, match="particle_class"):
        merge_kind(labels(1), torch.tensor([0]), particle_class=-1)
    with pytest.raises(ValueError, match="one cloud"):
        write_labels(tmp_path / "a.label", PointLabels(torch.zeros(2, 3).long(), torch.zeros(2, 3).long()))


@pytest.mark.real_data
@pytest.mark.parametrize("frame", ["042223", "042224", "042250"])
def test_real_snow_is_labelled_and_written_back(real_data: Callable[[str], Path], tmp_path: Path, frame: str) -> None:
    cloud = read_points(real_data(f"wads_snow/velodyne/{frame}.bin"))
    source = real_data(f"wads_snow/labels/{frame}.label")
    found = read_labels(source, len(cloud.points))
    # SOURCE of the frames: 9.7 to 10.8 thousand points of falling snow, 85 thousand of lying snow.
    assert 9_600 < int((found.classes == FALLING_SNOW).sum()) < 10_900
    assert 80_000 < int((found.classes == LYING_SNOW).sum()) < 90_000
    write_labels(tmp_path / "b.label", found)
    assert (tmp_path / "b.label").read_bytes() == source.read_bytes()
