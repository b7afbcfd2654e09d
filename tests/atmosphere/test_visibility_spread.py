"""Snow of other visibility at one rate: number times a factor, fall speed over it, for every sensor."""

from __future__ import annotations

import json

import numpy as np
import pytest
import torch

import torchweather as tw
from torchweather.atmosphere.weather import parse_weather, weather_from_dict
from torchweather.explain import explain
from torchweather.physics import Binned, extinction_per_m
from torchweather.radar.attenuation import weather_attenuation_db_per_km
from torchweather.radar.clutter import FallingReflectivity

CAMERA = tw.Camera.from_intrinsics(50.0, 50.0, 15.5, 11.5, 32, 24)
LIDAR = tw.Lidar(905.0, elevations_deg=(-2.0, 2.0), columns=4, intensity_unit="reflectivity")
RADAR = tw.Radar.preset("awr1843-like")
BINS = Binned([0.5, 1.0, 2.0], [200.0, 20.0], particle="flake")


def snow(factor: float, rate: float = 2.0, **values: object) -> tw.Snow:
    return tw.Snow(rate, visibility_spread=factor, **values)  # type: ignore[arg-type]


@pytest.mark.parametrize("factor", [0.3, 3.0])
@pytest.mark.parametrize("law", ["sekhon-srivastava", "gunn-marshall", BINS])
def test_extinction_is_multiplied_and_the_carried_rate_stays(factor: float, law: object) -> None:
    typical, other = (explain(snow(k, size_distribution=law), tw.Lidar.preset("velodyne-hdl-64e")) for k in (1, factor))
    assert typical["mor_m"] / other["mor_m"] == pytest.approx(factor, rel=1e-6)
    (before,), (after,) = typical["parts"], other["parts"]
    assert after["rate_carried_mm_per_h"] == pytest.approx(before["rate_carried_mm_per_h"], rel=1e-6)
    assert after["particles_per_m3"] == pytest.approx(factor * before["particles_per_m3"], rel=1e-6)


def test_as_much_water_reaches_the_ground() -> None:
    """Flakes of a column that reach the ground within 10 s, counted one by one."""
    rng, area_m2, height_m, seconds = np.random.default_rng(0), 40.0, 120.0, 10.0
    diameter = torch.linspace(0.2, 6.0, 400, dtype=torch.float64)
    mm_per_h, scatter = [], []
    for factor in (1.0, 3.0, 0.3):
        weather = snow(factor)
        per_bin = weather.distribution().number_density_per_m3_mm(diameter).numpy() * float(diameter[1] - diameter[0])
        number = rng.poisson(per_bin * area_m2 * height_m)
        size = np.repeat(diameter.numpy(), number)
        speed = weather.fall_speed_m_per_s(torch.from_numpy(size)).numpy()
        assert speed.max() * seconds < height_m
        water_mm3 = np.pi / 6.0 * size[rng.uniform(0.0, height_m, size.size) < speed * seconds] ** 3
        mm_per_h.append(1e-6 * water_mm3.sum() / area_m2 * 3600.0 / seconds)
        scatter.append(1e-6 * np.sqrt((water_mm3**2).sum()) / area_m2 * 3600.0 / seconds)
    for rate, sd in zip(mm_per_h[1:], scatter[1:], strict=True):
        assert abs(rate - mm_per_h[0]) < 4.0 * np.hypot(sd, scatter[0])


def test_every_sensor_loses_as_much_more() -> None:
    depth, lost = [], []
    for factor in (1.0, 3.0):
        camera = tw.BayerSnow(snow(factor), CAMERA, depth=60.0, airlight=0.8)
        mask = camera.run(torch.full((16, 1, 24, 32), 0.3), seed=1).particle_mask
        assert mask is not None
        depth.append(float(-(1.0 - mask).log().mean()))
        points = torch.tensor([[30.0, 0.0, 0.0, 0.5]])
        lost.append(-float(tw.LidarSnow(snow(factor), LIDAR).run(points, seed=1).transmission.log().mean()))
    assert lost[1] / lost[0] == pytest.approx(3.0, rel=1e-3)
    # Flakes near the camera are few, and the same draw shows more of them.
    assert depth[1] / depth[0] == pytest.approx(3.0, rel=0.05)
    for model in ("dsd_mie", "d3_4"):
        typical, other = (float(weather_attenuation_db_per_km(snow(k), RADAR, model)) for k in (1.0, 3.0))
        assert other / typical == pytest.approx(3.0, rel=1e-6)
    typical, other = (torch.stack(FallingReflectivity(snow(k), 77.0)(1)) for k in (1.0, 3.0))
    torch.testing.assert_close(other / typical, torch.tensor([[3.0], [1 / 3], [1 / 3]]), rtol=1e-3, atol=0)


def test_by_default_nothing_changes() -> None:
    shares = torch.rand(40, 4, generator=torch.Generator().manual_seed(1))
    points = shares * torch.tensor([40.0, 5.0, 0.1, 1.0]) + torch.tensor([5.0, 0.0, 0.0, 0.0])
    first, second = (tw.LidarSnow(one, LIDAR).run(points, seed=2).points for one in (tw.Snow(2.0), snow(1.0)))
    assert torch.equal(first, second)
    assert tw.Snow(2.0) == snow(1.0)
    assert "visibility_spread" not in tw.Snow(2.0).to_dict()  # hashes of studies and records stay


def test_it_is_written_read_and_drawn() -> None:
    drawn = tw.Snow((0.5, 2.0), visibility_spread=tw.LogUniform(0.3, 3.0))
    assert weather_from_dict(json.loads(json.dumps(drawn.to_dict()))) == drawn
    assert weather_from_dict({"kind": "snow", "rate_mm_per_h": 1.0}) == tw.Snow(1.0)
    assert parse_weather("snow:rate=1,visibility_spread=2") == snow(2.0, 1.0)
    found = [drawn.drawn(seed) for seed in range(40)]
    factors = sorted(float(one.visibility_spread) for one in found)  # type: ignore[attr-defined]
    assert 0.3 <= factors[0] < 0.6
    assert 1.5 < factors[-1] <= 3.0
    assert drawn.densest().visibility_spread == 3.0  # type: ignore[attr-defined]
    mixture = tw.Mixture(drawn, tw.Fog(mor_m=200.0)).drawn(3)
    assert float(mixture.parts[1].visibility_spread) != 1.0  # type: ignore[attr-defined]
    clouds = torch.tensor([[[30.0, 0.0, 0.0, 0.5]]]).expand(2, 1, 4)
    losses = tw.LidarSnow(drawn, LIDAR).run(clouds, seed=3).transmission
    assert float(losses[0]) != float(losses[1])


@pytest.mark.parametrize("value", [0.29, 3.1, float("nan"), "much"])
def test_other_factors_are_refused(value: object) -> None:
    with pytest.raises((ValueError, TypeError), match="visibility_spread"):
        tw.Snow(1.0, visibility_spread=value)  # type: ignore[arg-type]


def test_the_range_spans_the_published_tenfold_visibility() -> None:
    ends = [float(extinction_per_m(snow(k).distribution(), 550.0)) for k in (0.3, 3.0)]
    assert ends[1] / ends[0] == pytest.approx(10.0)
