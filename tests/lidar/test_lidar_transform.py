"""LidarRain, LidarFog, LidarSnow: closed forms, the smooth expectation, variants, units, large clouds."""

from __future__ import annotations

import math
import resource
import time
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import torch
from scipy.stats import kstest
from torch import Tensor, nn

from torchweather.atmosphere.weather import Fog, Mixture, Rain, Snow, Weather
from torchweather.core.errors import TorchweatherWarning
from torchweather.sensors import RETURN_MODES, Lidar
from torchweather.stages import PointKind
from torchweather.transforms import LidarFog, LidarRain, LidarSnow, LidarWeather

SENSOR = Lidar(wavelength_nm=905.0, intensity_unit="reflectivity", range_at_10_percent_m=50.0)
OBJECT, PARTICLE, LOST = (int(kind) for kind in (PointKind.OBJECT, PointKind.PARTICLE, PointKind.LOST))


def target(range_m: float, intensity: float, number: int = 1, dtype: torch.dtype = torch.float32) -> Tensor:
    """The same target in many beams, straight ahead and a little up."""
    direction = torch.tensor([0.96, 0.0, 0.28], dtype=dtype)
    return torch.cat([range_m * direction, torch.tensor([intensity], dtype=dtype)]).expand(number, 4)


def ran(transform: LidarWeather, points: Tensor, seed: int = 1, **more: Any) -> Any:
    return transform.run(points, transform.draw(points, seed=seed), **more)


WEATHERS: dict[str, Weather] = {
    "rain": Rain(25.0),
    "snow": Snow(1.0),
    "fog": Fog(300.0),
    "mixture": Mixture(Rain(5.0), Snow(0.3), Fog(1000.0)),
}
every_weather = pytest.mark.parametrize("weather", WEATHERS.values(), ids=WEATHERS.keys())


# ---- closed forms -----------------------------------------------------------------------------------------------


@every_weather
def test_transmission_at_half_the_attenuation_length_is_one_e_th(weather: Weather) -> None:
    transform = LidarWeather(weather, SENSOR)
    result = ran(transform, target(0.5 / float(transform.extinction_per_m), 1.0))
    assert float(result.transmission) == pytest.approx(math.exp(-1.0), rel=1e-5)


@every_weather
def test_an_object_is_dimmed_by_the_way_there_and_back(weather: Weather) -> None:
    """I exp(-2 alpha R), for objects that stand far above the threshold."""
    transform = LidarWeather(weather, SENSOR)
    points = torch.cat([target(r, 2.0, 50, torch.float64) for r in (4.0, 15.0, 40.0, 60.0)])
    result = ran(transform, points)
    stays = result.kind == OBJECT
    assert bool(stays.any())
    range_m = points[:, :3].norm(dim=-1)
    wanted = 2.0 * torch.exp(-2.0 * transform.extinction_per_m.double() * range_m)
    assert torch.allclose(result.points[stays][:, 3], wanted[stays], rtol=1e-6)


@pytest.mark.parametrize("mor_m", [30.0, 200.0])
def test_alpha_beta_and_visibility_are_readable_and_tied(mor_m: float) -> None:
    """A lidar ratio of 18 to 22 sr from Mie theory, and 65 sr in Hahner's variant (PHYSICS.md 3.2)."""
    fog, hahner = LidarFog(Fog(mor_m), SENSOR), LidarFog(Fog(mor_m), SENSOR, variant="hahner")
    assert float(fog.mor_m) == float(hahner.mor_m) == mor_m
    assert 18.0 < float(fog.extinction_per_m / fog.backscatter_per_m_sr) < 22.0
    assert float(hahner.backscatter_per_m_sr) == pytest.approx(0.046 / mor_m, rel=1e-6)
    assert float(hahner.extinction_per_m) == pytest.approx(math.log(20.0) / mor_m, rel=1e-5)


def test_rain_has_no_backscatter_coefficient_and_no_visibility_of_fog() -> None:
    rain = LidarRain(Rain(5.0), SENSOR)
    assert float(rain.backscatter_per_m_sr) == 0.0
    assert float(rain.mor_m) == math.inf


def test_a_point_on_the_floor_survives_with_the_exponential_margin() -> None:
    """P(m > a) = exp(-a / margin): a = 2 alpha R in nepers, the margin's mean of 1 dB is 0.23 of them."""
    number = 40_000
    for margin_db in (1.0, 3.0):
        transform = LidarRain(Rain(10.0), replace(SENSOR, margin_db=margin_db))
        result = ran(transform, target(60.0, 0.0, number))
        loss = 2.0 * float(transform.extinction_per_m) * 60.0
        wanted = math.exp(-loss / (margin_db * math.log(10.0) / 10.0))
        # The default near range hides all drops but some in 10,000.
        tolerance = 4 * math.sqrt(wanted * (1 - wanted) / number) + 1e-3
        assert float((result.kind == OBJECT).float().mean()) == pytest.approx(wanted, abs=tolerance)


@every_weather
@pytest.mark.parametrize("mode", RETURN_MODES)
def test_what_is_nearer_than_the_receiver_sees_stays(weather: Weather, mode: str) -> None:
    points = torch.cat([target(r, i, 50) for r in (0.05, 0.7, 1.99) for i in (0.0, 0.5)])
    result = ran(LidarWeather(weather, replace(SENSOR, return_mode=mode)), points)
    assert bool((result.kind == OBJECT).all())
    assert torch.equal(result.points[:, :3], points[:, :3])
    assert int(result.floored_points) == 0  # what the receiver does not see there says nothing of its calibration


def test_rows_nearer_than_the_minimum_range_hold_no_return() -> None:
    """Some drivers write an empty beam with the sensor's own offset."""
    points = torch.cat([target(0.03, 0.0, 3), target(20.0, 0.5, 2)])
    result = ran(LidarSnow(Snow(1.0), replace(SENSOR, min_range_m=0.5)), points)
    assert int(result.empty_beams) == 3
    assert result.kind[:3].tolist() == [LOST] * 3
    assert torch.equal(result.points[:3], points[:3])


def test_particles_of_a_column_without_meaning_have_the_objects_values() -> None:
    """A constant beside objects of 120 would tell a network which points are snow."""
    sensor = replace(SENSOR, intensity_unit="none")
    points = torch.cat([target(20.0, 120.0, 500), target(30.0, 80.0, 500)])
    points = points[torch.randperm(1000, generator=torch.Generator().manual_seed(1))]
    points[::3] = 0.0
    points[::3, 0] = 60.0
    directions = torch.nn.functional.normalize(points[:, :3], dim=-1)
    points[::3] = 0.0
    result = LidarSnow(Snow(10.0, flake_reflectivity=0.9), sensor).run(points, directions=directions, seed=1)
    values = result.points[result.kind == PARTICLE][:, 3]
    assert len(values) > 100
    assert set(values.tolist()) == {80.0, 120.0}
    assert float((values == 120.0).float().mean()) == pytest.approx(0.5, abs=4 * 0.5 / math.sqrt(len(values)))


def test_floored_points_are_those_that_say_less_than_the_threshold() -> None:
    """0.1 at 50 m is the threshold; what is there was detected."""
    points = torch.cat([target(50.0, 0.0999), target(50.0, 0.1001), target(100.0, 0.399), torch.zeros(2, 4)])
    assert int(ran(LidarRain(Rain(1.0), SENSOR), points).floored_points) == 2


def test_objects_beyond_the_maximum_range_are_dimmed_over_their_whole_way() -> None:
    transform = LidarFog(Fog(5000.0), SENSOR)
    result = ran(transform, target(400.0, 3.0, dtype=torch.float64))
    assert float(result.transmission) == pytest.approx(math.exp(-800.0 * float(transform.extinction_per_m)), rel=1e-5)


# ---- the smooth expectation -------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("weather", "mode"),
    [
        *((weather, mode) for weather in (Rain(50.0), Snow(2.0)) for mode in RETURN_MODES),
        # Of fog the other modes are approximate: the next test.
        *((Fog(mor_m), "strongest") for mor_m in (150.0, 30.0)),
    ],
    ids=str,
)
def test_the_expectation_is_the_mean_of_many_draws(weather: Weather, mode: str) -> None:
    """For objects on the floor and far above the threshold; between them the step is rounded."""
    number = 400
    near = SENSOR.with_hahner_overlap() if isinstance(weather, Rain) else SENSOR
    transform = LidarWeather(weather, replace(near, return_mode=mode))
    kinds = [(r, 0.0) for r in (1.5, 3.0, 5.0, 8.0, 15.0, 30.0, 80.0)] + [(r, 2.0) for r in (3.0, 5.0, 8.0, 15.0, 25.0)]
    points = torch.cat([target(*kind) for kind in kinds])
    _, wanted = transform.expected(points)
    result = ran(transform, points.repeat_interleave(number, 0))
    kept = result.kind == OBJECT
    if mode == "dual":
        kept = kept | (result.second_kind == OBJECT)
    share = kept.reshape(len(kinds), number).float().mean(1)
    # 4.5 standard deviations of 12 shares. Of first and last returns, chains of merging echoes are neglected, 0.03.
    allowed = 4.5 * torch.sqrt(wanted * (1 - wanted) / number) + (0.005 if mode == "strongest" else 0.03)
    assert bool(((share - wanted).abs() <= allowed).all()), list(
        zip(kinds, share.tolist(), wanted.tolist(), strict=True)
    )


@pytest.mark.parametrize("mode", ["first", "last", "dual"])
@pytest.mark.parametrize("mor_m", [30.0, 150.0])
def test_the_expectation_of_merging_fog_is_the_mean(mode: str, mor_m: float) -> None:
    transform = LidarFog(Fog(mor_m), replace(SENSOR, return_mode=mode))
    kinds = [(r, 2.0) for r in (2.5, 3.5, 5.0, 8.0, 15.0)]
    points = torch.cat([target(*kind) for kind in kinds])
    result = ran(transform, points.repeat_interleave(400, 0))
    share = (result.kind == OBJECT) if mode != "dual" else (result.kind == OBJECT) | (result.second_kind == OBJECT)
    wanted = transform.expected(points)[1]
    # 4.5 standard deviations of 5 shares; tables between nodes, 0.01.
    allowed = 4.5 * torch.sqrt(wanted * (1 - wanted) / 400) + 0.01
    assert bool(((share.reshape(5, 400).float().mean(1) - wanted).abs() <= allowed).all())


def test_the_expected_signal_is_that_of_the_link() -> None:
    transform = LidarFog(Fog(200.0), SENSOR)
    signal, _ = transform.expected(target(40.0, 0.5, dtype=torch.float64))
    alpha = float(transform.extinction_per_m)
    assert float(signal) == pytest.approx(0.5 / math.pi / 1600.0 * math.exp(-80.0 * alpha), rel=1e-5)


def test_beams_without_return_expect_nothing_and_near_objects_are_certain() -> None:
    signal, share = LidarFog(Fog(20.0), SENSOR).expected(torch.cat([torch.zeros(1, 4), target(1.0, 0.2)]))
    assert signal.tolist()[0] == 0.0
    assert share.tolist() == [0.0, 1.0]


class Expectation(nn.Module):
    """``expected`` as a forward, for ``functional_call``."""

    def __init__(self, transform: LidarWeather) -> None:
        super().__init__()
        self.transform = transform

    def forward(self, points: Tensor) -> tuple[Tensor, Tensor]:
        return self.transform.expected(points)


@pytest.mark.parametrize("mode", ["strongest", "first"])
@pytest.mark.parametrize(
    ("weather", "names"),
    [
        (Rain(20.0), ("rate_mm_per_h", "q_eff", "threshold", "near_start_m", "margin_db")),
        (Snow(1.0), ("rate_mm_per_h", "divergence_rad", "near_full_m")),
        (Fog(150.0), ("mor_m", "threshold", "photons_at_threshold")),
    ],
    ids=["rain", "snow", "fog"],
)
def test_gradients_of_the_expectation(weather: Weather, names: tuple[str, ...], mode: str) -> None:
    sensor = SENSOR.with_hahner_overlap() if isinstance(weather, Rain) else SENSOR
    module = Expectation(LidarWeather(weather, replace(sensor, return_mode=mode)).double())
    buffers = dict(module.named_buffers())
    points = torch.cat([target(r, i, dtype=torch.float64) for r, i in ((45, 0.1), (5, 0.2), (60, 0.0))])
    for name in names if mode == "strongest" else names[:1]:
        keys = [key for key in buffers if key.endswith(f".{name}")]
        assert keys
        value = buffers[keys[0]].double()

        def scaled(log_factor: Tensor, keys: list[str] = keys, value: Tensor = value) -> Tensor:
            """Signals in thresholds and probabilities, with one parameter of all stages scaled."""
            moved = dict.fromkeys(keys, value * torch.exp(log_factor))
            signal, share = torch.func.functional_call(module, moved, (points,))
            return torch.stack([signal / SENSOR.threshold_per_m2_sr, share])

        at = torch.zeros((), dtype=torch.float64, requires_grad=True)
        # Tables are linear in cells: a difference across the border of one sees both slopes.
        assert torch.autograd.gradcheck(scaled, (at,), eps=1e-6, atol=1e-6, rtol=1e-3, fast_mode=True), name
        (gradient,) = torch.autograd.grad(scaled(at).sum(), at)
        assert mode != "strongest" or float(gradient.abs()) > 1e-6, name


def test_a_visibility_is_fitted_through_the_expectation() -> None:
    """Objects of a clear scan and how bright they were in a fog of 120 m."""
    points = torch.cat([target(r, 0.5, dtype=torch.float64) for r in (10.0, 25.0, 40.0)])
    measured = LidarFog(Fog(120.0), SENSOR).double().expected(points)[0]
    log_mor = torch.tensor(math.log(400.0), dtype=torch.float64, requires_grad=True)
    optimiser = torch.optim.LBFGS([log_mor], max_iter=40, line_search_fn="strong_wolfe")
    module = Expectation(LidarFog(Fog(400.0), SENSOR).double())
    key = "transform.chain._stages.extinction.parts.fog.mor_m"

    def loss() -> Tensor:
        optimiser.zero_grad()
        signal, _ = torch.func.functional_call(module, {key: torch.exp(log_mor)}, (points,))
        off: Tensor = (signal.log() - measured.log()).square().sum()
        off.backward()  # type: ignore[no-untyped-call]
        return off

    optimiser.step(loss)  # type: ignore[no-untyped-call]
    assert math.exp(log_mor.item()) == pytest.approx(120.0, rel=1e-3)


def test_the_intensities_of_a_replayed_draw_have_a_gradient() -> None:
    mor_m = torch.tensor(300.0, requires_grad=True)
    transform, points = LidarFog(Fog(mor_m), SENSOR), target(30.0, 0.5, 20)
    result = ran(transform, points)
    assert bool((result.kind == OBJECT).all())
    result.points[:, 3].sum().backward()
    assert mor_m.grad is not None
    assert float(mor_m.grad) > 0.0  # farther visibility, brighter objects


# ---- variants ---------------------------------------------------------------------------------------------------


def test_published_rain_lies_evenly_between_a_tenth_of_the_objects_range_and_the_object() -> None:
    """D3.4: particles uniform over 10-100 % of the range; those seen have D > 0.584 mm x R."""
    transform = LidarRain(Rain(50.0), replace(SENSOR, range_noise_m=0.0), variant="d3_4")
    number, far = 150_000, 4.0
    result = ran(transform, target(far, 0.0, number))
    hit = result.kind == PARTICLE
    range_m = result.points[hit][:, :3].norm(dim=-1).double()
    assert int(hit.sum()) > 500
    assert float(range_m.min()) >= 0.1 * far * (1 - 1e-5)
    assert float(range_m.max()) <= far * (1 + 1e-5)
    # Brightest of the seen drops: density of their ranges is N_>(0.584 mm R), of 0.5 to 6 mm.
    lam = 4.1 * 50.0**-0.21
    grid = np.linspace(0.1 * far, far, 4001)
    seen = np.exp(-lam * np.maximum(0.584 * grid, 0.5)) - np.exp(-lam * 6.0)
    law = np.concatenate([[0.0], np.cumsum(0.5 * (seen[1:] + seen[:-1]))])
    # Objects on the floor are beaten by margin-dependent drops only: all drops seen are stronger than 1, fewer than the
    # floor's margin; the fainter ones, far out, lose. So compare the drops of beams without an object.
    empty = torch.zeros(number, 4)
    directions = torch.tensor([1.0, 0.0, 0.0]).expand(number, 3)
    free = LidarRain(Rain(50.0), replace(SENSOR, max_range_m=far), variant="d3_4")
    in_empty = ran(free, empty, directions=directions)
    ranges = in_empty.points[in_empty.kind == PARTICLE][:, 0].double().numpy()
    # Marshall-Palmer, cylinder of radius 4.75 mm, particles of the whole length spread over 90 % of it.
    per_m = 8000.0 / lam * np.pi * 0.00475**2 / 0.9
    mean = per_m * law[-1] * (grid[1] - grid[0])
    wanted = 1.0 - math.exp(-mean)
    assert len(ranges) / number == pytest.approx(wanted, abs=4 * math.sqrt(wanted / number) + 0.02 * wanted)
    # One drop a beam nearly always, so the strongest is any; 1.95 / sqrt(n) is a level of 1e-3.
    distance = kstest(ranges, lambda r: np.interp(r, grid, law / law[-1])).statistic
    assert distance < 1.95 / math.sqrt(len(ranges)) + mean


@pytest.mark.parametrize(
    "weather", [Fog(100.0), Snow(1.0), Mixture(Rain(1.0), Fog(100.0))], ids=["fog", "snow", "both"]
)
def test_published_fog_and_snow_are_refused_with_the_reason(weather: Weather) -> None:
    with pytest.raises(ValueError, match=r"rain alone.*no system constant"):
        LidarWeather(weather, SENSOR, variant="d3_4")


def test_published_rain_takes_half_the_light_for_drops_of_half_to_six_millimetres() -> None:
    """pi/8 N D^2 where the extinction is pi/4 Q N D^2, Q = 2.

    Default q_eff of 1.1 takes 0.55 of the full extinction of all drops; the published 0.5 of that of some.
    """
    default, published = LidarRain(Rain(25.0), SENSOR), LidarRain(Rain(25.0), SENSOR, variant="d3_4")
    diameter_mm = torch.linspace(0.5, 6.0, 20_001, dtype=torch.float64)
    number = 8000.0 * torch.exp(-4.1 * 25.0**-0.21 * diameter_mm)  # m^-3 mm^-1
    wanted = float(torch.trapezoid(math.pi / 4.0 * number * (1e-3 * diameter_mm) ** 2, diameter_mm))
    assert float(published.extinction_per_m) == pytest.approx(wanted, rel=0.01)
    assert float(published.extinction_per_m) < float(default.extinction_per_m)


def test_hahner_is_for_fog_and_fainter_by_its_lidar_ratio() -> None:
    with pytest.raises(ValueError, match="is for fog and snow; this weather has neither"):
        LidarRain(Rain(1.0), SENSOR, variant="hahner")
    points = target(30.0, 0.0, 4000)
    shares = [
        float((ran(LidarFog(Fog(100.0), SENSOR, variant=variant), points).kind == PARTICLE).float().mean())
        for variant in (None, "hahner")
    ]
    assert shares[1] < 0.5 * shares[0]


# ---- intensities that contradict their unit ---------------------------------------------------------------------


@pytest.mark.parametrize(
    ("unit", "values", "evidence"),
    [
        ("reflectivity", [0.0, 12.0, 200.0], r"a tenth lies above 200.*uint8_linear"),
        ("reflectivity", [0.0, 12.0, 2000.0], r"a tenth lies above 2000.*photons"),
        ("uint8_linear", [0.0, 3.0, 700.0], r"a tenth lies above 700.*photons"),
        ("uint8_calibrated", [0.1, 0.35, 0.99], r"largest is 0\.99.*reflectivity \(0-1\)"),
        ("reflectivity_percent", [0.1, 0.35, 0.99], r"reflectivity \(0-1\)"),
    ],
)
def test_intensities_outside_their_unit_are_named(unit: str, values: list[float], evidence: str) -> None:
    points = torch.cat([target(20.0, value) for value in values])
    with pytest.warns(TorchweatherWarning, match=rf"(?s)intensity_unit='{unit}'.*{evidence}.*Lidar\(intensity_unit"):
        LidarRain(Rain(1.0), replace(SENSOR, intensity_unit=unit))(points)


@pytest.mark.parametrize(
    ("unit", "values"),
    [
        ("reflectivity", [0.0, 0.3, 1.3]),
        ("uint8_linear", [0.0, 1.0, 0.0]),
        ("uint8_linear", [0.0, 17.5, 255.0]),
        ("photons", [0.0, 5000.0, 0.5]),
        ("none", [1.0, 1.0, 99.0]),
        ("uint8_calibrated", [0.0, 0.0, 0.0]),
    ],
)
def test_plausible_intensities_pass_without_a_word(unit: str, values: list[float]) -> None:
    points = torch.cat([target(20.0, value) for value in values])
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        LidarRain(Rain(1.0), replace(SENSOR, intensity_unit=unit))(points)


def test_particles_of_a_cloud_of_bytes_are_bytes() -> None:
    sensor = replace(SENSOR, intensity_unit="uint8_linear").with_hahner_overlap()
    result = ran(LidarSnow(Snow(5.0), sensor), target(60.0, 40.0, 5000))
    found = result.points[result.kind == PARTICLE][:, 3]
    assert torch.equal(found, found.floor())
    assert float(found.max()) <= 255.0
    assert bool((found == 0).any())


# ---- large and odd clouds ---------------------------------------------------------------------------------------


@pytest.mark.parametrize("bad", [1e25, 3e38])
def test_coordinates_whose_square_overflows_are_not_silently_lost(bad: float) -> None:
    """A driver's sentinel for no return, such as FLT_MAX, is no object; a clear error says so."""
    points = target(20.0, 0.5, 3).clone()
    points[1, 0] = bad
    with pytest.raises(ValueError, match="too far"):
        LidarRain(Rain(0.0), SENSOR)(points)


@contextmanager
def one_thread() -> Iterator[None]:
    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        yield
    finally:
        torch.set_num_threads(threads)


@pytest.mark.long  # beside batches in portions in tests/lidar/effects
@pytest.mark.slow
def test_ten_million_points() -> None:
    """One cloud of ten million: about 3 s on a core and less than 3 GB beside the cloud and its draw."""
    points = torch.empty(10_000_000, 4)
    points.copy_(target(35.0, 0.4))
    transform = LidarSnow(Snow(1.0), SENSOR)
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    with one_thread(), torch.no_grad():
        start = time.perf_counter()
        found = transform(points, transform.draw(points, seed=1))
        seconds = time.perf_counter() - start
    more_bytes = 1024 * (resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before)
    assert isinstance(found, Tensor)
    assert found.shape == points.shape
    assert 0.001 < float((found[:, 0] != points[:, 0]).float().mean()) < 0.5
    # Generous: a shared machine; what counts is that time and memory are linear, not that they are small.
    assert seconds < 60.0
    assert more_bytes < 4e9


def test_a_cloud_worked_on_in_portions_comes_out_the_same(monkeypatch: pytest.MonkeyPatch) -> None:
    import torchweather.lidar.transform as module

    generator = torch.Generator().manual_seed(3)
    points = torch.rand(3, 1000, 5, generator=generator) * 40.0
    points[:, ::7, :3] = 0.0
    directions = torch.nn.functional.normalize(torch.randn(1000, 3, generator=generator), dim=-1)
    lidar = Lidar.preset("velodyne-hdl-64e", return_mode="dual")
    weather = Mixture(Snow(torch.tensor([0.5, 1.0, 3.0])), Fog(mor_m=200.0))
    transform = LidarWeather(weather, lidar)
    noise = transform.draw(points, seed=1)
    whole = transform.run(points, noise, directions=directions)
    monkeypatch.setattr(module, "BEAMS_AT_ONCE", 256)  # portions of 85 beams of each sample
    apart = transform.run(points, noise, directions=directions)
    for name in ("points", "kind", "second", "second_source", "source"):
        assert torch.equal(getattr(whole, name), getattr(apart, name)), name
