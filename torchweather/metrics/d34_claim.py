"""Claim of D3.4 on metrics and detectors, compared with the findings."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

from torchweather.metrics.coefficients import Coefficient, abs_interval

__all__ = ["D34_CLAIM", "HIGHLY", "Claim", "ClaimCheck", "check_claim"]

# |rho| from which on two quantities "correlate highly": a common reading (Hinkle, Wiersma and Jurs 2003: 0.7 to 0.9 is
# high); D3.4 gives no number.
HIGHLY = 0.7


@dataclass(frozen=True)
class Claim:
    """A published claim: the metrics that correlate highly with the performance of detectors, and those that do not."""

    place: str
    text: str
    high: tuple[str, ...]
    not_high: tuple[str, ...]


@dataclass(frozen=True)
class ClaimCheck:
    """The claim about one metric, and what is found."""

    metric: str
    claimed_high: bool
    found: float
    """Size of Spearman's rho."""
    low: float
    high: float
    """Bounds of the 95 % interval of the size."""
    verdict: str
    """``agrees`` or ``contradicts`` where the whole interval lies on one side of the threshold, else ``cannot be
    judged``."""


D34_CLAIM = Claim(
    place="ROADVIEW D3.4, chapter 7, on the image metrics of Table 10",
    text="11 of the 14 image metrics correlate highly with the performance of detectors; PSNR, VIF and MDSI do not.",
    high=(*("ssim", "ms_ssim", "cw_ssim", "iw_ssim", "dss", "vsi", "fsim", "sr_sim", "haarpsi", "gmsd", "ms_gmsd"),),
    not_high=("psnr", "vif", "mdsi"),
)


def check_claim(
    spearman: Mapping[str, Coefficient], *, claim: Claim = D34_CLAIM, highly: float = HIGHLY
) -> tuple[ClaimCheck, ...]:
    """The claim beside the coefficients that are found, for the metrics that it speaks of.

    Args:
        spearman: of every metric, by the names of ``IMAGE_SCORES`` or as D3.4 writes them (``MS-SSIM``).
        claim: what is held against them.
        highly: size of the coefficient from which on a correlation is high.

    Example:
        >>> [found] = check_claim({"PSNR": Coefficient(0.95, 0.85, 0.99, 1e-6)})
        >>> found.claimed_high, found.verdict
        (False, 'contradicts')
    """
    found = []
    for metric, coefficient in spearman.items():
        name = metric.lower().replace("-", "_").replace("haar_psi", "haarpsi")
        if name in (*claim.high, *claim.not_high):
            low, high = abs_interval(coefficient)
            claimed = name in claim.high
            verdict = _verdict(claimed, low, high, highly)
            found.append(ClaimCheck(metric, claimed, abs(coefficient.value), low, high, verdict))
    return tuple(found)


def _verdict(claimed_high: bool, low: float, high: float, highly: float) -> str:
    if math.isnan(low) or low < highly <= high:
        return "cannot be judged"
    return "agrees" if (low >= highly) == claimed_high else "contradicts"
