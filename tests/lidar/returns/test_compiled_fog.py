"""Tables of fog's return by compiled loops: those of torch, to its own rounding."""

from __future__ import annotations

import pytest
import torch

import torchweather as tw
from torchweather.core import compiled as switch
from torchweather.lidar.returns.soft_return import SoftReturn
from torchweather.lidar.stages import ParticleReturns


@pytest.fixture(autouse=True)
def _compiled(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(switch.SWITCH, "1")


@pytest.mark.parametrize("receiver", ["gate", "matched"])
@pytest.mark.parametrize("mor_m", [20.0, 90.0, 500.0, 5000.0])
def test_tables_of_fog_are_those_of_torch(receiver: str, mor_m: float) -> None:
    transform = tw.LidarFog(tw.Fog(mor_m), tw.Lidar.preset("ouster-os1-128"), receiver=receiver)
    returns = transform._stage(ParticleReturns)
    fog = returns.kinds["fog"]
    assert isinstance(fog, SoftReturn)
    for own, other in zip(
        fog.compiled_tables(returns.beam, transform.extinction_per_m),
        fog.tables(returns.beam, transform.extinction_per_m),
        strict=True,
    ):
        # Photons are sums of 32 numbers, to 32 roundings of 6e-8; a reading is exceeded as some 50th power of them.
        torch.testing.assert_close(own, other, rtol=1e-4, atol=1e-6)
