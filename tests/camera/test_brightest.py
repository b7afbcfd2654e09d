"""The brightest neighbourhood of a mosaic in bands against one pooling of each phase."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import pytest
import torch

from torchweather.camera.airlight import _brightest, _brightest_of
from torchweather.core.compiled import SWITCH


@pytest.mark.parametrize("compiled", ["0", "1"])
@pytest.mark.parametrize("size", [(6, 40), (8, 8), (10, 12), (66, 70), (132, 90), (200, 130)])
@pytest.mark.parametrize("place", ["anywhere", "top", "left", "bottom", "right"])
def test_it_is_that_of_the_pooled_phases(
    size: tuple[int, int], place: str, compiled: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv(SWITCH, compiled)
    signal = torch.rand(2, 1, *size, generator=torch.Generator().manual_seed(sum(size)))
    edges: dict[str, Any] = {
        "top": (slice(0, 2), slice(None)),
        "left": (slice(None), slice(0, 2)),
        "bottom": (slice(-2, None), slice(None)),
        "right": (slice(None), slice(-2, None)),
    }
    if place in edges:
        signal[0, 0, *edges[place]] += 1.0
    state: Any = SimpleNamespace(image=SimpleNamespace(signal=signal))
    # Nine numbers add up in another order: two steps of float32.
    torch.testing.assert_close(_brightest(state), _brightest_of(signal), rtol=2.5e-7, atol=0)
