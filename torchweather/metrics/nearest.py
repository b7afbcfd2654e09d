"""Exact nearest neighbours between two clouds, both ways, without a matrix of all distances."""

from __future__ import annotations

import numpy as np
import torch
from scipy.spatial import cKDTree
from torch import Tensor

from torchweather.core.errors import check_one_of

__all__ = ["SEARCHES", "nearest_distances"]

# Midpoints instead of medians, and larger leaves: in a scan, whose rings hold many points equally far from a flake near
# the axis, such a tree finds the nearest 20 times faster; among scattered points it is as fast.
SLIDING = {"balanced_tree": False, "compact_nodes": False, "leafsize": 32}

SEARCHES = ("auto", "tree", "exhaustive")
# Entries of the distance matrix that the exhaustive search holds at once: 512 MB in float32, differences included.
PORTION = 1 << 26
# A leaf of the tree cannot split points at one place, and is searched point by point: from so many on they are merged.
MANY_AT_ONE_PLACE = 256


def nearest_distances(distorted: Tensor, reference: Tensor, *, search: str = "auto") -> tuple[Tensor, Tensor]:
    """Distance of each point to the nearest of the other cloud, metres: ``d_PR`` and ``d_RP``.

    Args:
        distorted, reference: ``(N, 3)`` and ``(M, 3)``, within 1e18 m, one dtype, one device.
        search: ``tree`` (k-d tree, on the processor, on as many threads as torch uses), ``exhaustive`` (all distances
            in portions, on the device of the clouds) or ``auto``: the tree on the processor, else exhaustive.

    Returns:
        ``(N,)`` and ``(M,)`` float64, with gradients (0 where two points coincide); infinite where the other cloud is
        empty.

    Note:
        Both searches are exact; where two neighbours are equally near, either may get the gradient. The exhaustive
        search compares distances in the clouds' dtype, so it may take one of two neighbours that differ by rounding.
        The tree is slow where thousands of points are nearly equally near: at the centre of a sphere of points 20 000
        against 20 000 take 2 s on 2 cores, in a street about 0.1 s.

    References:
        METRICS.md 2.

    Example:
        >>> there, back = nearest_distances(torch.tensor([[3.0, 0.0, 0.0]]), torch.tensor([[3.0, 4.0, 0.0]]))
        >>> float(there), float(back)
        (4.0, 4.0)
    """
    check_one_of("search", search, SEARCHES, owner="nearest_distances")
    if not len(distorted) or not len(reference):
        far = torch.inf
        return distorted.new_full((len(distorted),), far).double(), reference.new_full((len(reference),), far).double()
    if search == "tree" or (search == "auto" and distorted.device.type == "cpu"):
        to_reference, to_distorted = _by_tree(distorted.detach(), reference.detach())
    else:
        to_reference, to_distorted = _exhaustive(distorted.detach(), reference.detach())
    p, r = distorted.double(), reference.double()
    forth = torch.linalg.vector_norm(p - r[to_reference], dim=-1)
    return forth, torch.linalg.vector_norm(r - p[to_distorted], dim=-1)


def _by_tree(distorted: Tensor, reference: Tensor) -> tuple[Tensor, Tensor]:
    p, r = (cloud.double().cpu().numpy() for cloud in (distorted, reference))
    p_kept, r_kept = _distinct(p), _distinct(r)
    p_tree, r_tree = (cKDTree(c if k is None else c[k], **SLIDING) for c, k in ((p, p_kept), (r, r_kept)))
    found = (
        _in_order(r_tree, p, None if p_kept is not None else p_tree.indices, r_kept),
        _in_order(p_tree, r, None if r_kept is not None else r_tree.indices, p_kept),
    )
    to_reference, to_distorted = (torch.from_numpy(index).to(distorted.device) for index in found)
    return to_reference, to_distorted


def _in_order(tree: cKDTree, points: np.ndarray, order: np.ndarray | None, kept: np.ndarray | None) -> np.ndarray:
    """Index of the nearest of the tree, asked along ``order``: for neighbours in turn the tree stays in the cache."""
    asked = points if order is None else points[order]
    index: np.ndarray = tree.query(asked, workers=torch.get_num_threads())[1]
    index = index if kept is None else kept[index]
    if order is None:
        return index
    found = np.empty_like(index)
    found[order] = index
    return found


def _distinct(points: np.ndarray) -> np.ndarray | None:
    """Rows that differ, or ``None`` where no place holds many points."""
    # Equal points have equal keys; others hardly ever, and then the search is only slower.
    keys: np.ndarray = np.sort(points @ np.array([1.0, np.sqrt(2.0), np.sqrt(3.0)]))
    if not (keys[MANY_AT_ONE_PLACE:] == keys[:-MANY_AT_ONE_PLACE]).any():
        return None
    rows: np.ndarray = np.unique(points, axis=0, return_index=True)[1]
    return rows


def _exhaustive(distorted: Tensor, reference: Tensor) -> tuple[Tensor, Tensor]:
    rows = max(1, PORTION // len(reference))
    to_reference = []
    least = reference.new_full((len(reference),), torch.inf)
    to_distorted = torch.zeros(len(reference), dtype=torch.int64, device=reference.device)
    for number, part in enumerate(torch.split(distorted, rows)):
        square = _squared_distances(part, reference)
        to_reference.append(square.argmin(1))
        lowest, row = square.min(0)
        nearer = lowest < least
        least = torch.where(nearer, lowest, least)
        to_distorted = torch.where(nearer, row + number * rows, to_distorted)
    return torch.cat(to_reference), to_distorted


def _squared_distances(points: Tensor, others: Tensor) -> Tensor:
    """Of differences, not ``|p|^2 - 2 p r + |r|^2``, which loses all digits between near points far from the origin."""
    square = (points[:, :1] - others[:, 0]).square_()
    for axis in (1, 2):
        apart = points[:, axis, None] - others[:, axis]
        square.addcmul_(apart, apart)
    return square
