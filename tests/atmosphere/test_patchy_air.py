"""Patches of weather against a slow sum of waves, and what they do to LiDAR, camera and radar against integrals."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
import torch
from numpy.typing import NDArray
from torch import Tensor

from torchweather.atmosphere.density_field import LENGTHS, SECTORS, WAVES, PatchyAir, sector_of
from torchweather.atmosphere.weather import Fog, Mixture, Rain, Snow, weather_from_dict
from torchweather.core.random import draw_variates
from torchweather.lidar.returns.beam_particles import BeamParticles
from torchweather.radar import FmcwRadar
from torchweather.sensors import Camera, Lidar, Radar
from torchweather.stages import EFFECTS, ExtinctionAndAirlight, ParticleReturns, PointKind, VolumeClutter
from torchweather.transforms import (
    BayerFog,
    BayerRain,
    LidarFog,
    LidarRain,
    LidarSnow,
    LidarWeather,
    RadarAttenuation,
)

Floats = NDArray[np.float64]
LENGTH_M = 20.0
LIDAR = Lidar(wavelength_nm=905.0, range_at_10_percent_m=60.0, divergence_mrad=2.0).with_hahner_overlap()
CAMERA = Camera.from_intrinsics(100, 100, 63.5, 47.5, 128, 96)
RADAR = Radar.preset("imaging-77ghz")


def noise_of(seed: int, samples: int = 1) -> dict[str, Tensor]:
    """Waves and phases of some fields."""
    drawn = draw_variates(range(seed, seed + samples), "air", PatchyAir(LENGTH_M).variates(), {})
    return {name.removeprefix("air."): torch.from_numpy(values) for name, values in drawn.items()}


def even(g: float) -> dict[str, Tensor]:
    """A field that is g everywhere: waves that do not turn, all at one phase."""
    phase = math.acos(g / math.sqrt(2.0 * WAVES)) / (2.0 * math.pi)
    return {"wave": torch.zeros(1, WAVES, 2), "phase": torch.full((1, WAVES), phase)}


def one_wave(turns_x: float, turns_y: float, phase: float) -> dict[str, Tensor]:
    """A field of one wave, sqrt(2) cos(2 pi (turns . p / l + phase)): eight waves alike, the others cancel."""
    alike = WAVES // 8
    wave, turns = torch.zeros(1, WAVES, 2), torch.full((1, WAVES), phase)
    wave[:, :alike] = 2.0 * math.pi * torch.tensor([turns_x, turns_y])
    turns[:, alike::2], turns[:, alike + 1 :: 2] = 0.0, 0.5
    return {"wave": wave, "phase": turns}


def g_at(noise: dict[str, Tensor], x: Floats, y: Floats) -> Floats:
    """g at places of the first field, wave by wave, in double precision."""
    wave, phase = noise["wave"][0].double().numpy(), noise["phase"][0].double().numpy()
    found = np.zeros_like(x)
    for (kx, ky), turns in zip(wave, phase, strict=True):
        found += np.cos((kx * x + ky * y) / LENGTH_M + 2.0 * math.pi * turns)
    return math.sqrt(2.0 / WAVES) * found


def mean_density(noise: dict[str, Tensor], log_std: float, azimuth_rad: float, range_m: float) -> float:
    """Of the way to a place, by a sum of 4,000 parts."""
    r = (np.arange(4000) + 0.5) / 4000 * range_m
    g = g_at(noise, r * math.cos(azimuth_rad), r * math.sin(azimuth_rad))
    return float(np.exp(log_std * g - 0.5 * log_std**2).mean())


# ---- the field ---------------------------------------------------------------------------------------------------


def test_the_field_is_normal_with_variance_1_and_a_gaussian_correlation() -> None:
    # Four places six lengths away, which know nothing of each other, in each of 100 fields; and 1.5 lengths farther.
    stage, parts = PatchyAir(LENGTH_M), []
    for seed in range(0, 100, 20):
        normal = stage.field(noise_of(seed, 20)).normal.double()
        parts.append(torch.stack([normal[:, :192:48, node].flatten() for node in (48, 60)]))
    here, there = torch.cat(parts, 1)
    fields = here.numel()
    error = 1.0 / math.sqrt(fields)
    assert abs(here.mean()) < 4 * error
    assert abs(here.var() - 1.0) < 4 * math.sqrt(2.0) * error
    wanted = math.exp(-0.5 * 1.5**2)
    assert abs((here * there).mean() - wanted) < 4 * math.sqrt(1 + wanted**2) * error
    density = torch.exp(0.5 * here - 0.125)
    assert abs(density.mean() - 1.0) < 4 * math.sqrt(math.expm1(0.25)) * error


def test_the_layout_is_the_sum_of_its_waves() -> None:
    noise = noise_of(3)
    field = PatchyAir(LENGTH_M).field(noise)
    banks = field.banks(Rain(5, patch_log_std=0.6))
    rng = np.random.default_rng(1)
    azimuth, range_m = rng.uniform(-math.pi, math.pi, 300), rng.uniform(0.5, 8 * LENGTH_M, 300)
    wanted = np.exp(0.6 * g_at(noise, range_m * np.cos(azimuth), range_m * np.sin(azimuth)) - 0.18)
    found = banks.at(torch.from_numpy(azimuth)[None], torch.from_numpy(range_m)[None])[0].numpy()
    # Linear between nodes an eighth of a length apart: h^2 / 8 of a curvature of some 0.6 / l^2 is 0.1 % each way.
    assert np.abs(found / wanted - 1).max() < 0.05
    assert np.sqrt(np.mean((found / wanted - 1) ** 2)) < 0.01
    for one, far in zip(azimuth[:20], range_m[:20], strict=True):
        mean = banks.mean_to(torch.tensor([[one]]), torch.tensor([[far]]))
        assert float(mean) == pytest.approx(mean_density(noise, 0.6, one, far), rel=0.01)


def test_beyond_the_layout_the_density_is_1() -> None:
    banks = PatchyAir(LENGTH_M).field(even(1.0)).banks(Rain(5, patch_log_std=0.5))
    end_m, ahead = LENGTHS * LENGTH_M, torch.zeros(1, 1)
    dense = math.exp(0.5 - 0.125)
    assert float(banks.at(ahead, torch.full((1, 1), end_m + 1.0))) == 1.0
    mean = float(banks.mean_to(ahead, torch.full((1, 1), 4 * end_m)))
    assert mean == pytest.approx((dense + 3.0) / 4.0, rel=1e-5)


def test_the_air_of_a_sector_is_that_along_its_middle() -> None:
    banks = PatchyAir(LENGTH_M).field(noise_of(9)).banks(Rain(5, patch_log_std=0.8))
    air, range_m = banks.of_sectors(), torch.tensor([0.0, 3.0, 17.0, 90.0])
    for number in range(SECTORS):
        middle = 2.0 * math.pi * number / SECTORS - math.pi
        near = torch.tensor([middle - 0.4 * 2.0 * math.pi / SECTORS, middle + 0.4 * 2.0 * math.pi / SECTORS])
        turned = torch.atan2(near.sin(), near.cos())  # an azimuth below -pi lies at the other end
        assert sector_of(turned).tolist() == [number, number]
        along = torch.full((1, 4), middle)
        torch.testing.assert_close(
            air.density_at(range_m)[number], banks.at(along, range_m[None])[0], rtol=1e-4, atol=0
        )
        way_m = banks.mean_to(along, range_m[None])[0] * range_m
        torch.testing.assert_close(air.way_m(range_m)[number], way_m, rtol=1e-4, atol=1e-4)


def test_patches_drift_with_the_air() -> None:
    noise, stage = noise_of(5), PatchyAir(LENGTH_M, (3.0, -1.0))
    later = stage.next_frame(noise, 2.0)
    x, y = np.array([10.0, 30.0]), np.array([-5.0, 12.0])
    np.testing.assert_allclose(g_at(later, x, y), g_at(noise, x - 6.0, y + 2.0), atol=1e-5)


# ---- LiDAR -------------------------------------------------------------------------------------------------------


def cloud(azimuth: Floats, range_m: Floats, height_m: float = 0.0) -> Tensor:
    columns = [range_m * np.cos(azimuth), range_m * np.sin(azimuth), 0 * range_m + height_m, 0 * range_m + 0.3]
    return torch.from_numpy(np.stack(columns, -1)).float()


def in_field(transform: LidarWeather, points: Tensor, field: dict[str, Tensor], seed: int = 1) -> dict[str, Tensor]:
    """Noise of a cloud, with a field of our own."""
    return transform.draw(points, seed=seed) | {f"air.{name}": value[0] for name, value in field.items()}


def test_a_lidar_sees_through_the_mean_density_of_each_weather() -> None:
    noise = noise_of(7)
    weather = Mixture(
        Fog(mor_m=200, patch_log_std=0.5, patch_length_m=LENGTH_M),
        Rain(20, patch_log_std=0.3, patch_length_m=LENGTH_M),
        Snow(1.0),
    )
    transform = LidarWeather(weather, LIDAR)
    azimuth, range_m = np.array([-3.1, -1.0, 0.0, 0.4, 2.0]), np.array([60.0, 25.0, 12.0, 40.0, 33.0])
    points = cloud(azimuth, range_m, height_m=12.0)
    result = transform.run(points, in_field(transform, points, noise))
    extinction = {kind: float(part()) for kind, part in transform.chain.stages["extinction"].parts.items()}  # type: ignore[union-attr,operator]
    for one, far, found in zip(azimuth, range_m, result.transmission, strict=True):
        slant_m = math.hypot(far, 12.0)
        depth = extinction["fog"] * mean_density(noise, 0.5, one, far) + extinction["snow"]
        depth += extinction["rain"] * mean_density(noise, 0.3, one, far)
        assert -math.log(float(found)) / 2 / slant_m == pytest.approx(depth, rel=0.01)


def foggy_rain() -> LidarWeather:
    weather = Mixture(Fog(mor_m=200, patch_log_std=0.5), Rain(20, patch_log_std=0.3, patch_length_m=30.0))
    return LidarWeather(weather, replace(LIDAR, return_mode="dual"))


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_a_batch_is_its_samples_and_a_cloud_its_beams_bitwise(dtype: torch.dtype) -> None:
    transform, rng = foggy_rain(), np.random.default_rng(2)
    points = torch.stack([cloud(rng.uniform(-3.1, 3.1, 400), rng.uniform(2.0, 60.0, 400)) for _ in range(3)]).to(dtype)
    noise = transform.draw(points, seed=1)
    whole = transform.run(points, noise)
    for sample in range(3):
        own = {name: value[sample] for name, value in noise.items()}
        alone = transform.run(points[sample], own)
        assert torch.equal(alone.points, whole.points[sample])
        assert alone.points.dtype == dtype
        part = slice(37, 300, 7)
        cut = {name: value if name.startswith("air.") else value[..., part] for name, value in own.items()}
        assert torch.equal(transform.run(points[sample, part], cut).points, whole.points[sample, part])


@pytest.mark.parametrize("shape", [(0, 4), (2, 0, 4), (0, 5, 4)])
def test_empty_clouds_come_back_empty(shape: tuple[int, ...]) -> None:
    transform, nothing = foggy_rain(), torch.zeros(shape)
    assert transform.run(nothing, transform.draw(nothing, seed=1)).points.shape == shape


@pytest.mark.parametrize(
    ("kind", "weather"), [(LidarRain, Rain(50)), (LidarSnow, Snow(1.0)), (LidarFog, Fog(mor_m=60))]
)
def test_air_that_is_dense_everywhere_is_as_denser_weather(kind: type[LidarWeather], weather: Rain) -> None:
    """The sectors' tables, and solving by bisection, against those of one air and their grid."""
    log_std, g = 0.5, 1.2
    density = math.exp(log_std * g - 0.5 * log_std**2)
    patchy = kind(weather_from_dict({**weather.to_dict(), "patch_log_std": log_std}), LIDAR)
    beams = 20_000
    azimuth, range_m = np.linspace(-3.1, 3.1, beams), np.linspace(3.0, 50.0, beams)
    points = cloud(azimuth, range_m)
    noise = in_field(patchy, points, even(g))
    found = patchy.run(points, noise)
    effect = EFFECTS["lidar.patchy_weather"](log_std=1.0)
    uniform = kind(weather, LIDAR, effects=[effect])
    same = {name: value for name, value in noise.items() if not name.startswith("air.")}
    number = (math.log(density) + 0.5) / 1.0
    wanted = uniform.run(points, same | {"patchy_weather.density": torch.tensor([number])})
    # The grid of the tables interpolates what bisection solves: a beam in a thousand decides otherwise.
    assert float((found.kind != wanted.kind).float().mean()) < 2e-3
    both = (found.kind == PointKind.PARTICLE) & (wanted.kind == PointKind.PARTICLE)
    assert int(both.sum()) > 500
    apart_m = (found.points[both] - wanted.points[both])[:, :3].norm(dim=-1)
    assert float(apart_m.median()) < 0.02
    torch.testing.assert_close(found.transmission, wanted.transmission, rtol=1e-4, atol=1e-6)


def test_drops_are_where_the_air_is_dense() -> None:
    """Share of beams that see a drop, and where they see it, against an integral over the way."""
    log_std, field = 0.9, one_wave(0.0, 0.25, 0.5)
    rain = Rain(50, patch_log_std=log_std, patch_length_m=LENGTH_M)
    # The integral below knows no extinction, and no drops that add to one another within a pulse.
    transform = LidarRain(rain, replace(LIDAR, pulse_width_ns=1e-9), q_eff=0.0)
    returns = transform.chain.stages["particle_returns"]
    assert isinstance(returns, ParticleReturns)
    part = returns.kinds["rain"]
    assert isinstance(part, BeamParticles)
    azimuth = -math.pi + 2.0 * math.pi * 24 / 32  # the middle of a sector, to the left
    nodes_m = torch.linspace(0.6, 59.0, 600)
    threshold = returns.beam.threshold.expand(1, 600)
    above = part.expected_above(returns.beam, threshold, torch.zeros(1), nodes_m[None])[0]
    per_m = (above[1:] - above[:-1]).double().numpy()
    middle = 0.5 * (nodes_m[1:] + nodes_m[:-1]).double().numpy()
    g = g_at(field, middle * math.cos(azimuth), middle * math.sin(azimuth))
    dense = per_m * np.exp(log_std * g - 0.5 * log_std**2)
    beams = 40_000
    direction = torch.tensor([math.cos(azimuth), math.sin(azimuth), 0.0]).expand(beams, 3)
    nothing = torch.zeros(beams, 4)
    result = transform.run(nothing, in_field(transform, nothing, field), directions=direction)
    share, wanted = float((result.kind == PointKind.PARTICLE).double().mean()), -math.expm1(-dense.sum())
    assert share == pytest.approx(wanted, abs=4 * math.sqrt(wanted / beams))
    assert abs(share + math.expm1(-per_m.sum())) > 20 * math.sqrt(wanted / beams)  # not that of uniform air


def test_returns_of_fog_come_from_the_bank() -> None:
    """A thin place around the sensor and a bank ahead: the fog's echo lies deeper than in uniform fog."""
    field, lidar = one_wave(0.8, 0.0, 0.5), Lidar(wavelength_nm=905.0, range_at_10_percent_m=60.0)
    fog = Fog(mor_m=40, patch_log_std=1.2, patch_length_m=LENGTH_M)
    patchy, uniform = LidarFog(fog, lidar), LidarFog(Fog(mor_m=40), lidar)
    beams = 4000
    ahead, nothing = torch.tensor([1.0, 0.0, 0.0]).expand(beams, 3), torch.zeros(beams, 4)
    found = patchy.run(nothing, in_field(patchy, nothing, field), directions=ahead)
    plain = uniform.run(nothing, uniform.draw(nothing, seed=1), directions=ahead)
    far, near = (float(r.points[r.kind == PointKind.PARTICLE][:, 0].median()) for r in (found, plain))
    assert far > near + 2.0


# ---- camera ------------------------------------------------------------------------------------------------------


def test_a_camera_sees_through_the_mean_density_along_its_rays() -> None:
    noise, log_std, depth_m = noise_of(11), 0.7, 35.0
    tilted = replace(CAMERA, pitch_rad=-0.1, roll_rad=0.2)
    fog = BayerFog(Fog(mor_m=60, patch_log_std=log_std, patch_length_m=LENGTH_M), tilted, depth=depth_m, airlight=0.7)
    frame = torch.full((1, 96, 128), 0.3)
    result = fog.run(frame, noise={f"air.{name}": value[0] for name, value in noise.items()})
    stage = fog.chain.stages["extinction_and_airlight"]
    assert isinstance(stage, ExtinctionAndAirlight)
    alpha = float(stage.extinction_per_m(1)[0, 1])
    rotation = np.array(tilted.camera_from_vehicle())
    for row, column in ((10, 1), (10, 121), (80, 61), (50, 11)):
        assert (row + column) % 2 == 1  # a green pixel of RGGB
        ray = np.array([(column - 63.5) / 100, (row - 47.5) / 100, 1.0])
        forward, left, _ = rotation.T @ ray * depth_m
        mean = mean_density(noise, log_std, math.atan2(left, forward), math.hypot(forward, left))
        wanted = alpha * depth_m * float(np.linalg.norm(ray)) * mean
        assert -math.log(float(result.transmission[0, row, column])) == pytest.approx(wanted, rel=0.01)


def test_a_camera_in_dense_air_counts_as_with_more_particles() -> None:
    log_std, g = 0.5, 1.2
    density = math.exp(log_std * g - 0.5 * log_std**2)
    frame = torch.full((1, 96, 128), 0.2)
    patchy = BayerRain(Rain(20, patch_log_std=log_std), CAMERA, depth=25.0, airlight=0.7)
    noise = patchy.draw(frame, seed=2)
    found = patchy.run(frame, noise=noise | {f"air.{name}": value[0] for name, value in even(g).items()})
    more = BayerRain(
        Rain(20), CAMERA, depth=25.0, airlight=0.7, effects=[EFFECTS["camera.particle_count"](factor=density)]
    )
    wanted = more.run(frame, noise={name: value for name, value in noise.items() if not name.startswith("air.")})
    torch.testing.assert_close(found.particle_mask, wanted.particle_mask, rtol=1e-3, atol=1e-5)


def test_drops_in_the_picture_follow_the_density_in_front_of_it() -> None:
    """Optical depth of all drops is the extinction of geometrical optics times the mean density on the way."""
    log_std, field, depth_m, frames = 0.6, one_wave(0.0, 0.25, 0.75), 30.0, 6
    rain = Rain(50, patch_log_std=log_std, patch_length_m=LENGTH_M)
    patchy, uniform = (BayerRain(one, CAMERA, depth=depth_m, airlight=0.7) for one in (rain, Rain(50)))
    frame = torch.full((frames, 1, 96, 128), 0.2)
    noise = patchy.draw(frame, seed=1) | {f"air.{k}": v.expand(frames, *v.shape[1:]) for k, v in field.items()}
    drops = {key: value for key, value in noise.items() if not key.startswith("air.")}
    pairs = ((patchy, noise), (uniform, drops))
    masks = [one.run(frame, noise=own).particle_mask.double()[:, 0] for one, own in pairs]
    strips = [mask.reshape(frames, 96, 8, 16).mean((1, 3)) for mask in masks]
    azimuth = [math.atan2(-(16 * k + 7.5 - 63.5) / 100.0, 1.0) for k in range(8)]
    wanted = np.array([mean_density(field, log_std, a, depth_m / math.cos(a)) for a in azimuth])
    ratio = strips[0].mean(0) / strips[1].mean(0)
    # Of 6 frames; the standard error of a strip's mean is measured from frame to frame. Masks are up to 12 % and
    # saturate: -ln(1 - M) is what adds up.
    depths = [-torch.log1p(-strip.mean(0)) for strip in strips]
    error = (strips[0].std(0) / strips[0].mean(0)).numpy() / math.sqrt(frames)
    assert np.all(np.abs((depths[0] / depths[1]).numpy() / wanted - 1) < 4 * error + 0.02)
    assert float(ratio.max() / ratio.min()) > 2.0  # and not uniform


def test_patches_of_a_sequence_move_with_wind_and_vehicle() -> None:
    rain = Rain(5, patch_log_std=0.5, wind_m_per_s=(2.0, 1.0, 0.0))
    camera = BayerRain(rain, CAMERA, depth=20.0, airlight=0.7, ego_speed_m_per_s=10.0)
    air = camera.chain.stages["air"]
    assert isinstance(air, PatchyAir)
    assert air.drift_m_per_s == (-8.0, 1.0)
    frame = torch.full((1, 96, 128), 0.2)
    first, second = camera.draw_sequence(frame, 2, 0.1, seed=4)
    assert torch.equal(first["air.wave"], second["air.wave"])
    moved = air.next_frame({"wave": first["air.wave"], "phase": first["air.phase"]}, 0.1)
    assert torch.equal(second["air.phase"], moved["phase"])
    assert not torch.equal(second["air.phase"], first["air.phase"])


# ---- radar -------------------------------------------------------------------------------------------------------


def test_a_radar_loses_by_the_mean_density_on_the_way() -> None:
    noise, log_std = noise_of(13), 0.7
    transform = RadarAttenuation(
        Mixture(Rain(30, patch_log_std=log_std, patch_length_m=LENGTH_M), Fog(mor_m=50)), RADAR
    )
    azimuth, range_m = np.array([-0.5, 0.0, 0.6]), np.array([20.0, 60.0, 90.0])
    columns = [range_m * np.cos(azimuth), range_m * np.sin(azimuth), 0 * range_m, 0 * range_m, 0 * range_m - 60.0]
    points = torch.from_numpy(np.stack([*columns, 0 * range_m + 10.0], -1)).float()
    own = transform.draw(points, seed=1) | {f"air.{name}": value[0] for name, value in noise.items()}
    result = transform.run(points, own)
    parts = {kind: float(part()) for kind, part in transform.chain.stages["path_attenuation"].parts.items()}  # type: ignore[union-attr,operator]
    for one, far, found in zip(azimuth, range_m, result.attenuation_db, strict=True):
        per_km = parts["rain"] * mean_density(noise, log_std, one, far) + parts["fog"]
        assert float(found) == pytest.approx(2e-3 * per_km * far, rel=0.01)


def test_clutter_follows_the_density() -> None:
    log_std, g = 0.5, 1.2
    density = math.exp(log_std * g - 0.5 * log_std**2)
    transform = RadarAttenuation(Rain(20, patch_log_std=log_std), RADAR, clutter=True, clutter_points=400)
    stage = transform.chain.stages["rain_clutter"]
    assert isinstance(stage, VolumeClutter)
    detection = torch.tensor([[50.0, 0.0, 0.0, 0.0, -60.0, 10.0]])
    state = transform.state_of(detection)
    state = transform.chain.stages["path_attenuation"](replace(state), {})
    noise = stage.draw(state, seed=[3])
    air = transform.chain.stages["air"]
    assert isinstance(air, PatchyAir)
    attenuation, before = transform.chain.stages["path_attenuation"], transform.state_of(detection)
    found = stage(attenuation(before.changed(patches=air.field(even(g))), {}), noise)
    denser = VolumeClutter(Rain(20), RADAR, share=density, capacity=400)
    wanted = denser(state.changed(attenuation_db_per_km=density * state.air.attenuation_db_per_km), noise)
    assert int(wanted.returns.clutter_valid.sum()) > 100
    assert torch.equal(found.returns.clutter_valid, wanted.returns.clutter_valid)
    torch.testing.assert_close(found.returns.clutter, wanted.returns.clutter, rtol=2e-3, atol=2e-2)
    # Dense to the left and thin to the right, g = sqrt(2) sin(2 pi y / l): more is seen on the left.
    left = []
    for of_seed in range(10):
        patches = PatchyAir(LENGTH_M).field(one_wave(0.0, 1.0, 0.75))
        uneven = stage(attenuation(before.changed(patches=patches), {}), stage.draw(state, seed=[of_seed]))
        left.append(uneven.returns.clutter[uneven.returns.clutter_valid][:, 1] > 0)
    share = torch.cat(left).double()
    assert float(share.mean()) > 0.5 + 8 * 0.5 / math.sqrt(len(share))


def test_the_way_to_clutter_goes_through_the_patches_of_the_other_weather() -> None:
    """Snow that falls evenly, seen through rain that is dense everywhere."""
    density = math.exp(0.5 * 1.2 - 0.125)
    transform = RadarAttenuation(Mixture(Rain(50, patch_log_std=0.5), Snow(1.0)), RADAR, clutter=True)
    stage, attenuation, air = (transform.chain.stages[name] for name in ("snow_clutter", "path_attenuation", "air"))
    assert isinstance(stage, VolumeClutter)
    assert isinstance(air, PatchyAir)
    state = transform.state_of(torch.tensor([[50.0, 0.0, 0.0, 0.0, -60.0, 10.0]]))
    found = stage._denser(torch.tensor([[20.0, 60.0]]), attenuation(state.changed(patches=air.field(even(1.2))), {}))
    assert found is not None
    per_km = float(attenuation.parts["rain"]())  # type: ignore[union-attr,operator,index]
    for place, range_m in enumerate((20.0, 60.0)):
        wanted = 10.0 ** (-0.1 * 2e-3 * per_km * range_m * (density - 1.0))
        assert float(found[0, place].min()) == pytest.approx(wanted, rel=1e-3)
        assert float(found[0, place].max()) == pytest.approx(wanted, rel=1e-3)


# ---- what it refuses ---------------------------------------------------------------------------------------------


@pytest.mark.parametrize("given", [{"patch_log_std": -0.1}, {"patch_log_std": 3.0}, {"patch_length_m": 1.0}])
def test_patches_beyond_reason_are_refused(given: dict[str, float]) -> None:
    for kind, intensity in ((Rain, 5.0), (Snow, 1.0), (Fog, 50.0)):
        with pytest.raises(ValueError, match=next(iter(given))):
            kind(intensity, **given)


def test_patches_are_refused_where_there_are_none() -> None:
    patchy = Rain(20, patch_log_std=0.3)
    with pytest.raises(ValueError, match="has no patches"):
        LidarRain(patchy, LIDAR, variant="d3_4")
    with pytest.raises(ValueError, match="expected weather without patches"):
        FmcwRadar(Radar.preset("awr1843-like"), patchy)
    with pytest.raises(ValueError, match="air"):
        LidarRain(patchy, LIDAR).expected(torch.tensor([[10.0, 0.0, 0.0, 0.3]]))
    with pytest.raises(ValueError, match="one patch_length_m"):
        Mixture(Rain(5, patch_log_std=0.3, patch_length_m=50), Fog(mor_m=50, patch_log_std=0.3, patch_length_m=20))
    Mixture(Rain(5, patch_length_m=50), Fog(mor_m=50, patch_log_std=0.3, patch_length_m=20))


def test_weather_without_patches_has_no_stage_for_them() -> None:
    assert "air" not in LidarRain(Rain(5), LIDAR).chain.stages
    assert "air" not in BayerRain(Rain(5), CAMERA).chain.stages
    assert "air" not in RadarAttenuation(Rain(5), RADAR).chain.stages
