"""Phase congruency by compiled loops: the numbers of torch."""

from __future__ import annotations

import pytest
import torch

from torchweather.core import compiled as switch
from torchweather.metrics.fsim import fsim
from torchweather.metrics.phase_congruency import phase_congruency


def by_both(monkeypatch: pytest.MonkeyPatch, image: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
    found = []
    for path in ("1", "0"):
        monkeypatch.setenv(switch.SWITCH, path)
        found.append(phase_congruency(image))
    return found[0], found[1]


@pytest.mark.parametrize("size", [(24, 31), (37, 40), (96, 122)], ids=str)
def test_compiled_loops_give_the_numbers_of_torch(monkeypatch: pytest.MonkeyPatch, size: tuple[int, int]) -> None:
    generator = torch.Generator().manual_seed(size[0])
    noise = torch.rand(2, 1, *size, generator=generator)
    steps = (torch.arange(size[1]) > size[1] // 2).float().expand(1, 1, *size)
    image = torch.cat([255.0 * noise, 200.0 * steps + noise[:1], torch.full((1, 1, *size), 7.0)])
    compiled, by_torch = by_both(monkeypatch, image)
    assert not torch.equal(compiled, by_torch)  # another order of sums: it is the other path
    assert compiled[-1].abs().max() == 0.0  # flat
    # Roundings of float32 in sums of 16 amplitudes, over their sum; found 4e-7.
    torch.testing.assert_close(compiled, by_torch, rtol=0, atol=2e-6)


def test_fsim_by_compiled_loops_is_that_of_torch(monkeypatch: pytest.MonkeyPatch) -> None:
    generator = torch.Generator().manual_seed(3)
    clear = torch.rand(1, 3, 40, 57, generator=generator)
    worse = (clear + 0.1 * torch.rand(1, 3, 40, 57, generator=generator)).clamp(0, 1)
    found = []
    for path in ("1", "0"):
        monkeypatch.setenv(switch.SWITCH, path)
        found.append(float(fsim(worse, clear)))
    assert found[0] == pytest.approx(found[1], abs=1e-6)


def test_gradients_and_double_precision_are_torchs(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(switch.SWITCH, "1")
    image = torch.rand(1, 1, 20, 24, requires_grad=True)
    assert phase_congruency(image).requires_grad
    double = torch.rand(1, 1, 20, 24, dtype=torch.float64)
    compiled, by_torch = by_both(monkeypatch, double)
    assert torch.equal(compiled, by_torch)
