"""A frame in which nothing is detected."""

from __future__ import annotations

import torch

import torchweather as tw
from torchweather.radar import FmcwRadar


def test_a_frame_without_detections_gives_an_empty_list() -> None:
    radar = tw.Radar.preset("awr1843-like", samples=64, chirps=32)
    result = FmcwRadar(radar).process(torch.zeros(12, 32, 64, dtype=torch.complex64))
    shapes = [value.shape for value in (result.points, result.snr_db, result.cell) if isinstance(value, torch.Tensor)]
    assert shapes == [(0, 6), (0,), (0, 2)]
