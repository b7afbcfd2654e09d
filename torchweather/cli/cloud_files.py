"""Where the clouds of ``torchweather apply`` go: names beside each other, nothing overwritten but older results."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor

from torchweather.cli.clouds import PCAP, CloudFrame, stem
from torchweather.cli.result_files import ResultFiles
from torchweather.core.errors import TorchweatherError
from torchweather.core.exceptions import InputValueError
from torchweather.io import PointCloud, PointLabels, atomic_write, merge_kind, read_labels, write_labels, write_points
from torchweather.lidar.transform import LidarResult

__all__ = ["CloudFiles"]

# A recording cannot be written back; this format keeps rings and columns, and any viewer reads it.
OF_RECORDINGS = ".pcd"


class CloudFiles(ResultFiles):
    """Names and writes what comes of each cloud.

    Args:
        inputs: files to be read, none of which may be overwritten.
        out: folder of the results.
        labels: ``label``, ``npz`` or ``None``.
        labels_in: folder of the labels of the inputs.
    """

    def __init__(self, inputs: list[Path], out: Path, *, labels: str | None, labels_in: Path | None) -> None:
        super().__init__(inputs, out)
        self.labels, self.labels_in = labels, labels_in
        # What can be known before the first cloud is read is refused then.
        seen: dict[tuple[str, str], Path] = {}
        for path in inputs:
            name = stem(path)
            if name in seen:
                raise InputValueError(f"apply: {seen[name]} and {path} would both be written to {out / path.name}.")
            seen[name] = path
            if path.suffix.lower() != PCAP:
                self.free(out / path.name, str(path), keep=False)

    def write(
        self, frame: CloudFrame, first: PointCloud, second: PointCloud | None, result: LidarResult
    ) -> dict[str, str]:
        """Write a cloud, its second returns and its labels; their names."""
        name, suffix = stem(frame.path)
        if frame.number is not None:
            name, suffix = f"{name}_{frame.number:04d}", OF_RECORDINGS
        targets = {"output": self.out / f"{name}{suffix}"}
        if second is not None:
            targets["second"] = self.out / f"{name}_second{suffix}"
        if self.labels == "npz":
            targets["labels"] = self.out / f"{name}_labels.npz"
        elif self.labels == "label":
            targets["labels"] = self.out / f"{name}.label"
            if second is not None:
                targets["second_labels"] = self.out / f"{name}_second.label"
        for target in targets.values():
            self.free(target, frame.name, keep=True)
        self.out.mkdir(parents=True, exist_ok=True)
        # The cloud last: where it stands, its company stands too.
        if self.labels == "npz":
            with atomic_write(targets["labels"]) as unfinished:
                np.savez_compressed(unfinished, **dict(_truth(result)))
        elif self.labels == "label":
            before = self._labels_of(frame)
            write_labels(targets["labels"], merge_kind(before, _tensor(result.kind), _tensor(result.source)))
            if second is not None:
                # A beam without a second return has no source there; nothing else makes it -1.
                merged = merge_kind(before, _tensor(result.second_kind), _tensor(result.second_source))
                write_labels(targets["second_labels"], merged)
        if second is not None:
            write_points(targets["second"], second)
        write_points(targets["output"], first)
        return {key: str(target) for key, target in targets.items()}

    def _labels_of(self, frame: CloudFrame) -> PointLabels:
        rows = len(frame.cloud.points)
        if self.labels_in is None:
            none = torch.zeros(rows, dtype=torch.int64)
            return PointLabels(none, none)
        if frame.number is not None:
            raise TorchweatherError(f"{frame.name}: --labels-in goes with files of one cloud each.")
        name = f"{stem(frame.path)[0]}.label"
        if (self.labels_in / name).resolve() == (self.out / name).resolve():
            raise InputValueError(f"apply: {self.labels_in / name} would be overwritten; give another folder to --out.")
        return read_labels(self.labels_in / name, rows)


def _truth(result: LidarResult) -> Iterator[tuple[str, Any]]:
    for name in ("kind", "source", "transmission", "second_kind", "second_source"):
        values = getattr(result, name)
        if values is not None:
            yield name, _tensor(values).numpy()


def _tensor(values: Any) -> Tensor:
    assert isinstance(values, Tensor)
    return values
