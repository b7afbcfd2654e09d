"""Distance between the shapes of two clouds: the quantile functions of the distance between two of their points."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from torchweather.core.arguments import check_arguments
from torchweather.core.precision import outside_autocast
from torchweather.metrics.clouds import Clouds, Region, cloud_pairs, in_batch_shape

__all__ = ["sdm", "shape_signature", "shape_signature_distance", "signature_distance"]

# METRICS.md 2.
PAIRS = 1 << 20
QUANTILES = 4096


def shape_signature(points: Tensor, *, seed: int = 0) -> Tensor:
    """Quantile function ``Q(u)`` of the distance between two random points of a cloud (D2 shape distribution).

    Args:
        points: ``(N, 3)`` metres, within 1e18 m.
        seed: of the pairs drawn where there are more than 2^20.

    Returns:
        ``(4096,)`` float64, metres, at ``u = (k + 1/2) / 4096``, rising; zeros for a cloud of fewer than two points.

    References:
        Osada et al. 2002, Shape distributions, ACM Transactions on Graphics 21(4); METRICS.md 2.

    Example:
        >>> shape_signature(torch.tensor([[0.0, 0.0, 0.0], [3.0, 4.0, 0.0]])).unique()
        tensor([5.], dtype=torch.float64)
    """
    n = len(points)
    if n < 2:
        return points.new_zeros(QUANTILES, dtype=torch.float64)
    if n * (n - 1) // 2 <= PAIRS:
        distance = torch.pdist(points)
    else:
        first, second = (torch.from_numpy(rows).to(points.device) for rows in _drawn_pairs(n, seed))
        apart = points.index_select(0, first) - points.index_select(0, second)
        distance = torch.linalg.vector_norm(apart, dim=-1)
    # The inverse of the empirical distribution function.
    place = ((torch.arange(QUANTILES, device=points.device) * 2 + 1) * len(distance)) // (2 * QUANTILES)
    return _ascending(distance)[place].double()


@lru_cache(maxsize=1)  # 16 MB, for the other cloud of the same size
def _drawn_pairs(n: int, seed: int) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Rows of 2^20 pairs of different points, the same on every device.

    Arrays: a tensor kept from inference mode would stop later gradients.
    """
    generator = torch.Generator().manual_seed(seed)
    first = torch.randint(n, (PAIRS,), generator=generator, device="cpu").numpy()
    second = torch.randint(n - 1, (PAIRS,), generator=generator, device="cpu").numpy()
    second += second >= first  # any other than the first, each as likely
    return first, second


def _ascending(value: Tensor) -> Tensor:
    if value.requires_grad or value.device.type != "cpu":
        return value.sort().values
    return torch.from_numpy(np.sort(value.numpy()))  # several times faster on one core


def signature_distance(first: Tensor, second: Tensor) -> Tensor:
    """``2 W / (mu_1 + mu_2 + W)``, ``W = mean |Q_1 - Q_2|``, ``mu = mean Q``; 0 where both are zero.

    Args:
        first, second: ``(..., K)`` signatures, 0 or more.

    Returns:
        ``(...)`` in [0, 1], a metric on signatures.

    Example:
        >>> round(float(signature_distance(torch.full((8,), 4.0), torch.full((8,), 5.0))), 6)
        0.2
    """
    apart = (first - second).abs().mean(-1)
    whole = first.mean(-1) + second.mean(-1) + apart
    shaped = whole > 0
    return torch.where(shaped, 2.0 * apart / torch.where(shaped, whole, 1.0), 0.0)


@outside_autocast
def shape_signature_distance(
    distorted: Clouds,
    reference: Clouds,
    *,
    distorted_valid: Clouds | None = None,
    reference_valid: Clouds | None = None,
    region: Region | None = None,
    seed: int = 0,
) -> Tensor:
    """Shape distance of two clouds (SDM): ``2 W / (mu_P + mu_R + W)`` of their signatures.

    ``W`` is the mean of ``|Q_P - Q_R|`` and ``mu`` that of ``Q``, the quantile function of the distance between two
    points. Blind to rigid motion, to the order of the points and to a scale of both.

    Args:
        distorted, reference: one cloud ``(N, 3 or more)``, a batch ``(..., N, 3 or more)`` or a list; metres, within
            1e18 m.
        distorted_valid, reference_valid: ``(..., N)`` bool or a list; false for padding.
        region: points outside are left out.
        seed: of the pairs drawn from clouds of more than 1448 points.

    Returns:
        ``(...)`` in [0, 1], lower is better. Clouds of fewer than two places (empty, one point) have no shape: against
        a proper cloud they score 1, against one another 0.

    Note:
        The pairs of two clouds of one size are the same rows, so identical clouds score exactly 0. Another order or
        another sample of the same surface leaves about 0.001, the noise of 2^20 pairs. The published formula of the
        Shahbeigi-Donzella metric is not available; this is the definition of METRICS.md.

    References:
        METRICS.md 2; Osada et al. 2002.

    Example:
        >>> cloud = torch.rand(100, 3)
        >>> float(sdm(cloud, cloud)), float(sdm(cloud[:1], cloud))
        (0.0, 1.0)
    """
    check_arguments(
        "sdm(distorted: Tensor | Sequence[Tensor], reference: Tensor | Sequence[Tensor], "
        "distorted_valid: Tensor | Sequence[Tensor] | None, reference_valid: Tensor | Sequence[Tensor] | None, "
        "region: Region | None, seed: int)",
        distorted,
        reference,
        distorted_valid,
        reference_valid,
        region,
        seed,
    )
    pairs = cloud_pairs(
        distorted,
        reference,
        distorted_valid=distorted_valid,
        reference_valid=reference_valid,
        region=region,
        owner="shape_signature_distance",
    )
    scores = []
    for pair in pairs:
        signatures = (shape_signature(points, seed=seed) for points in pair.points())
        scores.append(signature_distance(*signatures).to(pair.reference.dtype))
    return in_batch_shape(scores, distorted, reference)


sdm = shape_signature_distance
