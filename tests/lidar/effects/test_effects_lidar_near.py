"""The near-range response to particles, against sensors that have it themselves."""

from __future__ import annotations

from dataclasses import replace

import pytest
import torch
from torch import Tensor

from tests.lidar.effects.effect_scene import begin, scan_sensor, states
from torchweather.atmosphere.weather import Fog, Rain, Snow, Weather
from torchweather.core.errors import InputValueError
from torchweather.sensors import Lidar
from torchweather.stages import EFFECTS, Effect, LidarState, with_effects
from torchweather.transforms import LidarWeather

FULL_M = 12.0
SAMPLES = 3


def sensor_of(power: float) -> Lidar:
    return replace(scan_sensor(), near_start_m=0.0, near_full_m=FULL_M, near_power=power)


def echoes(
    weather: Weather, power: float, extra: Tensor | None, effects: tuple[Effect, ...] = ()
) -> tuple[Tensor, Tensor]:
    """Range and signal of the particles, ``(B, N)``, of a sensor with a power of its own and an effect's power."""
    transform = LidarWeather(weather, sensor_of(power))
    added = list(effects)
    if extra is not None:
        added.append(EFFECTS["lidar.near_response"](full_m=FULL_M, power=extra))
    chain = with_effects(transform.chain, added)
    state = begin(transform, SAMPLES)
    noise = chain.draw(state, seed=3)
    behind: LidarState = states(chain, state, noise)["particle_returns"]
    return behind.returns.range_m[..., 1], behind.returns.signal[..., 1]


@pytest.mark.parametrize(
    ("weather", "signal_error"),
    # The nodes of the signal are those of the sensor's own response: 2.4 % apart in rain and snow, and in fog, as the
    # root of the photons, up to a tenth.
    [(Rain(25.0), 0.005), (Snow(2.0), 0.005), (Fog(100.0), 0.1)],
    ids=["rain", "snow", "fog"],
)
def test_a_response_of_the_effect_is_one_of_the_sensor(weather: Weather, signal_error: float) -> None:
    """``(R / full)^1.5`` over ``R / full`` is ``(R / full)^2.5``: the same particles are seen, equally bright."""
    range_m, signal = echoes(weather, 1.0, torch.tensor(1.5))
    own_range_m, own_signal = echoes(weather, 2.5, None)
    seen, own_seen = signal > 0, own_signal > 0
    # Of 1,536 beams, those whose particle stands at the edge of the table.
    assert int((seen != own_seen).sum()) <= 5
    both = seen & own_seen
    assert int(both.sum()) > 1000
    ratio = (signal[both] / own_signal[both]).log()
    assert abs(float(ratio.mean())) < signal_error
    # Between two nodes of the signal the place is drawn: the ranges scatter, and lie at no other place in the mean.
    apart = range_m[both] - own_range_m[both]
    assert abs(float(apart.mean())) < 5.0 * float(apart.std()) / float(both.sum()) ** 0.5 + 0.01


def test_each_sample_has_a_response_of_its_own() -> None:
    together = echoes(Rain(25.0), 1.0, torch.tensor([0.0, 1.0, 3.0]))[1]
    for sample, power in enumerate((0.0, 1.0, 3.0)):
        alone = echoes(Rain(25.0), 1.0, torch.tensor(power))[1]
        torch.testing.assert_close(together[sample], alone[sample], rtol=1e-5, atol=0.0)


def test_far_particles_stay_and_near_ones_fade() -> None:
    range_m, signal = echoes(Snow(2.0), 1.0, None)
    faded_m, faded = echoes(Snow(2.0), 1.0, torch.tensor(3.0))
    # Signals before the threshold: every beam has its strongest particle, which now lies farther away.
    assert float(faded_m[faded > 0].median()) > float(range_m[signal > 0].median()) + 1.0
    assert (faded <= signal * (1 + 1e-5)).all()


def test_patches_see_the_same_response() -> None:
    """Patches that are all alike change nothing but the table that is looked up."""
    nearly_even = EFFECTS["lidar.patchy_weather"](log_std=1e-6)
    plain = echoes(Rain(25.0), 1.0, torch.tensor([0.5, 1.0, 2.0]))[1]
    patched = echoes(Rain(25.0), 1.0, torch.tensor([0.5, 1.0, 2.0]), (nearly_even,))[1]
    torch.testing.assert_close(plain, patched, rtol=1e-4, atol=0.0)


def test_two_responses_in_a_chain_are_refused() -> None:
    transform = LidarWeather(Rain(25.0), sensor_of(1.0))
    one = EFFECTS["lidar.near_response"](power=1.0)
    state = begin(transform, SAMPLES)
    with pytest.raises(InputValueError, match="expected one near-range response in a chain"):
        one(one(state, {}), {})
