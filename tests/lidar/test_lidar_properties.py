"""What holds of any cloud in any weather: more weather is never brighter, labels tell the truth.

Examples are few because each builds a weather's tables anew.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import hypothesis.strategies as st
import pytest
import torch
from hypothesis import Phase, given, settings
from torch import Tensor

from torchweather.atmosphere.weather import Fog, Mixture, Rain, Snow, Weather
from torchweather.physics import Binned
from torchweather.sensors import RETURN_MODES, Lidar
from torchweather.stages import PointKind
from torchweather.transforms import LidarWeather

N = 1500
SENSOR = Lidar(wavelength_nm=905.0, intensity_unit="reflectivity")
SENSORS = {"default": SENSOR, "overlap from 0.9 m": SENSOR.with_hahner_overlap()}
KINDS: dict[str, type[Any]] = {"rain": Rain, "snow": Snow, "fog": Fog}
# From nothing to the most that the size distributions were fitted to.
RATES = {"rain": (0.1, 200.0), "snow": (0.05, 10.0)}
quick = settings(max_examples=12, deadline=None, derandomize=True, phases=[Phase.explicit, Phase.generate])

seeds = st.integers(0, 2**63 - 1)
modes = st.sampled_from(RETURN_MODES)
sensors = st.sampled_from(sorted(SENSORS))
units = st.sampled_from(["reflectivity", "reflectivity_percent", "uint8_linear", "uint8_calibrated", "photons", "none"])
severities = st.lists(st.floats(0.0, 1.0), min_size=2, max_size=3, unique=True).map(sorted)


def weather_of(kind: str, severity: float) -> Weather:
    """From no weather (0) over the fitted range to its end (1), evenly in the logarithm."""
    if kind == "fog":
        return Fog(math.inf if severity == 0 else 5.0 * 4000.0 ** (1.0 - severity))
    low, high = RATES[kind]
    made: Weather = KINDS[kind](0.0 if severity == 0 else low * (high / low) ** severity)
    return made


def cloud(seed: int, unit: str) -> Tensor:
    """Objects at 1 to 110 m, dark to retroreflective, a fifth of intensity 0, some beams empty."""
    generator = torch.Generator().manual_seed(seed % 2**32)
    points = torch.randn(N, 4, generator=generator)
    points[:, :3] *= 110.0 ** torch.rand(N, 1, generator=generator) / points[:, :3].norm(dim=-1, keepdim=True)
    reflectivity = 10.0 ** (3.0 * torch.rand(N, generator=generator) - 2.0)
    white = {"reflectivity_percent": 100.0, "uint8_linear": 255.0, "uint8_calibrated": 100.0, "photons": 50.0}
    points[:, 3] = reflectivity * white.get(unit, 1.0)
    if unit in white:
        points[:, 3] = points[:, 3].floor()
    if unit in ("uint8_linear", "uint8_calibrated"):
        points[:, 3].clamp_(max=255.0)
    if unit == "reflectivity":
        points[:, 3].clamp_(max=4.0)
    points[::5, 3] = 0.0
    points[7::40, :3] = 0.0
    return points


def rays(points: Tensor) -> Tensor:
    """A direction for every row: the point's own, or straight on."""
    empty = (points[:, :3] == 0).all(-1, keepdim=True)
    return torch.nn.functional.normalize(torch.where(empty, torch.tensor([1.0, 0.2, 0.1]), points[:, :3]), dim=-1)


@pytest.mark.parametrize("kind", ["rain", "snow", "fog"])
@quick
@given(seed=seeds, mode=modes, unit=units, name=sensors, severity=severities)
def test_more_weather_never_brightens_an_object(
    kind: str, seed: int, mode: str, unit: str, name: str, severity: list[float]
) -> None:
    """With one draw held; nor does it let more light through."""
    sensor, points = replace(SENSORS[name], return_mode=mode, intensity_unit=unit), cloud(seed, unit)
    brightness, clear = points[:, 3], torch.ones(N)
    for value in severity:
        transform = LidarWeather(weather_of(kind, value), sensor)
        result: Any = transform.run(points, transform.draw(points, seed=seed))
        is_object = result.kind == PointKind.OBJECT
        assert bool((result.points[:, 3] <= brightness)[is_object].all())
        assert bool((result.transmission <= clear).all())
        brightness = torch.where(is_object, result.points[:, 3], brightness)
        clear = result.transmission


@pytest.mark.parametrize("kind", ["rain", "fog", "measured snow"])
@quick
@given(seed=seeds, mode=st.sampled_from(["strongest", "dual"]), name=sensors, severity=severities)
def test_an_object_that_more_weather_hid_does_not_come_back(
    kind: str, seed: int, mode: str, name: str, severity: list[float]
) -> None:
    """Of the strongest return. It holds where every size becomes more frequent with the rate.

    Of Sekhon and Srivastava's snow the smallest flakes become fewer (N0 ~ R^-0.94), so that the one that outshone an
    object may be missing in heavier snow; bins that are scaled to the rate have no such exchange. Of first and last
    returns, echoes that merge may come apart.
    """
    sensor, points = replace(SENSORS[name], return_mode=mode), cloud(seed, "reflectivity")
    seen = torch.ones(N, dtype=torch.bool)
    for value in severity:
        if kind == "measured snow":
            edges = torch.linspace(0.2, 5.0, 25, dtype=torch.float64)
            bins = Binned(edges, torch.exp(-edges[:-1]) * 1e3, particle="melted-flake")
            rate = getattr(weather_of("snow", value), "rate_mm_per_h")  # noqa: B009
            weather: Weather = Snow(rate, size_distribution=bins)
        else:
            weather = weather_of(kind, value)
        transform = LidarWeather(weather, sensor)
        result: Any = transform.run(points, transform.draw(points, seed=seed))
        is_object = (result.kind == PointKind.OBJECT) & (points[:, :3] != 0).any(-1)
        assert not bool((is_object & ~seen).any())
        seen = is_object


@pytest.mark.parametrize("kind", ["rain", "snow", "fog"])
@pytest.mark.parametrize("mode", RETURN_MODES)
def test_the_share_of_lost_points_goes_to_zero_with_the_weather(kind: str, mode: str) -> None:
    """Continuously, on data with 20 % of intensities 0: those have the floor's margin, not none."""
    points, sensor = cloud(3, "reflectivity").repeat(20, 1), replace(SENSOR, return_mode=mode)
    there = (points[:, :3] != 0).any(-1)
    shares = []
    amounts = {
        "rain": [1e-6, 1e-4, 1e-2, 1.0, 25.0],
        "snow": [1e-6, 1e-4, 1e-2, 0.1, 2.0],
        "fog": [1e9, 1e6, 1e5, 1e4, 100.0],
    }[kind]
    for amount in amounts:
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(KINDS[kind], "_check_fit", lambda self: None, raising=False)
            transform = LidarWeather(KINDS[kind](amount), sensor)
        result: Any = transform.run(points, transform.draw(points, seed=1))
        shares.append(float((result.kind != PointKind.OBJECT)[there].float().mean()))
    assert shares == sorted(shares)
    assert shares[0] < 1e-3
    assert shares[1] < 0.01
    assert shares[-1] > 0.05


@quick
@given(
    seed=seeds,
    mode=modes,
    unit=units,
    name=sensors,
    kinds=st.sets(st.sampled_from(sorted(KINDS)), min_size=1),
    severity=st.floats(0.05, 1.0),
)
def test_labels_say_what_the_points_are(
    seed: int, mode: str, unit: str, name: str, kinds: set[str], severity: float
) -> None:
    sensor = replace(SENSORS[name], return_mode=mode, intensity_unit=unit, min_range_m=1.5)
    points = cloud(seed, unit)
    directions, clear = rays(points), points[:, :3].norm(dim=-1)
    clear = torch.where(clear < sensor.min_range_m, 0.0, clear)  # nothing nearer is a return
    # Directions at random are no sweep: what stands about a beam says nothing of its end.
    mixture = Mixture(*(weather_of(kind, severity) for kind in sorted(kinds)))
    transform = LidarWeather(mixture, sensor, beam_ends="max_range")
    result: Any = transform.run(points, transform.draw(points, seed=seed), directions=directions)
    clouds = [(result.points, result.kind)]
    if mode == "dual":
        clouds.append((result.second, result.second_kind))
    for got, kind in clouds:
        range_m = got[:, :3].norm(dim=-1)
        particle, lost, stays = (kind == value for value in (PointKind.PARTICLE, PointKind.LOST, PointKind.OBJECT))
        assert bool((particle | lost | stays).all())
        # In front of the object, or up to the maximum range; not nearer than the receiver sees.
        farthest = torch.where(clear > 0, clear, sensor.max_range_m)
        assert bool((range_m <= farthest * (1 + 1e-5))[particle].all())
        assert bool((range_m >= max(sensor.min_range_m, sensor.near_start_m) * (1 - 1e-5))[particle].all())
        # On the beam's own ray.
        along = (got[:, :3] * directions).sum(-1)
        assert torch.allclose(along[particle], range_m[particle], rtol=1e-5)
        # Objects stay where they were, to the bit, and only where there was one.
        assert torch.equal(got[stays][:, :3], points[stays][:, :3])
        assert bool((clear > 0)[stays].all())
        assert bool((got[lost & (clear > 0)][:, :4] == 0).all())
        assert torch.equal(got[lost & (clear == 0)], points[lost & (clear == 0)])
        assert bool((got[:, 3] >= 0).all())
    assert torch.equal(result.source, torch.arange(N))
    reach = torch.where(clear > 0, clear, sensor.max_range_m)
    assert torch.allclose(result.transmission, torch.exp(-2 * transform.extinction_per_m * reach), rtol=1e-4)
    near = (clear > 0) & (clear < sensor.near_start_m)
    assert bool((result.kind[near] == PointKind.OBJECT).all())
    if mode != "dual":
        return
    there = result.second_kind != PointKind.LOST
    assert torch.equal(result.second_source, torch.where(there, torch.arange(N), -1))
    # The second is the last return where that is not the strongest: farther away, and a first one is there.
    first, second = result.points[:, :3].norm(dim=-1), result.second[:, :3].norm(dim=-1)
    assert bool((result.kind[there] != PointKind.LOST).all())
    # Two echoes nearer than this are one; float32 places a point to a few parts in 1e7.
    assert bool((second - first >= sensor.echo_separation - 1e-4)[there].all())


@quick
@given(seed=seeds, mode=modes, name=sensors)
def test_energy_is_not_created(seed: int, mode: str, name: str) -> None:
    """A flake is no brighter than a Lambertian disk of its reflectivity that fills the beam, a drop than its share."""
    sensor, points = replace(SENSORS[name], return_mode=mode), cloud(seed, "reflectivity")
    for weather, brightest in ((Snow(5.0, flake_reflectivity=0.9), 0.9), (Rain(100.0), 0.2 / 4.0)):
        transform = LidarWeather(weather, sensor)
        result: Any = transform.run(points, transform.draw(points, seed=seed))
        particle = result.kind == PointKind.PARTICLE
        # A signal is drawn within a cell of its table, the range from the whole cell: cells are a factor 1.32 wide.
        assert bool((result.points[particle][:, 3] <= 1.33 * brightest).all())
