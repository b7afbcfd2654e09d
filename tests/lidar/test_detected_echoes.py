"""Echoes that no stage looks at are left out, and what comes out stays bit for bit that of the whole chain."""

from __future__ import annotations

from typing import Any

import pytest
import torch
from torch import Tensor

import torchweather as tw
from torchweather.atmosphere.weather import Fog, Mixture, Rain, Snow, Weather
from torchweather.core.compiled import SWITCH
from torchweather.lidar.returns.strongest import ARRIVAL_HIGH, ARRIVAL_LOW, ARRIVAL_NODES, ReturnTable, _signal
from torchweather.lidar.stages import Detection, ParticleReturns, _Echoes
from torchweather.lidar.state import LidarState
from torchweather.sensors import RETURN_MODES, Lidar
from torchweather.transforms import LidarWeather


@pytest.fixture(autouse=True)
def _by_torch(monkeypatch: pytest.MonkeyPatch) -> None:
    """Compiled loops equal the chain to rounding only."""
    monkeypatch.setenv(SWITCH, "0")


WEATHERS: dict[str, Weather] = {
    "rain": Rain(40.0),
    "snow": Snow(3.0),
    "fog": Fog(mor_m=60.0),
    "mixture": Mixture(Snow(1.0), Fog(mor_m=200.0)),
    "batch": Snow(torch.tensor([0.3, 0.0, 4.0])),
    "gusts": Snow(2.0, patch_log_std=1.0),
}
CASES = [
    ("rain", "strongest"),
    *(("snow", mode) for mode in RETURN_MODES),
    *((name, "dual") for name in WEATHERS if name != "snow"),
]


def cloud(beams: int = 1500) -> Tensor:
    generator = torch.Generator().manual_seed(2)
    along = torch.nn.functional.normalize(torch.randn(beams, 3, generator=generator), dim=-1)
    range_m = 3.0 + 60.0 * torch.rand(beams, 1, generator=generator)
    return torch.cat([along * range_m, torch.rand(beams, 1, generator=generator)], -1)


def all_echoes(transform: LidarWeather, points: Tensor, noise: Any) -> LidarState:
    """The chain as it stands, every echo of every beam drawn and compared."""
    state = transform.state_of(points)
    flat = transform._flat_noise(noise, state, points.shape[:-2])
    for name, stage in transform.chain.stages.items():
        state = stage(state, transform.chain.noise_of(name, flat))
        if isinstance(stage, ParticleReturns):
            drawn = state
        if isinstance(stage, Detection):  # chosen among all beams
            echoes = [_echo(drawn, k) for k in range(drawn.returns.range_m.shape[-1])]
            chosen = stage._chosen(echoes, drawn.detected_from, drawn.scene.clear_range_m)
            parts = [torch.stack(values, -1) for values in zip(*(one.parts for one in chosen), strict=True)]
            state = drawn.changed(range_m=parts[0], signal=parts[1], kind=parts[2])
    return state


def _echo(state: LidarState, echo: int) -> Any:
    returns = state.returns
    return _Echoes(returns.range_m[..., echo], returns.signal[..., echo], returns.kind[..., echo])


@pytest.mark.parametrize(("name", "mode"), CASES)
def test_what_comes_out_is_that_of_all_echoes(name: str, mode: str) -> None:
    sensor = Lidar.preset(
        "ouster-os1-128", return_mode=mode, intensity_unit="reflectivity", origin_heights_m=None
    ).with_hahner_overlap()
    transform = LidarWeather(WEATHERS[name], sensor)
    points = cloud()
    points = points.expand(3, *points.shape) if name == "batch" else points
    noise = transform.draw(points, seed=4)
    found, wanted = transform.run(points, noise), all_echoes(transform, points, noise)
    assert wanted.returns.points is not None
    assert isinstance(found.points, Tensor)
    assert isinstance(found.kind, Tensor)
    assert torch.equal(found.points, wanted.returns.points.reshape(found.points.shape))
    assert torch.equal(found.kind, wanted.returns.kind[..., 0].reshape(found.kind.shape))
    assert bool((found.kind == 1).any())
    if mode == "dual":
        assert wanted.returns.second is not None
        assert isinstance(found.second, Tensor)
        assert torch.equal(found.second, wanted.returns.second.reshape(found.second.shape))
        assert bool((found.second_kind != 2).any())  # type: ignore[union-attr]


# Each changes signals or thresholds after the particles are drawn, by itself and by the hand of another.
OF_SIGNALS: tuple[tuple[dict[str, Any], ...], ...] = (
    ({"effect": "lidar.threshold_shift", "shift_db": -6.0},),
    ({"effect": "lidar.particle_backscatter", "gain_db": 8.0},),
    (
        {"effect": "lidar.particle_backscatter", "gain_db": 4.0},
        {"effect": "lidar.threshold_shift", "shift_db": -4.0},
    ),
    (
        {"effect": "lidar.window_loss", "loss_db": 3.0},
        {"effect": "lidar.spray", "strength": 0.5},
        {"effect": "lidar.last_return", "probability": 0.5},
    ),
    ({"effect": "lidar.blind_zone", "range_m": 4.0}, {"effect": "lidar.sector_loss", "loss_db": 5.0}),
    ({"effect": "lidar.ring_gain", "db_per_ring": 0.5},),
    ({"effect": "lidar.shared_particles", "share": 0.5},),
    # The denser the air of a beam, the earlier its particles arrive.
    ({"effect": "lidar.particle_density_azimuth", "amplitude": 15.0, "width_rad": 2.0},),
)


@pytest.mark.parametrize("compiled", ["0", "1"])
@pytest.mark.parametrize("effects", OF_SIGNALS, ids=lambda one: "+".join(own["effect"] for own in one))
def test_effects_on_signals_see_every_echo_that_they_may_raise(
    effects: tuple[dict[str, Any], ...], compiled: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv(SWITCH, compiled)
    scan: dict[str, Any] = {"elevations_deg": [float(one) for one in range(-15, 17, 2)], "columns": 96}
    scan |= {"origin_heights_m": None, "azimuth_offsets_deg": None}
    sensor = Lidar.preset("ouster-os1-128", return_mode="first", intensity_unit="reflectivity", **scan)
    transform = LidarWeather(Snow(3.0), sensor, effects=effects, beam_ends="max_range")
    points = cloud(16 * 96)
    noise = transform.draw(points, seed=4)
    found = transform.run(points, noise)
    state = transform.state_of(points)
    wanted = transform.chain(state, transform._flat_noise(noise, state, points.shape[:-2]))
    assert isinstance(found.points, Tensor)
    assert isinstance(found.kind, Tensor)
    assert wanted.returns.points is not None
    assert int((found.kind == int(tw.PointKind.PARTICLE)).sum()) > 50
    assert torch.equal(found.points, wanted.returns.points.reshape(found.points.shape))
    assert torch.equal(found.kind, wanted.returns.kind[..., 0].reshape(found.kind.shape))


def test_a_stage_that_looks_at_faint_echoes_gets_them() -> None:
    class Sensitive(Detection):
        """Sees echoes of 0.002 of the threshold."""

        def forward(self, state: LidarState, noise: Any) -> LidarState:
            return super().forward(state.changed(threshold=0.002 * state.receiver.threshold), noise)

    points, sensor = cloud(), Lidar.preset("ouster-os1-128", intensity_unit="reflectivity", return_mode="first")
    transform = LidarWeather(Rain(20.0), sensor)
    noise = transform.draw(points, seed=4)
    plain = int((transform.run(points, noise).kind == 1).sum())
    transform.chain._stages["detection"] = Sensitive(sensor)
    assert int((transform.run(points, noise).kind == 1).sum()) > 10 * plain + 10


@pytest.mark.parametrize("weather", [Rain(10.0), Snow(1.0), Fog(mor_m=80.0)], ids=lambda one: one.kind)
def test_signals_on_the_nodes_are_those_of_the_bisection(weather: Weather) -> None:
    transform = LidarWeather(weather, Lidar.preset("velodyne-hdl-64e"))
    returns = transform._stage(ParticleReturns)
    part = returns.kinds[weather.kind]
    between, _ = part.tables(returns.beam, transform.extinction_per_m)
    places = between.shape[-1]
    step = torch.log(torch.tensor(ARRIVAL_HIGH / ARRIVAL_LOW).double()) / (ARRIVAL_NODES - 1)
    arrivals = ARRIVAL_LOW * torch.exp(step * torch.arange(ARRIVAL_NODES)).float()
    reach = torch.arange(places).float()[:, None].expand(places, ARRIVAL_NODES).reshape(1, -1)
    wanted = _signal(between, arrivals.repeat(places)[None], reach)
    # The arrivals above are rounded otherwise: 1e-7 of a logarithm, over the flattest cell 1e-6.
    apart = (ReturnTable.of(between).signal - wanted).abs()
    assert float(apart.quantile(0.99)) < 1e-4
    assert float((apart > 1e-2).float().mean()) < 1e-3
