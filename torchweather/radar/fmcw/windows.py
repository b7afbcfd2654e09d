"""Windows of the range and Doppler transforms, and what a tone between two bins looks like through them."""

from __future__ import annotations

from functools import lru_cache

import torch
from torch import Tensor

from torchweather.core.errors import check_one_of

__all__ = ["WINDOWS", "migration_share", "noise_bandwidth", "tone_place_and_loss", "window"]

# Sums of cosines: coefficients of cos(2 pi k n / N) with alternating signs (Harris 1978, table 1 and section V)
WINDOWS: dict[str, tuple[float, ...]] = {
    "rectangular": (1.0,),
    "hann": (0.5, 0.5),
    "hamming": (0.54, 0.46),
    "blackman": (0.42, 0.5, 0.08),
}
PLACES = 1025  # nodes of the table of places between two bins; its error is below 1e-5 of a bin
NOTHING = 1e-30
MOST_CROSSED, MIGRATION_NODES = 4.0, 129  # range bins in a frame; linear between the nodes to 1e-4 of the share


@lru_cache(maxsize=64)
def window(name: str, length: int) -> Tensor:
    """``(length,)`` weights, float64, that sum to 1; periodic, as suits a transform.

    Args:
        name: one of ``WINDOWS``.
        length: 1 or more; up to twice the number of cosines the rectangular one.

    Example:
        >>> [round(v, 3) for v in window("hann", 8).tolist()]
        [0.0, 0.037, 0.125, 0.213, 0.25, 0.213, 0.125, 0.037]
    """
    check_one_of("window", name, WINDOWS, owner="window")
    terms = WINDOWS[name] if length > 2 * len(WINDOWS[name]) else WINDOWS["rectangular"]
    phase = 2.0 * torch.pi * torch.arange(length, dtype=torch.float64) / length
    weights = torch.zeros_like(phase)
    for k, a in enumerate(terms):
        weights = weights + (-1) ** k * a * torch.cos(k * phase)
    return weights / weights.sum()


def noise_bandwidth(name: str, length: int) -> float:
    """Noise power of a bin of the windowed transform over the power of one sample: sum of squared weights.

    Example:
        >>> round(noise_bandwidth("hann", 256) * 256, 3)
        1.5
    """
    return float(window(name, length).square().sum())


@lru_cache(maxsize=64)
def _table(name: str, length: int) -> tuple[Tensor, Tensor, Tensor]:
    """Place of a tone, -0.5 to 0.5 bins, what its neighbours say of it there, and its power in the nearest bin."""
    place = torch.linspace(-0.5, 0.5, PLACES, dtype=torch.float64)
    weights, n = window(name, length), torch.arange(length, dtype=torch.float64)

    def power(bins_away: Tensor) -> Tensor:
        turns = torch.exp(2j * torch.pi * bins_away[:, None] * n / length)
        return (turns @ weights.to(turns.dtype)).abs().square()

    return place, _lean(power(place + 1), power(place - 1)), power(place)


def _lean(before: Tensor, after: Tensor) -> Tensor:
    """-1 to 1: which neighbour of a peak is stronger, rising with the place of the tone."""
    low, high = before.clamp_min(NOTHING).sqrt(), after.clamp_min(NOTHING).sqrt()
    return (high - low) / (high + low)


def tone_place_and_loss(before: Tensor, after: Tensor, name: str, length: int) -> tuple[Tensor, Tensor]:
    """Where between bins a tone lies, from the powers beside its peak.

    Args:
        before, after: power in the bins below and above the peak's, any shape.
        name: of the window.
        length: of the transform; one bin has no neighbours: place 0.

    Returns:
        Place from the peak's bin, -0.5 to 0.5 bins, and the share of the tone's power that the peak's bin shows.

    Note:
        Exact for one tone without noise.

    Example:
        >>> place, share = tone_place_and_loss(torch.tensor(0.25), torch.tensor(0.25), "hann", 64)
        >>> float(place), float(share)
        (0.0, 1.0)
    """
    if length < 3:
        return torch.zeros_like(before), torch.ones_like(before)
    place, lean, share = (values.to(before) for values in _table(name, length))
    seen = _lean(before, after).clamp(float(lean[0]), float(lean[-1]))
    right = torch.searchsorted(lean, seen.contiguous()).clamp(1, PLACES - 1)
    width = (lean[right] - lean[right - 1]).clamp_min(NOTHING)
    part = ((seen - lean[right - 1]) / width).clamp(0.0, 1.0)
    return torch.lerp(place[right - 1], place[right], part), torch.lerp(share[right - 1], share[right], part)


@lru_cache(maxsize=16)
def _migration_table(name: str, chirps: int, samples: int) -> Tensor:
    """Share of a moving tone's power that its peak keeps, over the bins it crosses in the frame."""
    crossed = torch.linspace(0.0, MOST_CROSSED, MIGRATION_NODES, dtype=torch.float64)
    slow, fast = (torch.arange(length, dtype=torch.float64) / length - 0.5 for length in (chirps, samples))
    weights = window(name, samples).to(torch.complex128)
    rotated = torch.exp(2j * torch.pi * crossed[:, None, None] * slow[:, None] * fast) @ weights
    return (rotated @ window(name, chirps).to(torch.complex128)).abs().square()


def migration_share(crossed_bins: Tensor, name: str, chirps: int, samples: int) -> Tensor:
    """Share of its power that the peak of a target keeps which crosses range bins within the frame.

    Range and slow time are coupled by ``exp(j 2 pi crossed (m / N_c - 1/2) (n / N_s - 1/2))``.

    Args:
        crossed_bins: range bins that the target goes in the frame, any shape; held beyond ``MOST_CROSSED``.
        name: of the window of both transforms.
        chirps, samples: lengths of the transforms.

    Example:
        >>> share = migration_share(torch.tensor([0.0, 1.0], dtype=torch.float64), "hann", 64, 64)
        >>> [round(v, 3) for v in share.tolist()]
        [1.0, 0.959]
    """
    table = _migration_table(name, chirps, samples).to(crossed_bins)
    place = (crossed_bins.abs() * ((MIGRATION_NODES - 1) / MOST_CROSSED)).clamp_max(MIGRATION_NODES - 1)
    left = place.detach().floor().clamp_max(MIGRATION_NODES - 2).long()
    return torch.lerp(table[left], table[left + 1], place - left)
