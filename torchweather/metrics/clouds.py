"""First steps of every cloud score: pairs of clouds one by one, the points that are there, a region."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import torch
from torch import Tensor

from torchweather.core.arguments import check_arguments
from torchweather.core.errors import InputTypeError, InputValueError, owner_name

__all__ = ["CloudPair", "Clouds", "Region", "cloud_pairs", "in_batch_shape", "there"]

Clouds = Tensor | Sequence[Tensor]
"""One cloud ``(N, C)``, a padded batch ``(..., N, C)`` or a list of clouds ``(N_i, C)``."""


@dataclass(frozen=True)
class Region:
    """A box along the axes, metres; points on its faces are inside.

    Args:
        x_m, y_m, z_m: lowest and highest coordinate.

    Example:
        >>> Region(x_m=(0.0, 28.0)).holds(torch.tensor([[5.0, 0.0, 0.0], [30.0, 0.0, 0.0]]))
        tensor([ True, False])
    """

    x_m: tuple[float, float] = (-math.inf, math.inf)
    y_m: tuple[float, float] = (-math.inf, math.inf)
    z_m: tuple[float, float] = (-math.inf, math.inf)

    def __post_init__(self) -> None:
        check_arguments("Region(x_m: Sequence, y_m: Sequence, z_m: Sequence)", self.x_m, self.y_m, self.z_m)
        for name, limits in (("x_m", self.x_m), ("y_m", self.y_m), ("z_m", self.z_m)):
            check_arguments(f"Region({name}: Sequence[float])", limits)
            if len(limits) != 2 or not limits[0] < limits[1]:
                raise InputValueError(f"Region: {name} must be (lowest, highest) in m; got {limits!r}.")

    def holds(self, points: Tensor) -> Tensor:
        """``(..., N)`` bool, which points ``(..., N, 3 or more)`` are inside."""
        x, y, z = points[..., :3].unbind(-1)
        inside = (
            (limits[0] <= along) & (along <= limits[1])
            for along, limits in ((x, self.x_m), (y, self.y_m), (z, self.z_m))
        )
        return next(inside) & next(inside) & next(inside)


# Squares of distances, and their sums over a cloud, then stay in the range of single precision: 12 FARTHEST_M^2 < 3e38.
FARTHEST_M = 1e18
_WITHIN_REACH = Region(*[(-FARTHEST_M, FARTHEST_M)] * 3)


class CloudPair(NamedTuple):
    """Two clouds ``(N, 3)`` and ``(M, 3)`` of one dtype, and which of their points are there."""

    distorted: Tensor
    reference: Tensor
    distorted_there: Tensor
    reference_there: Tensor

    def points(self) -> tuple[Tensor, Tensor]:
        """The points that are there, of each."""
        return _kept(self.distorted, self.distorted_there), _kept(self.reference, self.reference_there)


def _kept(points: Tensor, mask: Tensor) -> Tensor:
    return points if bool(mask.all()) else points[mask]


def there(points: Tensor, valid: Tensor | None = None, region: Region | None = None) -> Tensor:
    """Mask of the points: valid, finite, not the row of zeros that stands for no return, inside the region.

    Args:
        points: ``(..., N, 3 or more)``.
        valid: ``(..., N)`` bool.
        region: bound, or ``None``.

    Returns:
        ``(..., N)`` bool.
    """
    place = points[..., :3].detach()
    place = place if place.dtype == torch.float64 else place.float()
    # A product is ten times as fast as .all(-1) and .any(-1); a quarter of each, so that finite numbers have a sum.
    size = place.abs() @ place.new_full((3,), 0.25)
    found = (size > 0) & (size < torch.inf)
    if valid is not None:
        found &= valid
    return found & region.holds(place) if region is not None else found


def cloud_pairs(
    distorted: Clouds,
    reference: Clouds,
    *,
    distorted_valid: Clouds | None = None,
    reference_valid: Clouds | None = None,
    region: Region | None = None,
    owner: object,
) -> list[CloudPair]:
    """The pairs of a batch, one by one.

    Args:
        distorted, reference: one cloud, a padded batch or a list, alike; columns x, y, z in metres, within 1e18 m of
            the origin, further ones are ignored. The numbers of points may differ.
        distorted_valid, reference_valid: ``(..., N)`` bool or a list of ``(N_i,)``: false for padding.
        region: points outside are left out.
        owner: for messages.
    """
    name = owner_name(owner)
    first = _one_by_one("distorted", distorted, distorted_valid, name)
    second = _one_by_one("reference", reference, reference_valid, name)
    if _batch(distorted) != _batch(reference):
        raise InputValueError(
            f"{name}: distorted and reference must be batches of one size; got {_described(distorted)} and "
            f"{_described(reference)}."
        )
    pairs = []
    for (p, p_valid), (r, r_valid) in zip(first, second, strict=True):
        if p.device != r.device:
            raise InputValueError(f"{name}: both clouds must be on one device; got {p.device} and {r.device}.")
        kind = _kind(p, r)
        p, r = p[:, :3].to(kind), r[:, :3].to(kind)
        pair = CloudPair(p, r, there(p, p_valid, region), there(r, r_valid, region))
        _check_reach("distorted", p, pair.distorted_there, name)
        _check_reach("reference", r, pair.reference_there, name)
        pairs.append(pair)
    return pairs


def in_batch_shape(scores: list[Tensor], distorted: Clouds, reference: Clouds) -> Tensor:
    """The scores of the pairs in the batch shape of the clouds."""
    if scores:
        return torch.stack(scores).reshape(_batch(reference))
    if isinstance(distorted, Tensor) and isinstance(reference, Tensor):
        return torch.zeros(_batch(reference), dtype=_kind(distorted, reference), device=reference.device)
    return torch.zeros(_batch(reference), dtype=torch.float32, device="cpu")  # a list of none says neither


def _batch(clouds: Clouds) -> tuple[int, ...]:
    return tuple(clouds.shape[:-2]) if isinstance(clouds, Tensor) else (len(clouds),)


def _kind(distorted: Tensor, reference: Tensor) -> torch.dtype:
    return torch.float64 if torch.float64 in (distorted.dtype, reference.dtype) else torch.float32


def _check_reach(which: str, points: Tensor, mask: Tensor, name: str) -> None:
    far = mask & ~_WITHIN_REACH.holds(points.detach())
    if bool(far.any()):
        raise InputValueError(
            f"{name}: coordinates of {which} must be within {FARTHEST_M:g} m; got "
            f"{float(points[far].detach().abs().max()):g} m. Lost points are rows of zeros or NaN; a region leaves out "
            "others."
        )


def _one_by_one(which: str, clouds: Clouds, valid: Clouds | None, name: str) -> list[tuple[Tensor, Tensor | None]]:
    if isinstance(clouds, Tensor):
        _check(which, clouds, valid, name)
        flat = clouds.flatten(0, -3) if clouds.ndim > 2 else clouds[None]
        masks: list[Tensor | None] = [None] * len(flat)
        if isinstance(valid, Tensor):
            masks = list(valid.reshape(flat.shape[:-1]).unbind())
        return list(zip(flat.unbind(), masks, strict=True))
    if isinstance(clouds, str | bytes) or not isinstance(clouds, Sequence):
        raise InputTypeError(
            f"{name}: {which} must be a tensor (..., N, 3 or more) or a list; got {type(clouds).__name__}."
        )
    masks = [None] * len(clouds) if valid is None else [*valid]
    if len(masks) != len(clouds):
        raise InputValueError(f"{name}: {which}_valid must have one mask a cloud, {len(clouds)}; got {len(masks)}.")
    for cloud, mask in zip(clouds, masks, strict=True):
        _check(which, cloud, mask, name)
        if cloud.ndim != 2:
            raise InputValueError(
                f"{name}: clouds of a list must be (N, 3 or more); got {tuple(cloud.shape)} in {which}."
            )
    return list(zip(clouds, masks, strict=True))


def _check(which: str, cloud: Tensor, valid: object, name: str) -> None:
    if not isinstance(cloud, Tensor):
        raise InputTypeError(f"{name}: {which} must hold tensors (..., N, 3 or more); got {type(cloud).__name__}.")
    if cloud.is_complex() or cloud.dtype == torch.bool:
        raise InputTypeError(f"{name}: {which} must hold real numbers; got {cloud.dtype}.")
    if cloud.ndim < 2 or cloud.shape[-1] < 3:
        raise InputValueError(f"{name}: {which} must be (..., N, 3 or more) = x, y, z in m; got {tuple(cloud.shape)}.")
    if valid is None:
        return
    if not isinstance(valid, Tensor) or valid.dtype != torch.bool or valid.shape != cloud.shape[:-1]:
        came = f"{valid.dtype} {tuple(valid.shape)}" if isinstance(valid, Tensor) else type(valid).__name__
        raise InputValueError(f"{name}: {which}_valid must be bool {tuple(cloud.shape[:-1])}; got {came}.")


def _described(clouds: Clouds) -> str:
    return str(tuple(clouds.shape)) if isinstance(clouds, Tensor) else f"a list of {len(clouds)}"
