"""Range and intensity without points, and one table of returns for samples in the same weather."""

from __future__ import annotations

from typing import Any

import pytest
import torch
from torch import Tensor

from tests.lidar.effects.effect_scene import begin, cloud, directions, own_noise, rain, scan_sensor, states
from torchweather.atmosphere.weather import Fog, Mixture, Rain, Snow
from torchweather.lidar.returns.strongest import ReturnTable
from torchweather.sensors import RETURN_MODES
from torchweather.stages import LidarState, ParticleReturns, ToPoints
from torchweather.transforms import LidarFog, LidarRain, LidarSnow, LidarWeather

UNITS = ("reflectivity", "reflectivity_percent", "uint8_linear", "photons")
SCALES = {"reflectivity": 1.0, "reflectivity_percent": 100.0, "uint8_linear": 255.0, "photons": 300.0}


# ---- measurement -----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("mode", RETURN_MODES)
@pytest.mark.parametrize("unit", UNITS)
def test_a_measurement_is_the_norm_and_the_intensity_of_the_points(unit: str, mode: str) -> None:
    sensor = scan_sensor(intensity_unit=unit, return_mode=mode, range_noise_m=0.03, range_resolution_m=0.01)
    transform = LidarRain(Rain(50.0), sensor)
    points = cloud(2)
    points[..., 3] *= SCALES[unit]
    if unit == "uint8_linear":
        points[0, :, 3] = points[0, :, 3].round()  # whole numbers stay whole
    state = transform.state_of(points, directions())
    noise = transform.chain.draw(state, seed=torch.tensor([3, 4]))
    before = states(transform.chain, state, noise)["detection"]
    last = transform.chain.stages["to_points"]
    assert isinstance(last, ToPoints)
    own = own_noise(noise, "to_points")
    out = last(before, own)
    clouds = [out.returns.points] if out.returns.second is None else [out.returns.points, out.returns.second]
    assert len(clouds) == (2 if mode == "dual" else 1)
    for echo, each in enumerate(clouds):
        range_m, intensity = last.measurement(before, own, echo)
        there = before.returns.kind[..., echo] != 2
        assert bool(there.any())
        assert bool((~there).any())
        # Three coordinates in single precision, squared and added.
        torch.testing.assert_close(range_m[there], each[..., :3].norm(dim=-1)[there], rtol=3e-6, atol=0.0)
        assert torch.equal(intensity[there], each[..., 3][there])
        assert bool((range_m[~there] == 0).all())
        assert bool((intensity[~there] == 0).all())


def test_a_lost_echo_has_no_range_and_no_intensity_whatever_it_had() -> None:
    transform = rain()
    state = begin(transform)
    before = states(transform.chain, state, transform.chain.draw(state, seed=1))["detection"]
    gone = before.changed(kind=torch.full_like(before.returns.kind, 2))
    last = transform.chain.stages["to_points"]
    assert isinstance(last, ToPoints)
    for values in last.measurement(gone, {}):
        assert bool((values == 0).all())


def test_what_no_stage_touched_has_the_bits_that_came_in() -> None:
    transform = LidarRain(Rain(0.0), scan_sensor())
    state = begin(transform)
    noise = transform.chain.draw(state, seed=1)
    before = states(transform.chain, state, noise)["detection"]
    last = transform.chain.stages["to_points"]
    assert isinstance(last, ToPoints)
    range_m, intensity = last.measurement(before, own_noise(noise, "to_points"))
    assert torch.equal(range_m, state.scene.clear_range_m)
    assert torch.equal(intensity, state.scene.points_in[..., 3])


# ---- one table for all samples ---------------------------------------------------------------------------------------

WEATHERS = {
    "rain": lambda: LidarRain(Rain(50.0), scan_sensor()),
    "snow": lambda: LidarSnow(Snow(3.0), scan_sensor()),
    "fog": lambda: LidarFog(Fog(mor_m=40.0), scan_sensor()),
    "all": lambda: LidarWeather(Mixture(Rain(10.0), Fog(mor_m=80.0)), scan_sensor()),
}
BATCH = 3


def out_of(transform: LidarWeather, state: LidarState, noise: dict[str, Tensor]) -> LidarState:
    with torch.no_grad():
        found: LidarState = transform.chain(state, noise)
    return found


def sample(state: LidarState, place: int) -> LidarState:
    """One of a batch."""
    values: dict[str, Any] = {name: state.field(name) for name in LidarState.part_of}
    for name, value in values.items():
        if isinstance(value, Tensor) and value.ndim and value.shape[0] == BATCH:
            values[name] = value[place : place + 1]
    return LidarState.of(**values)


@pytest.mark.parametrize("kind", WEATHERS)
def test_a_batch_in_one_weather_is_its_samples_one_by_one(kind: str, monkeypatch: pytest.MonkeyPatch) -> None:
    solved: list[int] = []
    of = ReturnTable.of.__func__  # type: ignore[attr-defined]

    def counted(cls: type[ReturnTable], between: Tensor, places_of: Tensor | None) -> ReturnTable:
        solved.append(len(between))
        found: ReturnTable = of(cls, between, places_of)
        return found

    monkeypatch.setattr(ReturnTable, "of", classmethod(counted))
    together = WEATHERS[kind]()
    state = begin(together, BATCH)
    noise = together.chain.draw(state, seed=torch.tensor([5, 6, 7]))
    found = out_of(together, state, noise).returns.points
    assert found is not None
    tables = 2 if kind == "all" else 1
    assert solved == [1] * tables  # one sample's, whatever the batch
    alone = WEATHERS[kind]()
    for place in range(BATCH):
        own = {name: value[place : place + 1] for name, value in noise.items()}
        one = out_of(alone, sample(state, place), own).returns.points
        assert one is not None
        assert torch.equal(one[0], found[place])
    # The same stages serve another number of samples afterwards.
    two = out_of(together, sample(state, 1), {name: value[1:2] for name, value in noise.items()}).returns.points
    assert two is not None
    assert torch.equal(two[0], found[1])


def test_samples_in_different_weather_have_tables_of_their_own() -> None:
    rates = torch.tensor([5.0, 50.0, 50.0])
    together = LidarRain(Rain(rates), scan_sensor())
    state = begin(together, BATCH)
    noise = together.chain.draw(state, seed=torch.tensor([5, 6, 7]))
    found = out_of(together, state, noise).returns.points
    assert found is not None
    for place, rate in enumerate(rates.tolist()):
        own = {name: value[place : place + 1] for name, value in noise.items()}
        one = out_of(LidarRain(Rain(rate), scan_sensor()), sample(state, place), own).returns.points
        assert one is not None
        assert torch.equal(one[0], found[place])


def test_a_shared_table_is_not_used_for_another_weather() -> None:
    transform = rain()
    state = begin(transform, BATCH)
    noise = transform.chain.draw(state, seed=torch.tensor([5, 6, 7]))
    before = out_of(transform, state, noise).returns.points
    stage = transform.chain.stages["particle_returns"]
    assert isinstance(stage, ParticleReturns)
    part: Any = stage.kinds["rain"]
    part.rate_mm_per_h = part.rate_mm_per_h * 3.0
    after = out_of(transform, state, noise).returns.points
    assert before is not None
    assert after is not None
    assert not torch.equal(before, after)
