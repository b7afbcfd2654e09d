"""Label files of SemanticKITTI, WADS and nuScenes: class and instance of every point, and what weather does to them."""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from torchweather.core.arguments import check_arguments
from torchweather.core.atomic import atomic_write
from torchweather.core.errors import InputTypeError, InputValueError, TorchweatherError, check_between
from torchweather.io.arrays import read_archive
from torchweather.pipeline.point_kind import PointKind

__all__ = [
    "FALLING_SNOW",
    "LABEL_FORMATS",
    "LYING_SNOW",
    "UNLABELLED",
    "LabelFormat",
    "PointLabels",
    "label_format",
    "merge_kind",
    "read_labels",
    "write_labels",
]

# Class 0 of SemanticKITTI is "unlabeled"; WADS adds two (SOURCE of the data set: CRFOR, sequences/36).
UNLABELLED = 0
FALLING_SNOW = 110
LYING_SNOW = 111
_HIGHEST = 0xFFFF
_PANOPTIC = 1000  # nuScenes: 1000 times the class plus the instance


@dataclass(frozen=True, eq=False)
class PointLabels:
    """Labels of N points.

    Args:
        classes: ``(..., N)`` int64, 0..65535.
        instances: ``(..., N)`` int64, 0..65535; 0 is none.
    """

    classes: Tensor
    instances: Tensor

    def __post_init__(self) -> None:
        check_arguments("PointLabels(classes: Tensor, instances: Tensor)", self.classes, self.instances)
        if self.classes.shape != self.instances.shape or not self.classes.ndim:
            raise InputValueError(
                "PointLabels: classes and instances must have one shape (..., N); got "
                f"{tuple(self.classes.shape)} and {tuple(self.instances.shape)}."
            )
        for name, values in (("classes", self.classes), ("instances", self.instances)):
            if values.is_floating_point() or values.is_complex() or values.dtype == torch.bool:
                raise InputTypeError(f"PointLabels: {name} must be whole numbers; got {values.dtype}.")
            check_between(name, values.long(), 0, _HIGHEST, owner=self) if values.numel() else None


@dataclass(frozen=True)
class LabelFormat:
    """A kind of label files.

    Args:
        ending: of their names.
        particle_class: of a point that is a drop, a flake or fog.
        particle_name: of that class.
        item_bytes: of one label; 0 in an archive.
        highest_class: that a file can hold.
    """

    ending: str
    particle_class: int
    particle_name: str
    item_bytes: int
    highest_class: int

    @property
    def words(self) -> str:
        """Classes of what the weather made, for a record."""
        return f"particles are class {self.particle_class} ({self.particle_name}), lost points class {UNLABELLED}"


# nuScenes' class 0, noise, is "any return that does not correspond to a physical object, such as dust, vapor, noise,
# fog, raindrops, smoke and reflections".
LABEL_FORMATS = (
    LabelFormat("_lidarseg.bin", 0, "noise", 1, 0xFF),
    LabelFormat("_panoptic.npz", 0, "noise", 0, 0xFFFF // _PANOPTIC),
    LabelFormat(".label", FALLING_SNOW, "falling snow", 4, _HIGHEST),
)


def label_format(path: str | os.PathLike[str]) -> LabelFormat:
    """The format of a label file, by the ending of its name; SemanticKITTI's where it has none of those."""
    check_arguments("label_format(path: path)", path)
    name = Path(path).name.lower()
    return next((one for one in LABEL_FORMATS if name.endswith(one.ending)), LABEL_FORMATS[-1])


def read_labels(path: str | os.PathLike[str], n_points: int | None = None) -> PointLabels:
    """The labels of a cloud.

    ===================  ========================================================================================
    name                 content
    ===================  ========================================================================================
    ``*.label``          SemanticKITTI, WADS: uint32 for each point, class in the lower 16 bits, instance above
    ``*_lidarseg.bin``   nuScenes: uint8 for each point, the class
    ``*_panoptic.npz``   nuScenes: uint16 ``data`` for each point, 1000 times the class plus the instance
    ===================  ========================================================================================

    Args:
        path: a file of one of these names; any other name is taken for SemanticKITTI's.
        n_points: rows of the cloud that they belong to; checked.

    Raises:
        TorchweatherError: the file is missing, truncated, or has another number of labels. An empty file is refused
            unless ``n_points`` is 0.
    """
    check_arguments("read_labels(path: path, n_points: int | None)", path, n_points)
    source, kind = Path(path), label_format(path)
    if not kind.item_bytes:
        return _read_panoptic(source, n_points)
    dtype = np.dtype(f"<u{kind.item_bytes}")
    try:
        size = source.stat().st_size
        packed = np.fromfile(source, dtype) if size % dtype.itemsize == 0 else np.zeros(0, dtype)
    except OSError as error:
        raise TorchweatherError(f"{source}: cannot be read ({error}).") from error
    wrong = size % dtype.itemsize or (n_points is not None and n_points * dtype.itemsize != size)
    if wrong or (n_points is None and not size):
        wanted = "at least one" if n_points is None else str(n_points)
        what = "4 bytes (class and instance, 16 bits each)" if dtype.itemsize == 4 else "1 byte (class)"
        raise TorchweatherError(
            f"{source}: expected {wanted} labels of {what}; got {size} bytes. The file is truncated or belongs to "
            "another cloud."
        )
    labels = torch.from_numpy(packed.astype(np.int64))
    return PointLabels(labels & _HIGHEST, labels >> 16)


def write_labels(path: str | os.PathLike[str], labels: PointLabels) -> None:
    """Write the labels of one cloud, ``(N,)``, in the format of the name; the inverse of `read_labels`.

    Raises:
        ValueError: labels of a batch.
        TorchweatherError: a class or an instance that the format cannot hold.
    """
    check_arguments("write_labels(path: path, labels: PointLabels)", path, labels)
    if labels.classes.ndim != 1:
        raise InputValueError(
            f"write_labels: labels must be of one cloud, shape (N,); got {tuple(labels.classes.shape)}. Write each "
            "sample of a batch to its own file."
        )
    kind = label_format(path)
    classes, instances = labels.classes.long().cpu(), labels.instances.long().cpu()
    instance_limit = {1: 0, 0: _PANOPTIC - 1}.get(kind.item_bytes, _HIGHEST)
    for name, values, limit in (("class", classes, kind.highest_class), ("instance", instances, instance_limit)):
        if values.numel() and int(values.max()) > limit:
            raise TorchweatherError(
                f"{path}: *{kind.ending} holds a value of {name} of at most {limit}; got {int(values.max())}."
            )
    with atomic_write(path) as unfinished:
        if not kind.item_bytes:
            np.savez_compressed(unfinished, data=(classes * _PANOPTIC + instances).numpy().astype(np.uint16))
        else:
            (classes | (instances << 16)).numpy().astype(f"<u{kind.item_bytes}").tofile(unfinished)


def _read_panoptic(source: Path, n_points: int | None) -> PointLabels:
    arrays, _ = read_archive(source)
    data = arrays.get("data")
    if data is None or data.ndim != 1 or data.dtype.kind not in "iu" or n_points not in (None, len(data)):
        got = "no array data" if data is None else f"data {data.dtype} {data.shape}"
        wanted = "one whole number" if n_points is None else f"{n_points} whole numbers"
        raise TorchweatherError(
            f"{source}: expected {wanted} in data, (N,), 1000 times the class plus the instance; got {got}. The file "
            "is damaged or belongs to another cloud."
        )
    labels = torch.from_numpy(data.astype(np.int64))
    return PointLabels(labels // _PANOPTIC, labels % _PANOPTIC)


def merge_kind(
    labels: PointLabels,
    kind: Tensor,
    source: Tensor | None = None,
    *,
    particle_class: int = FALLING_SNOW,
    lost_class: int = UNLABELLED,
) -> PointLabels:
    """Labels after weather: particles and lost points get classes of their own, without instance.

    Args:
        labels: of the cloud that went in, ``(..., N)``.
        kind: ``(..., K)`` `PointKind` of each point that came out.
        source: ``(..., K)`` row of the input of each point, -1 for a beam that had none; ``None`` where row i is row i
            (K = N).
        particle_class: class of a point that is a drop, a flake or fog.
        lost_class: class of a beam without a return.

    Returns:
        ``(..., K)`` labels.

    Example:
        >>> before = PointLabels(torch.tensor([40, 50, 10]), torch.tensor([0, 0, 7]))
        >>> merge_kind(before, torch.tensor([0, 1, 2])).classes
        tensor([ 40, 110,   0])
    """
    check_arguments(
        "merge_kind(labels: PointLabels, kind: real, source: real | None, particle_class: int, lost_class: int)",
        labels,
        kind,
        source,
        particle_class,
        lost_class,
    )
    for name, value in (("particle_class", particle_class), ("lost_class", lost_class)):
        check_between(name, value, 0, _HIGHEST, owner="merge_kind")
    rows = labels.classes.shape[-1]
    shape = kind.shape if source is None else source.shape
    if kind.shape != shape or (source is None and kind.shape != labels.classes.shape):
        raise InputValueError(
            f"merge_kind: kind must have the shape of {'labels' if source is None else 'source'}, "
            f"{tuple(labels.classes.shape if source is None else shape)}; got {tuple(kind.shape)}."
            f"{' Give source, where points were dropped or appended.' if source is None else ''}"
        )
    if source is not None and source.shape[:-1] != labels.classes.shape[:-1]:
        raise InputValueError(
            f"merge_kind: source must have the batch of labels, {tuple(labels.classes.shape[:-1])}; got "
            f"{tuple(source.shape)}."
        )
    classes, instances = labels.classes, labels.instances
    none = torch.zeros_like(kind, dtype=torch.bool)
    if source is not None:
        index = source.to(device=classes.device, dtype=torch.long)
        none = index < 0
        if index.numel() and (int(index.min()) < -1 or int(index.max()) >= rows):
            raise InputValueError(f"merge_kind: source must lie in -1..{rows - 1}.")
        if rows:
            classes = classes.gather(-1, index.clamp_min(0))
            instances = instances.gather(-1, index.clamp_min(0))
        else:
            classes = instances = torch.zeros_like(index)
    device = classes.device
    particle = kind.to(device) == int(PointKind.PARTICLE)
    lost = (kind.to(device) == int(PointKind.LOST)) | (none.to(device) & ~particle)
    new = torch.where(particle, torch.full_like(classes, particle_class), classes)
    new = torch.where(lost, torch.full_like(classes, lost_class), new)
    return PointLabels(new, torch.where(particle | lost, torch.zeros_like(instances), instances))
