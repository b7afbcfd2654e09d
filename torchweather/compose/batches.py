"""Clouds of different length as one batch: as a list, padded with a mask, or with a leading batch index column."""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import Tensor

from torchweather.core.arguments import check_arguments
from torchweather.core.errors import InputTypeError, InputValueError, check_between
from torchweather.io.point_cloud import PointCloud

__all__ = ["collate_indexed", "collate_list", "collate_padded", "join_indexed", "split_indexed", "split_padded"]


def collate_list(clouds: Sequence[PointCloud | Tensor]) -> list[Tensor]:
    """The points of each cloud, ``(N_i, C)``, as a list; a ``collate_fn`` for a ``DataLoader``."""
    check_arguments("collate_list(clouds: Sequence[real] | Sequence[PointCloud])", clouds)
    points = [cloud.points if isinstance(cloud, PointCloud) else cloud for cloud in clouds]
    if not points or any(cloud.ndim != 2 or cloud.shape[1] != points[0].shape[1] for cloud in points):
        shapes = ", ".join(str(tuple(cloud.shape)) for cloud in points) or "none"
        raise InputValueError(f"collate: clouds must be (N, C) with one C, at least one of them; got {shapes}.")
    if len({(cloud.dtype, cloud.device) for cloud in points}) > 1:
        kinds = ", ".join(f"{cloud.dtype} on {cloud.device}" for cloud in points)
        raise InputValueError(f"collate: clouds must have one dtype and device; got {kinds}.")
    return points


def collate_padded(clouds: Sequence[PointCloud | Tensor]) -> tuple[Tensor, Tensor]:
    """Clouds of different length as one tensor.

    Returns:
        ``(B, N, C)`` points with N the longest; rows that pad are zeros, a range of 0, so that transforms take them
        for beams without a return. And ``(B, N)`` bool, true where a row is a point of the cloud.

    Example:
        >>> points, mask = collate_padded([torch.ones(2, 4), torch.ones(1, 4)])
        >>> points.shape, mask.tolist()
        (torch.Size([2, 2, 4]), [[True, True], [True, False]])
    """
    check_arguments("collate_padded(clouds: Sequence)", clouds)
    points = collate_list(clouds)
    lengths = torch.tensor([cloud.shape[0] for cloud in points], device=points[0].device)
    padded = torch.nn.utils.rnn.pad_sequence(points, batch_first=True)
    return padded, torch.arange(padded.shape[1], device=lengths.device) < lengths[:, None]


def split_padded(points: Tensor, mask: Tensor) -> list[Tensor]:
    """The clouds of `collate_padded`, ``(N_i, C)`` each, without the rows that pad."""
    check_arguments("split_padded(points: real, mask: real | mask)", points, mask)
    if points.ndim != 3 or mask.shape != points.shape[:2] or mask.dtype != torch.bool:
        raise InputValueError(
            f"split_padded: points must be (B, N, C) and mask (B, N) bool; got {tuple(points.shape)} and {mask.dtype} "
            f"{tuple(mask.shape)}."
        )
    return [cloud[rows] for cloud, rows in zip(points, mask, strict=True)]


def collate_indexed(clouds: Sequence[PointCloud | Tensor]) -> Tensor:
    """Clouds one after another, with the number of the sample in front: the way of OpenPCDet and MinkowskiEngine.

    Returns:
        ``(sum N_i, 1 + C)``: sample number, then the columns.

    Example:
        >>> collate_indexed([torch.ones(2, 4), torch.ones(1, 4)])[:, 0]
        tensor([0., 0., 1.])
    """
    check_arguments("collate_indexed(clouds: Sequence)", clouds)
    points = collate_list(clouds)
    _check_index_fits(points[0].dtype, len(points))
    return torch.cat([torch.cat((cloud.new_full((cloud.shape[0], 1), k), cloud), 1) for k, cloud in enumerate(points)])


def split_indexed(points: Tensor, n_samples: int | None = None) -> list[Tensor]:
    """The clouds of a batch with a leading index column, ``(N_i, C)`` each, rows in their order.

    Args:
        points: ``(N, 1 + C)``; the samples need not be in order.
        n_samples: number of samples; ``None`` takes the highest index + 1. Samples without rows are empty clouds.
    """
    check_arguments("split_indexed(points: real, n_samples: int | None)", points, n_samples)
    index = _sample_index(points, "split_indexed")
    highest = int(index.max()) + 1 if index.numel() else 0
    count = highest if n_samples is None else int(n_samples)
    check_between("n_samples", count, 0, 1 << 31, owner="split_indexed")
    if highest > count:
        raise InputValueError(
            f"split_indexed: n_samples must be {highest} or more, the highest index + 1; got {n_samples}."
        )
    order = torch.argsort(index, stable=True)
    lengths = torch.bincount(index, minlength=count).tolist()
    return list(torch.split(points[order, 1:], lengths)) if count else []


def join_indexed(clouds: Sequence[Tensor], like: Tensor) -> Tensor:
    """Put clouds back into the rows that they came from: the inverse of `split_indexed`, for samples in any order.

    Args:
        clouds: ``(N_i, C)`` each, as many rows as sample i has in ``like``. Where weather dropped points, take
            `collate_indexed`.
        like: ``(N, 1 + C)`` the batch that was split.
    """
    check_arguments("join_indexed(clouds: Sequence[real], like: real)", clouds, like)
    index = _sample_index(like, "join_indexed")
    if not all(cloud.ndim == 2 for cloud in clouds):
        raise InputValueError(
            f"join_indexed: clouds must be (N, C); got {', '.join(str(tuple(cloud.shape)) for cloud in clouds)}."
        )
    lengths = torch.bincount(index, minlength=len(clouds)).tolist()
    if [cloud.shape[0] for cloud in clouds] != lengths:
        raise InputValueError(
            f"join_indexed: clouds must have {lengths} rows, as the samples of like; got "
            f"{[cloud.shape[0] for cloud in clouds]}. Where points were dropped, take collate_indexed."
        )
    if not len(clouds):
        return like.clone()
    joined = torch.cat(collate_list(clouds)).to(like.dtype)
    rows = torch.empty_like(joined)
    rows[torch.argsort(index, stable=True)] = joined
    return torch.cat((like[:, :1], rows), dim=1)


def _sample_index(points: Tensor, owner: str) -> Tensor:
    if points.ndim != 2 or points.shape[1] < 2:
        raise InputValueError(
            f"{owner}: points must be (N, 1 + C), the first column the sample's number; got {tuple(points.shape)}."
        )
    if points.dtype in (torch.uint16, torch.uint32, torch.uint64, torch.bool) or points.is_complex():
        raise InputTypeError(f"{owner}: points must be floating point or int64; got {points.dtype}.")
    column = points[:, 0]
    index = column.long()
    if not bool(((index == column) & (column >= 0)).all()):
        raise InputValueError(f"{owner}: the first column must hold sample numbers 0, 1, ...; got other numbers.")
    return index


def _check_index_fits(dtype: torch.dtype, samples: int) -> None:
    """Beyond 2 / eps a float skips whole numbers: two samples would become one."""
    highest = 2 / torch.finfo(dtype).eps if dtype.is_floating_point else torch.iinfo(dtype).max
    if samples - 1 > highest:
        raise InputValueError(f"collate_indexed: {samples} samples cannot be numbered in {dtype}; take a wider dtype.")
