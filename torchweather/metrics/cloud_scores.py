"""Six scores of point clouds from one pair of nearest-neighbour searches, and each by its name."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from typing import Any, NamedTuple

import torch
from torch import Tensor

from torchweather.core.arguments import check_arguments
from torchweather.core.errors import InputTypeError, InputValueError, check_one_of, owner_name
from torchweather.core.precision import outside_autocast
from torchweather.metrics.clouds import CloudPair, Clouds, Region, cloud_pairs, in_batch_shape
from torchweather.metrics.filters import root
from torchweather.metrics.nearest import nearest_distances
from torchweather.metrics.shape_signature import shape_signature, signature_distance

__all__ = [
    "CLOUD_SCORES",
    "CORRESPONDENCES",
    "DIRECTIONS",
    "chamfer_distance",
    "cloud_scores",
    "hausdorff_distance",
    "hausdorff_distance_95",
    "max_mean_distance_error",
    "mean_distance_error",
    "root_mean_square_error",
]

CLOUD_SCORES = ("sdm", "rmse", "mde", "mmde", "hd", "hd95")
"""The scores of D3.4 Table 11; lower is better in all."""

CORRESPONDENCES = ("nearest", "index")
DIRECTIONS = ("both", "to_reference", "to_distorted")


class Distances(NamedTuple):
    """Distances ``d_PR`` and ``d_RP``, float64 metres; a direction not asked for is ``None``."""

    forth: Tensor | None
    back: Tensor | None

    def each(self) -> list[Tensor]:
        """Those asked for."""
        return [distance for distance in self if distance is not None]


def _mean(distance: Tensor) -> Tensor:
    return distance.mean() if len(distance) else distance.new_zeros(())


def _pooled_mean(parts: list[Tensor]) -> Tensor:
    """Mean over all; between the means of the parts, so that it never passes the largest of them by rounding."""
    sizes = [len(part) for part in parts]
    means = [_mean(part) for part in parts]
    if len(parts) == 1 or not sum(sizes):
        return means[0]
    return torch.lerp(means[0], means[1], sizes[1] / sum(sizes))


def _mde(d: Distances) -> Tensor:
    return _pooled_mean(d.each())


def _mmde(d: Distances) -> Tensor:
    return torch.stack([_mean(part) for part in d.each()]).max()


def _rmse(d: Distances) -> Tensor:
    return root(_pooled_mean([part.square() for part in d.each()]))


def _hd(d: Distances) -> Tensor:
    return torch.stack([part.max() if len(part) else part.new_zeros(()) for part in d.each()]).max()


def _hd95(d: Distances) -> Tensor:
    return torch.stack([_percentile(part, 0.95) for part in d.each()]).max()


def _chamfer(d: Distances) -> Tensor:
    return torch.stack([_mean(part) for part in d.each()]).sum()


def _chamfer_squared(d: Distances) -> Tensor:
    return torch.stack([_mean(part.square()) for part in d.each()]).sum()


def _percentile(value: Tensor, share: float) -> Tensor:
    """Linear interpolation between the two values beside ``share (n - 1)``."""
    if not len(value):
        return value.new_zeros(())
    place = share * (len(value) - 1)
    below = math.floor(place)
    low = value.kthvalue(below + 1).values
    if below + 1 >= len(value) or bool(torch.isinf(low)):  # infinity less infinity is no number
        return low
    return torch.lerp(low, value.kthvalue(below + 2).values, place - below)


_OF_DISTANCES: dict[str, Callable[[Distances], Tensor]] = {
    "rmse": _rmse,
    "mde": _mde,
    "mmde": _mmde,
    "hd": _hd,
    "hd95": _hd95,
    "chamfer": _chamfer,
    "chamfer_squared": _chamfer_squared,
}


@outside_autocast
def cloud_scores(
    distorted: Clouds,
    reference: Clouds,
    *,
    names: Iterable[str] = CLOUD_SCORES,
    correspondence: str = "nearest",
    direction: str = "both",
    distorted_valid: Clouds | None = None,
    reference_valid: Clouds | None = None,
    region: Region | None = None,
    seed: int = 0,
    search: str = "auto",
    owner: object = "cloud_scores",
) -> dict[str, Tensor]:
    """Scores of point clouds against clear ones, with one search for the nearest points each way.

    With ``d_PR(p) = min_r |p - r|`` of each distorted point and ``d_RP`` likewise:

    - ``sdm``: ``shape_signature_distance``, in [0, 1].
    - ``mde``: ``(sum d_PR + sum d_RP) / (N_P + N_R)``, metres.
    - ``rmse``: root mean square over the same distances, or of ``|p_i - r_i|`` (``correspondence="index"``).
    - ``mmde``: ``max(mean d_PR, mean d_RP)``.
    - ``hd``: ``max(max d_PR, max d_RP)``; ``hd95``: the larger 95th percentile (linear interpolation).
    - ``chamfer``: ``mean d_PR + mean d_RP``; ``chamfer_squared``: of the squares, m^2.

    Args:
        distorted, reference: one cloud ``(N, 3 or more)``, a padded batch ``(..., N, 3 or more)`` or a list of
            clouds, alike; x, y, z in metres, within 1e18 m. Sizes may differ. Rows of zeros (no return) and rows that
            are not finite are left out.
        names: which scores, in any order.
        correspondence: of ``rmse``: ``nearest``, or ``index``: row i with row i, over the rows that both have.
        direction: ``both``, or ``to_reference`` (``d_PR`` alone) or ``to_distorted`` (``d_RP`` alone). The index and
            the shape have no direction.
        distorted_valid, reference_valid: ``(..., N)`` bool or a list; false for padding.
        region: points outside are left out of both clouds first.
        seed: of the pairs of points of ``sdm``.
        search: as in ``nearest_distances``.
        owner: for messages.

    Returns:
        Each name: ``(...)``, lower is better, 0 for identical clouds, in the clouds' dtype. An empty cloud against a
        proper one: ``sdm`` 1, all others infinite; two empty clouds: 0. A cloud of one point is like any other, but
        has no shape (``sdm`` 1). Index ``rmse`` without a common row: infinite, unless both clouds are empty.

    Raises:
        ValueError: index correspondence of clouds of different length; points farther away than 1e18 m.

    Note:
        ``0 <= hd95 <= hd``, ``mde <= mmde <= hd``, ``mde <= rmse (nearest) <= hd``, to rounding. Gradients flow to
        both clouds.

    References:
        METRICS.md 2; D3.4 Table 11; chamfer: Fan et al. 2017.

    Example:
        >>> cloud = torch.tensor([[1.0, 0.0, 0.0], [0.0, 8.0, 0.0], [0.0, 0.0, 9.0]])
        >>> scores = cloud_scores(cloud + torch.tensor([0.0, 0.0, 0.5]), cloud)
        >>> {name: round(float(score), 3) for name, score in scores.items()}
        {'sdm': 0.0, 'rmse': 0.5, 'mde': 0.5, 'mmde': 0.5, 'hd': 0.5, 'hd95': 0.5}
    """
    check_arguments(
        "cloud_scores(distorted: Tensor | Sequence[Tensor], reference: Tensor | Sequence[Tensor], "
        "correspondence: str, direction: str, distorted_valid: Tensor | Sequence[Tensor] | None, "
        "reference_valid: Tensor | Sequence[Tensor] | None, region: Region | None, seed: int, search: str)",
        distorted,
        reference,
        correspondence,
        direction,
        distorted_valid,
        reference_valid,
        region,
        seed,
        search,
    )
    chosen = _chosen(names, owner)
    check_one_of("correspondence", correspondence, CORRESPONDENCES, owner=owner)
    check_one_of("direction", direction, DIRECTIONS, owner=owner)
    pairs = cloud_pairs(
        distorted,
        reference,
        distorted_valid=distorted_valid,
        reference_valid=reference_valid,
        region=region,
        owner=owner,
    )
    by_index = "rmse" in chosen and correspondence == "index"
    searched = any(name in _OF_DISTANCES and not (name == "rmse" and by_index) for name in chosen)
    found: dict[str, list[Tensor]] = {name: [] for name in chosen}
    for pair in pairs:
        points = pair.points()
        distances = _directed(points, direction, search) if searched else Distances(None, None)
        for name in chosen:
            if name == "sdm":
                score = signature_distance(*(shape_signature(cloud, seed=seed) for cloud in points))
            elif name == "rmse" and by_index:
                score = _index_rmse(pair, owner)
            else:
                score = _OF_DISTANCES[name](distances)
            found[name].append(score.to(pair.reference.dtype))
    return {name: in_batch_shape(scores, distorted, reference) for name, scores in found.items()}


def _chosen(names: Iterable[str], owner: object) -> tuple[str, ...]:
    if isinstance(names, str):
        raise InputTypeError(
            f"{owner_name(owner)}: names must be a list of names such as ['hd']; got the text {names!r}."
        )
    check_arguments(f"{owner_name(owner)}(names: Iterable)", names)
    listed = list(names)
    for name in listed:
        check_one_of("names", name, ("sdm", *_OF_DISTANCES), owner=owner)
    return tuple(dict.fromkeys(listed))


def _directed(points: tuple[Tensor, Tensor], direction: str, search: str) -> Distances:
    forth, back = nearest_distances(*points, search=search)
    if len(forth) + len(back) and not (len(forth) and len(back)):
        # One cloud is empty: infinitely far, whichever way is asked.
        return Distances((forth if len(forth) else back)[:1], None)
    return Distances(forth if direction != "to_distorted" else None, back if direction != "to_reference" else None)


def _index_rmse(pair: CloudPair, owner: object) -> Tensor:
    n, m = len(pair.distorted), len(pair.reference)
    if n != m:
        raise InputValueError(
            f"{owner_name(owner)}: correspondence='index' pairs row i with row i and needs clouds of one length; got "
            f"{n} and {m} rows. Keep lost points as rows (lost='zero' or 'nan'), or take correspondence='nearest'."
        )
    both = pair.distorted_there & pair.reference_there
    if not bool(both.any()):
        none_at_all = not bool((pair.distorted_there | pair.reference_there).any())
        return pair.reference.new_full((), 0.0 if none_at_all else torch.inf, dtype=torch.float64)
    apart = pair.distorted[both].double() - pair.reference[both].double()
    return root(apart.square().sum(-1).mean())


def root_mean_square_error(distorted: Clouds, reference: Clouds, **options: Any) -> Tensor:
    """RMSE, metres: root mean square of the distance to the nearest point, or to the point of the same row.

    Args and Returns: as in ``cloud_scores`` (``correspondence`` is ``nearest`` or ``index``); lower is better.

    Example:
        >>> clear = torch.tensor([[1.0, 0.0, 0.0], [2.0, 0.0, 0.0]])
        >>> [round(float(root_mean_square_error(clear.flip(0), clear, correspondence=c)), 6) for c in CORRESPONDENCES]
        [0.0, 1.0]
    """
    return cloud_scores(distorted, reference, names=("rmse",), owner="root_mean_square_error", **options)["rmse"]


def mean_distance_error(distorted: Clouds, reference: Clouds, **options: Any) -> Tensor:
    """MDE, metres: mean over all points of both clouds of the distance to the other cloud.

    Args and Returns: as in ``cloud_scores``, whose options it takes; lower is better.

    Example:
        >>> clear = torch.tensor([[1.0, 0.0, 0.0]])
        >>> round(float(mean_distance_error(torch.cat((clear, 3.0 * clear)), clear)), 3)
        0.667
    """
    return cloud_scores(distorted, reference, names=("mde",), owner="mean_distance_error", **options)["mde"]


def max_mean_distance_error(distorted: Clouds, reference: Clouds, **options: Any) -> Tensor:
    """MMDE, metres: the larger of the mean distances to the other cloud.

    Args and Returns: as in ``cloud_scores``, whose options it takes; lower is better.

    Example:
        >>> clear = torch.tensor([[1.0, 0.0, 0.0]])
        >>> round(float(max_mean_distance_error(torch.cat((clear, 3.0 * clear)), clear)), 3)
        1.0
    """
    return cloud_scores(distorted, reference, names=("mmde",), owner="max_mean_distance_error", **options)["mmde"]


def hausdorff_distance(distorted: Clouds, reference: Clouds, **options: Any) -> Tensor:
    """HD, metres: the largest distance of any point to the other cloud.

    Args and Returns: as in ``cloud_scores``, whose options it takes; lower is better.

    Example:
        >>> clear = torch.tensor([[1.0, 0.0, 0.0]])
        >>> round(float(hausdorff_distance(torch.cat((clear, 3.0 * clear)), clear)), 3)
        2.0
    """
    return cloud_scores(distorted, reference, names=("hd",), owner="hausdorff_distance", **options)["hd"]


def hausdorff_distance_95(distorted: Clouds, reference: Clouds, **options: Any) -> Tensor:
    """HD95, metres: the larger 95th percentile of the distances to the other cloud (linear interpolation).

    Args and Returns: as in ``cloud_scores``, whose options it takes; lower is better.

    Example:
        >>> clear = torch.tensor([[1.0, 0.0, 0.0]])
        >>> round(float(hausdorff_distance_95(torch.cat((clear, 3.0 * clear)), clear)), 3)
        1.9
    """
    return cloud_scores(distorted, reference, names=("hd95",), owner="hausdorff_distance_95", **options)["hd95"]


def chamfer_distance(distorted: Clouds, reference: Clouds, *, squared: bool = False, **options: Any) -> Tensor:
    """Chamfer distance: sum of the two mean distances to the other cloud, metres, or of their squares, m^2.

    Args and Returns: as in ``cloud_scores``; ``squared`` is the form of Fan et al. 2017. Lower is better.

    Example:
        >>> clear = torch.tensor([[1.0, 0.0, 0.0]])
        >>> [float(chamfer_distance(3.0 * clear, clear, squared=squared)) for squared in (False, True)]
        [4.0, 8.0]
    """
    check_arguments(
        "chamfer_distance(distorted: Tensor | Sequence[Tensor], reference: Tensor | Sequence[Tensor], squared: bool)",
        distorted,
        reference,
        squared,
    )
    name = "chamfer_squared" if squared else "chamfer"
    return cloud_scores(distorted, reference, names=(name,), owner="chamfer_distance", **options)[name]
