"""Detection and reading by compiled loops beside other stages: the numbers of torch."""

from __future__ import annotations

from typing import Any

import pytest
import torch
from torch import Tensor

import torchweather as tw
from tests.lidar.test_compiled_beams import MODES, OF_INTENSITY, OF_RANGE_M, UNITS, cloud_of, sensor_of
from torchweather.core import compiled as switch
from torchweather.lidar import stages
from torchweather.lidar.state import LidarState

BATCH, ECHOES = 2, 4


def state_of(sensor: tw.Lidar, unit: str, whole: bool) -> tuple[LidarState, dict[str, Any]]:
    """Beams with echoes at random: below and above the threshold, close together, equally strong, near objects."""
    transform = tw.LidarRain(tw.Rain(20.0), sensor)
    cloud, along = cloud_of(unit, whole=whole)
    points = torch.stack([cloud, cloud.flip(0)])
    state = transform.state_of(points, torch.stack([along, along.flip(0)]))
    chain = transform.chain.stages
    state = chain["to_energy"](state, chain["to_energy"].draw(state, seed=torch.tensor([1, 2]), name="to_energy"))
    random = torch.Generator().manual_seed(3)
    beams = state.scene.clear_range_m.shape[1]
    where = torch.rand(BATCH, beams, ECHOES, generator=random)
    own_m = torch.where(state.scene.clear_range_m > 0, state.scene.clear_range_m, 50.0)[..., None]
    range_m = torch.cat([state.scene.clear_range_m[..., None], own_m * where[..., 1:]], -1)
    # Levels in steps, so that echoes are equally strong.
    level = torch.randint(0, 8, where.shape, generator=random) * 0.4
    signal = state.receiver.threshold * level
    signal[..., 0] *= (state.scene.clear_signal > 0) * 3.0
    kind = torch.full(where.shape, stages.PARTICLE, dtype=torch.int8)
    kind[..., 0] = torch.where(signal[..., 0] > 0, stages.OBJECT, stages.LOST)
    scale = torch.tensor([1.0, 1.7])
    state = state.changed(range_m=range_m, signal=signal, kind=kind, threshold_scale=scale)
    return state, chain


def of_both(monkeypatch: pytest.MonkeyPatch, call: Any) -> tuple[Any, Any]:
    """Answers of torch and of compiled loops."""
    found = []
    for on in ("0", "1"):
        monkeypatch.setenv(switch.SWITCH, on)
        found.append(call())
    return found[0], found[1]


@pytest.mark.parametrize("mode", MODES)
def test_detected_echoes_are_those_of_torch_bit_for_bit(monkeypatch: pytest.MonkeyPatch, mode: str) -> None:
    state, chain = state_of(sensor_of(return_mode=mode), "reflectivity", False)
    slow, fast = of_both(monkeypatch, lambda: chain["detection"](state, {}).returns)
    for name in ("range_m", "signal", "kind"):
        assert torch.equal(getattr(slow, name), getattr(fast, name)), name
    # Everything that there is to choose between came up.
    assert {int(kind) for kind in fast.kind[..., 0].unique()} == {stages.OBJECT, stages.PARTICLE, stages.LOST}


@pytest.mark.parametrize("whole", [False, True])
@pytest.mark.parametrize("unit", UNITS)
def test_readings_are_those_of_torch_to_rounding(monkeypatch: pytest.MonkeyPatch, unit: str, whole: bool) -> None:
    sensor = sensor_of(intensity_unit=unit, range_resolution_m=0.02, return_mode="dual")
    state, chain = state_of(sensor, unit, whole)
    state = chain["detection"](state, {})
    noise: dict[str, Tensor] = {"range_noise": torch.randn(BATCH, 2, state.scene.clear_range_m.shape[1])}
    for echo in range(2):
        slow, fast = of_both(monkeypatch, lambda echo=echo: chain["to_points"].measurement(state, noise, echo))
        # Half a step of the resolution rounds either way where the last bit differs.
        step_m = (slow[0] - fast[0]).abs()
        assert bool((step_m <= OF_RANGE_M + 0.02 * (step_m > 0.01)).all())
        assert float((step_m > 0.01).float().mean()) < 1e-3
        same = step_m < 0.01
        apart = (slow[1] - fast[1]).abs()
        # A whole number, too, where what is rounded down differs by its last bit.
        is_step = whole & (apart > 0.5) & (apart < 1.5)
        assert bool(((apart <= OF_INTENSITY * slow[1].abs() + 1e-6) | is_step | ~same).all())
        assert float(is_step.float().mean()) < 1e-3


def test_speeds_and_gradients_stay_with_torch(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(switch.SWITCH, "1")
    state, chain = state_of(sensor_of(), "reflectivity", False)
    learning = state.returns.signal.clone().requires_grad_()
    assert chain["detection"](state.changed(signal=learning), {}).returns.signal.requires_grad
    speed = torch.arange(float(state.returns.signal.numel())).reshape(state.returns.signal.shape)
    found = chain["detection"](state.changed(echo_speed_m_per_s=speed), {}).returns
    assert found.echo_speed_m_per_s is not None
    assert found.echo_speed_m_per_s.shape == found.signal.shape
