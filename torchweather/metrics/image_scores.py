"""The image scores of D3.4's Table 10 by their names."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from types import MappingProxyType

from torch import Tensor

from torchweather.errors import check_one_of
from torchweather.metrics.cw_ssim import cw_ssim
from torchweather.metrics.dss import dss
from torchweather.metrics.fsim import fsim
from torchweather.metrics.gmsd import gmsd
from torchweather.metrics.haarpsi import haarpsi
from torchweather.metrics.iw_ssim import iw_ssim
from torchweather.metrics.mdsi import mdsi
from torchweather.metrics.ms_gmsd import ms_gmsd
from torchweather.metrics.ms_ssim import ms_ssim
from torchweather.metrics.psnr import psnr
from torchweather.metrics.score import ScoreFacts
from torchweather.metrics.sr_sim import sr_sim
from torchweather.metrics.ssim import ssim
from torchweather.metrics.vif import vif
from torchweather.metrics.vsi import vsi

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
"""What each score is, in the order of the table."""


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

    Example:
        >>> import torch
        >>> clear = torch.rand(3, 16, 16, generator=torch.Generator().manual_seed(1))
        >>> sorted(image_scores(0.5 * clear + 0.2, clear, ["psnr", "gmsd"]))
        ['gmsd', 'psnr']
    """
    chosen = list(IMAGE_SCORES) if names is None else list(names)
    for name in chosen:
        check_one_of("score", name, IMAGE_SCORES, owner="image_scores")
    return {name: IMAGE_SCORES[name].function(distorted, reference, data_range=data_range) for name in chosen}
