"""Levels of the converter: the nearest one, within 0..1; none asked for, nothing done."""

from __future__ import annotations

import torch

from torchweather.camera.state import CameraState
from torchweather.stages import Quantise


def test_a_signal_goes_to_the_nearest_of_its_levels() -> None:
    signal = torch.tensor([-0.2, 0.1, 0.13, 0.37, 0.38, 0.6, 1.3, 0.0]).reshape(1, 1, 2, 4)
    depth_m, cells = torch.ones(1, 1, 2, 4), torch.tensor([[0, 1], [1, 2]])
    rays, intrinsics = torch.ones(1, 1, 2, 4), torch.tensor([[10.0, 10.0, 1.5, 0.5]])
    state = CameraState.of(signal=signal, depth_m=depth_m, ray_per_depth=rays, cfa_index=cells, intrinsics=intrinsics)
    rounded = Quantise(4)(state, {}).image.signal.flatten()
    assert rounded.tolist() == [0.0, 0.0, 0.25, 0.25, 0.5, 0.5, 1.0, 0.0]
    assert Quantise(0)(state, {}) is state
