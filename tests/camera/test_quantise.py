"""Levels of the converter: the nearest one, within 0..1; none asked for, nothing done."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from torchweather.stages import Quantise


@dataclass(frozen=True)
class OfSignal:
    signal: Tensor


def test_a_signal_goes_to_the_nearest_of_its_levels() -> None:
    state = OfSignal(torch.tensor([-0.2, 0.1, 0.13, 0.37, 0.38, 0.6, 1.3]))
    assert Quantise(4)(state, {}).signal.tolist() == [0.0, 0.0, 0.25, 0.25, 0.5, 0.5, 1.0]
    assert Quantise(0)(state, {}) is state
