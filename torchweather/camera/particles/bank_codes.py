"""Codes of optical depth and bins of depth, by which a bank of training weather is looked up."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
import torch
from torch import Tensor

__all__ = ["AMPLITUDES", "BIN_SHIFT", "BankTables", "amplitude_of", "between", "decoded_codes", "depth_bins", "encoded"]

# Optical depth by a code of 8 bits: FAINT (exp(STEP q) - 1), steps of 4 %; 8 covers all but 3e-4 of a pixel.
FAINT, LARGEST = 2e-4, 8.0
STEP = math.log1p(LARGEST / FAINT) / 255
# Bins of depth are the highest bits of a float: 128 per octave, 0.4 % on either side of their middle.
BIN_SHIFT = 16
AMPLITUDES = (0.0, 0.7, 0.85, 1.0, 1.15, 1.3, 1.6, 2.4)  # at which the mean transmission of a layer is tabulated


@dataclass(frozen=True)
class BankTables:
    """Look-ups of one sample: ``amplitude[bin] (level[code] + level[code']) + even[bin]`` is its optical depth.

    Args:
        node: number of the bank's rate.
        near_m, far_m: limits of the bins of depth.
        first_bin: highest bits of the near limit.
        base: ``(bins,)`` int32, place of each bin's layer in a storm's flattened codes.
        amplitude: ``(bins,)`` of the storms' optical depth.
        even: ``(bins,)`` optical depth of what is between the layers and rates, without structure.
        level: ``(256,)`` optical depth of each code.
    """

    node: int
    near_m: float
    far_m: float
    first_bin: int
    base: Tensor
    amplitude: Tensor
    even: Tensor
    level: Tensor


def depth_bins(depth_m: Tensor, tables: BankTables) -> Tensor:
    """Number of each depth's bin, int32: the highest bits of the float."""
    held = depth_m.float().clamp(tables.near_m, tables.far_m).contiguous()
    return (held.view(torch.int32) >> BIN_SHIFT).sub_(tables.first_bin)


def encoded(optical: Tensor) -> Tensor:
    """Codes of 8 bits of optical depth."""
    return torch.log1p(optical / FAINT).div_(STEP).round_().clamp_(0, 255).to(torch.uint8)


@lru_cache(maxsize=1)
def decoded_codes() -> Tensor:
    """Optical depth of each code, ``(256,)`` float32."""
    return torch.expm1(torch.arange(256, dtype=torch.float64) * STEP).mul_(FAINT).float()


def between(covered: Any, amplitude: Any) -> Any:
    """Covered share of layers ``(bins, amplitudes)``, as an optical depth, at an amplitude each."""
    nodes = np.asarray(AMPLITUDES)
    cell = np.clip(np.searchsorted(nodes, amplitude, side="right") - 1, 0, len(nodes) - 2)
    share = (amplitude - nodes[cell]) / (nodes[cell + 1] - nodes[cell])
    row = np.arange(len(amplitude))
    return covered[row, cell] * (1 - share) + covered[row, cell + 1] * share


def amplitude_of(deviation: Any, wanted: Any) -> Any:
    """Amplitude at which layers have a standard deviation, the inverse of a rising table ``(bins, amplitudes)``.

    Args:
        deviation: at each of `AMPLITUDES`.
        wanted: ``(bins,)``.
    """
    nodes, row = np.asarray(AMPLITUDES), np.arange(len(wanted))
    cell = np.clip((deviation <= wanted[:, None]).sum(1) - 1, 0, len(nodes) - 2)
    low, high = deviation[row, cell], deviation[row, cell + 1]
    share = np.clip((wanted - low) / np.maximum(high - low, 1e-30), 0.0, 1.0)
    return nodes[cell] + share * (nodes[cell + 1] - nodes[cell])
