"""What holds of any list of detections in any weather: more of it is never stronger, labels tell the truth."""

from __future__ import annotations

import math
import warnings
from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import hypothesis.strategies as st
import pytest
import torch
from hypothesis import Phase, given, settings
from torch import Tensor

from torchweather.atmosphere.weather import Fog, Mixture, Rain, Snow, Weather
from torchweather.sensors import Radar
from torchweather.stages import PointKind
from torchweather.transforms import RadarAttenuation

N = 800
SENSOR = replace(Radar.preset("imaging-77ghz"), noise_floor_db=-130.0)
THRESHOLD_DB = -118.0
KINDS = ("rain", "snow", "fog", "wet snow")
# From next to nothing to the most that the size distributions were fitted to.
RATES = {"rain": (0.1, 200.0), "snow": (0.05, 10.0), "wet snow": (0.05, 10.0)}
quick = settings(max_examples=12, deadline=None, derandomize=True, phases=[Phase.explicit, Phase.generate])

seeds = st.integers(0, 2**63 - 1)
severities = st.lists(st.floats(0.0, 1.0), min_size=2, max_size=4, unique=True).map(sorted)
models = st.fixed_dictionaries(
    {
        "rain_model": st.sampled_from(["p838", "dsd_mie", "d3_4"]),
        "fog_model": st.sampled_from(["p840", "d3_4"]),
        "radome_film_db": st.sampled_from([0.0, 1.5]),
    }
)
sensors = st.builds(
    lambda frequency, polarisation, margin: replace(
        SENSOR, frequency_ghz=frequency, polarisation=polarisation, margin_db=margin
    ),
    st.sampled_from([24.0, 60.0, 77.0, 94.0]),
    st.sampled_from(["h", "v"]),
    st.sampled_from([0.5, 3.0]),
)


@pytest.fixture(autouse=True)
def _floors_may_contradict_the_powers() -> Iterator[None]:
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", message=".*noise_floor_db")
        yield


def weather_of(kind: str, severity: float) -> Weather:
    """From no weather (0) over the fitted range to its end (1), evenly in the logarithm."""
    if kind == "fog":
        return Fog(math.inf if severity == 0 else 5.0 * 4000.0 ** (1.0 - severity))
    low, high = RATES[kind]
    rate = 0.0 if severity == 0 else low * (high / low) ** severity
    return Rain(rate) if kind == "rain" else Snow(rate, melt_fraction=0.4 if kind == "wet snow" else 0.0)


def detections(seed: int) -> Tensor:
    """Targets at 1 to 200 m, a quarter of them with powers below the threshold, every 40th row empty."""
    random = torch.Generator().manual_seed(seed % 2**32)
    points = torch.randn(N, 6, generator=random)
    points[:, :3] *= 200.0 ** torch.rand(N, 1, generator=random) / points[:, :3].norm(dim=-1, keepdim=True)
    points[:, 4] = THRESHOLD_DB - 10.0 + 40.0 * torch.rand(N, generator=random)
    points[7::40, :3] = 0.0
    return points


def ran(transform: RadarAttenuation, points: Tensor, seed: int) -> Any:
    return transform.run(points, transform.draw(points, seed=seed))


@pytest.mark.parametrize("kind", KINDS)
@quick
@given(seed=seeds, sensor=sensors, options=models, severity=severities)
def test_more_weather_never_raises_a_power_nor_brings_back_what_it_took(
    kind: str, seed: int, sensor: Radar, options: dict[str, Any], severity: list[float]
) -> None:
    """With one draw held: powers, SNRs and what is detected only go down, the loss only goes up."""
    points = detections(seed)
    power, snr, loss = points[:, 4], torch.full((N,), math.inf), torch.zeros(N)
    seen = (points[:, :3] != 0).any(-1)
    for value in severity:
        result = ran(RadarAttenuation(weather_of(kind, value), sensor, **options), points, seed)
        assert bool((result.points[:, 4] <= power).all())
        assert bool((result.snr_db <= snr).all())
        assert bool((result.attenuation_db >= loss).all())
        detected = result.kind == PointKind.OBJECT
        assert not bool((detected & ~seen).any())
        power, snr, loss, seen = result.points[:, 4], result.snr_db, result.attenuation_db, detected


@quick
@given(
    seed=seeds,
    sensor=sensors,
    options=models,
    kinds=st.sets(st.sampled_from(KINDS[:3]), min_size=1),
    severity=st.floats(0.05, 1.0),
)
def test_labels_say_what_the_rows_are(
    seed: int, sensor: Radar, options: dict[str, Any], kinds: set[str], severity: float
) -> None:
    points = detections(seed)
    weather = Mixture(*(weather_of(kind, severity) for kind in sorted(kinds)))
    transform = RadarAttenuation(weather, sensor, clutter=True, clutter_points=40, **options)
    result = ran(transform, points, seed)
    there = (points[:, :3] != 0).any(-1)
    objects, own = result.points[:N], result.points[N:]
    kind, own_kind = result.kind[:N], result.kind[N:]
    stays, lost = kind == PointKind.OBJECT, kind == PointKind.LOST
    assert bool((stays | lost).all())
    assert not bool((stays & ~there).any())
    # Objects stay where they were, to the bit; what is lost is at the origin, and empty rows are as they came.
    assert torch.equal(objects[stays][:, :3], points[stays][:, :3])
    assert bool((objects[lost][:, :3] == 0).all())
    assert torch.equal(objects[~there], points[~there])
    assert torch.equal(objects[:, [3, 5]], points[:, [3, 5]])
    # Twice the attenuation per km along each range, the cover on top: float32.
    range_m = points[:, :3].norm(dim=-1)
    rain_mm_per_h = next((float(part.intensity) for part in weather.parts if isinstance(part, Rain)), 0.0)
    cover_db = options["radome_film_db"] * rain_mm_per_h ** (1.0 / 3.0)
    wanted = 2e-3 * transform.attenuation_db_per_km * range_m + cover_db
    assert torch.allclose(result.attenuation_db[:N][there], wanted[there], rtol=1e-4, atol=1e-3)
    assert torch.allclose(objects[:, 4], points[:, 4] - result.attenuation_db[:N], atol=1e-3)
    # Detected is what stands above the floor by the detection SNR, whatever the row is.
    every = torch.cat([stays, own_kind == PointKind.PARTICLE])
    assert bool((result.snr_db[every] >= sensor.detection_snr_db - 1e-4).all())
    assert bool((result.snr_db[:N][lost & there] < sensor.detection_snr_db).all())
    assert bool((result.snr_db[:N][~there] == -math.inf).all())
    # The weather's own rows: in the view, within reach, above the threshold; or empty.
    seen = own_kind == PointKind.PARTICLE
    assert bool((own[~seen] == 0).all())
    own_range_m = own[seen][:, :3].norm(dim=-1)
    assert bool(((own_range_m > 0.99) & (own_range_m < sensor.max_range_m * 1.001)).all())
    assert bool((own[seen][:, 4] >= THRESHOLD_DB - 1e-3).all())
    assert result.source.tolist() == [*range(N), *[-1] * len(own)]


@quick
@given(seed=seeds, sensor=sensors, kind=st.sampled_from(KINDS), severity=st.floats(0.05, 1.0))
def test_polar_angle_does_not_matter_to_the_loss(seed: int, sensor: Radar, kind: str, severity: float) -> None:
    """A list turned about the radar loses the same: the loss is of the range alone (float32 norms)."""
    points = detections(seed)
    turned = points.clone()
    turned[:, :3] = points[:, [1, 2, 0]] * torch.tensor([1.0, -1.0, 1.0])
    transform = RadarAttenuation(weather_of(kind, severity), sensor)
    first, other = (ran(transform, one, seed) for one in (points, turned))
    assert torch.allclose(first.attenuation_db, other.attenuation_db, rtol=1e-5, atol=1e-5)


@pytest.mark.parametrize("kind", KINDS)
def test_the_share_of_lost_points_goes_to_zero_with_the_weather(kind: str) -> None:
    """Continuously, on data with a quarter of the powers below the threshold: those have a margin, not none."""
    points = detections(3).repeat(25, 1)
    there = (points[:, :3] != 0).any(-1)
    shares = []
    for severity in (0.0, 1e-3, 0.3, 0.7, 1.0):
        weather = weather_of(kind, severity)
        result = ran(RadarAttenuation(weather, SENSOR), points, 1)
        shares.append(float((result.kind != PointKind.OBJECT)[there].float().mean()))
    assert shares == sorted(shares)
    assert shares[0] == 0.0
    assert shares[1] < 0.003
    assert shares[-1] > {"rain": 0.1, "snow": 0.003, "fog": 0.02, "wet snow": 0.05}[kind]
