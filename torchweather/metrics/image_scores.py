"""The image scores of D3.4's Table 10 by their names."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping
from types import MappingProxyType

from torch import Tensor

from torchweather.core.arguments import check_arguments
from torchweather.core.errors import InputTypeError, check_one_of
from torchweather.core.precision import outside_autocast
from torchweather.metrics.cw_ssim import cw_ssim, cw_ssim_of
from torchweather.metrics.dss import dss, dss_of
from torchweather.metrics.fsim import fsim, fsim_of
from torchweather.metrics.gmsd import gmsd, gmsd_of
from torchweather.metrics.haarpsi import haarpsi, haarpsi_of
from torchweather.metrics.iw_ssim import iw_ssim, iw_ssim_of
from torchweather.metrics.mdsi import mdsi, mdsi_of
from torchweather.metrics.ms_gmsd import ms_gmsd, ms_gmsd_of
from torchweather.metrics.ms_ssim import ms_ssim, ms_ssim_of
from torchweather.metrics.pairs import Pair
from torchweather.metrics.psnr import psnr, psnr_of
from torchweather.metrics.score import ScoreFacts
from torchweather.metrics.sr_sim import sr_sim, sr_sim_of
from torchweather.metrics.ssim import ssim, ssim_of
from torchweather.metrics.vif import vif, vif_of
from torchweather.metrics.vsi import vsi, vsi_of

__all__ = ["IMAGE_SCORES", "image_scores"]

IMAGE_SCORES: Mapping[str, ScoreFacts] = MappingProxyType(
    {
        "psnr": ScoreFacts(psnr, True, 0.0, math.inf, math.inf, 1),
        "ssim": ScoreFacts(ssim, True, -1.0, 1.0, 1.0, 11),
        "ms_ssim": ScoreFacts(ms_ssim, True, 0.0, 1.0, 1.0, 161),
        "cw_ssim": ScoreFacts(cw_ssim, True, 0.0, 1.0, 1.0, 49),
        "iw_ssim": ScoreFacts(iw_ssim, True, 0.0, 1.0, 1.0, 161),
        "dss": ScoreFacts(dss, True, 0.0, 1.0, 1.0, 8),
        "vif": ScoreFacts(vif, True, 0.0, math.inf, 1.0, 41),
        "vsi": ScoreFacts(vsi, True, 0.0, 1.0, 1.0, 3),
        "fsim": ScoreFacts(fsim, True, 0.0, 1.0, 1.0, 8),
        "sr_sim": ScoreFacts(sr_sim, True, 0.0, 1.0, 1.0, 12),
        "haarpsi": ScoreFacts(haarpsi, True, 0.0, 1.0, 1.0, 16),
        "gmsd": ScoreFacts(gmsd, False, 0.0, math.inf, 0.0, 5),
        "ms_gmsd": ScoreFacts(ms_gmsd, False, 0.0, math.inf, 0.0, 16),
        "mdsi": ScoreFacts(mdsi, False, 0.0, math.inf, 0.0, 3),
    }
)
"""Facts of each score, in the order of the table."""

OF_PAIR: Mapping[str, Callable[[Pair], Tensor]] = MappingProxyType(
    {
        "psnr": psnr_of,
        "ssim": ssim_of,
        "ms_ssim": ms_ssim_of,
        "cw_ssim": cw_ssim_of,
        "iw_ssim": iw_ssim_of,
        "dss": dss_of,
        "vif": vif_of,
        "vsi": vsi_of,
        "fsim": fsim_of,
        "sr_sim": sr_sim_of,
        "haarpsi": haarpsi_of,
        "gmsd": gmsd_of,
        "ms_gmsd": ms_gmsd_of,
        "mdsi": mdsi_of,
    }
)
"""The same scores of a pair that they share."""


@outside_autocast
def image_scores(
    distorted: Tensor, reference: Tensor, names: Iterable[str] | None = None, *, data_range: float = 1.0
) -> dict[str, Tensor]:
    """Several scores of images.

    Args:
        distorted, reference: ``(..., C, H, W)`` in ``[0, data_range]``, C = 1 or 3.
        names: of ``IMAGE_SCORES``; ``None``: all of them, which takes 161 pixels a side.
        data_range: value of white.

    Returns:
        Name to ``(...)`` scores, in the order asked for.

    Note:
        Checks, brightness and smaller copies of the images are found once for all scores, unless gradients flow to the
        images: then each score has a graph of its own.

    Example:
        >>> import torch
        >>> clear = torch.rand(3, 16, 16, generator=torch.Generator().manual_seed(1))
        >>> sorted(image_scores(0.5 * clear + 0.2, clear, ["psnr", "gmsd"]))
        ['gmsd', 'psnr']
    """
    check_arguments(
        "image_scores(distorted: Tensor, reference: Tensor, data_range: float)",
        distorted,
        reference,
        data_range,
    )
    if isinstance(names, str):
        raise InputTypeError(f"image_scores: names must be a list of names such as ['ssim']; got the text {names!r}.")
    check_arguments("image_scores(names: Iterable | None)", names)
    chosen = list(IMAGE_SCORES) if names is None else list(names)
    for name in chosen:
        check_one_of("score", name, IMAGE_SCORES, owner="image_scores")
    if not chosen:
        return {}
    # the error names the score that needs the largest image
    neediest = max(chosen, key=lambda name: IMAGE_SCORES[name].minimum)
    minimum = IMAGE_SCORES[neediest].minimum

    def pair() -> Pair:
        return Pair(distorted, reference, data_range, minimum=minimum, owner=neediest)

    shared = pair()
    # a gradient may be taken of each score by itself: then nothing is shared, as its graph is gone after that
    alone = any(image.requires_grad for image in shared.images)
    return {name: OF_PAIR[name](pair() if alone else shared) for name in chosen}
