"""Rain and snow in a camera's frustum: counts, areas, directions, depth, colour (PHYSICS.md 4.1-4.7)."""

from __future__ import annotations

import math
from typing import Any

import pytest
import torch
from torch import Tensor

from tests.reference.every_particle import geometric_extinction, population
from torchweather.atmosphere.weather import Fog, Mixture, Rain, Snow
from torchweather.camera.flake_light import flake_light
from torchweather.camera.particles.population import Population
from torchweather.camera.particles.streaks import Marks
from torchweather.physics import Binned
from torchweather.sensors import Camera
from torchweather.stages import ParticleVeil
from torchweather.transforms import BayerFog, BayerRain, BayerSnow, BayerWeather

F_PX = 1137.4
DARK = 0.1


def camera_of(height: int = 96, width: int = 96, **more: Any) -> Camera:
    values = {"exposure_s": 0.005, **more}
    return Camera.from_intrinsics(F_PX, F_PX, (width - 1) / 2, (height - 1) / 2, width, height, **values)


def frame(camera: Camera, value: float = DARK) -> Tensor:
    return torch.full((1, camera.height, camera.width), value)


def masks(transform: BayerWeather, seeds: range, depth_m: float | Tensor) -> Tensor:
    """Particle masks ``(seeds, H, W)``."""
    given = frame(transform.camera)
    depth = depth_m if isinstance(depth_m, Tensor) else torch.full_like(given, depth_m)
    found = [transform.run(given, depth, transform.draw(given, seed=seed)).particle_mask[0] for seed in seeds]
    return torch.stack(found)


def veil_of(transform: BayerWeather) -> ParticleVeil:
    veil = transform.chain.stages["particle_veil"]
    assert isinstance(veil, ParticleVeil)
    return veil


def marks_of(transform: BayerWeather, seed: int, depth_m: float = 1e3) -> tuple[Marks, Population]:
    """All particles that are drawn one by one, as marks in the image."""
    given = frame(transform.camera)
    state = transform._state(given, torch.full_like(given, depth_m))
    part = veil_of(transform).parts[0]
    noise = {key.removeprefix("particle_veil."): value[None] for key, value in transform.draw(given, seed=seed).items()}
    tables = part.at_rate(1)
    portions = [
        marks for number in range(len(part.tables.listed)) for marks in part.marks(state, noise, tables, number)
    ]

    def join(name: str) -> Tensor:
        return torch.cat([getattr(marks, name)[marks.opacity > 0] for marks in portions])

    motion_u = None if portions[0].motion_u_px is None else join("motion_u_px")
    rest = {name: join(name) for name in ("u_px", "v_px", "motion_v_px", "width_px", "opacity", "depth_m")}
    return Marks(sample=None, motion_u_px=motion_u, **rest), part


def within(marks: Marks, camera: Camera) -> Tensor:
    across, down = (marks.u_px - (camera.width - 1) / 2).abs(), (marks.v_px - (camera.height - 1) / 2).abs()
    return (across < camera.width / 2) & (down < camera.height / 2)


# ---- how many, how large -------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("kind", "rate", "near_m", "far_m", "n_seeds"),
    [("rain", 50.0, 1.5, 4.0, 30), ("rain", 3.0, 1.5, 4.0, 40), ("snow", 2.0, 1.5, 4.0, 60)],
)
def test_every_particle_of_the_frustum_is_there_with_its_size(
    kind: str, rate: float, near_m: float, far_m: float, n_seeds: int
) -> None:
    """At a tiny cut nearly all particles are drawn one by one: count and area are the distribution's."""
    weather = Rain(rate) if kind == "rain" else Snow(rate)
    camera = camera_of()
    transform = BayerWeather(weather, camera, near_m=near_m, far_m=far_m, min_listed_coverage=1e-6, airlight=0.7)
    counts, areas = [], []
    for seed in range(n_seeds):
        marks, _ = marks_of(transform, seed)
        inside = within(marks, camera)
        counts.append(int(inside.sum()))
        # d^2 per px^2 is D^2 per m^2 of the plane at the particle's depth.
        areas.append(float((math.pi / 4 * marks.width_px[inside] ** 2).sum()))
    truth = population(kind, rate)  # type: ignore[arg-type]
    volume_m3 = camera.height * camera.width / F_PX**2 * (far_m**3 - near_m**3) / 3
    # Peaks below 1e-6 are the smallest drops at 4 m: none of them here (d = 0.03 px gives 1e-3 * 0.02).
    mean = truth.per_m3 * volume_m3
    assert sum(counts) / n_seeds == pytest.approx(mean, abs=4.5 * math.sqrt(mean / n_seeds) + 0.005 * mean)
    area = geometric_extinction(truth) * (far_m - near_m) * camera.height * camera.width
    # The area's variance is that of its d^4: taken from the draws themselves.
    spread = torch.tensor(areas, dtype=torch.float64).std().item() / math.sqrt(n_seeds)
    assert sum(areas) / n_seeds == pytest.approx(area, abs=4.5 * spread + 0.005 * area)


@pytest.mark.parametrize("rate", [0.013, 0.7, 3.3, 17.0, 61.0, 100.0])
def test_haze_alone_has_the_optical_depth_of_all_drops(rate: float) -> None:
    """At a least coverage of 1 no drop is listed: the table over rate and depth has the closed-form extinction."""
    weather = Rain(torch.tensor(rate)) if rate > 0.1 else Rain(0.2)
    veil = ParticleVeil([weather], camera_of(), near_m=1.5, far_m=60.0, min_listed_coverage=1.0, ambient=0.7)
    rate = float(weather.rate_mm_per_h)
    depth = veil.parts[0].at_rate(1).haze_depth[0, -1] * veil.parts[0].focal_px
    alpha = geometric_extinction(population("rain", rate))
    assert float(depth) == pytest.approx(alpha * (60.0 - 1.5), rel=5e-3)


@pytest.mark.parametrize("rate", [0.37, 2.9, 17.0, 83.0])
def test_sizes_read_from_the_tables_are_those_of_the_rate(rate: float) -> None:
    """The n-th largest drop per m^3 of Marshall-Palmer rain, in closed form, at rates between the table's nodes."""
    part = ParticleVeil([Rain(rate)], camera_of(), ambient=0.7).parts[0]
    n0, slope = 8000.0, 4.1 * rate**-0.21
    outline_m = part.at_rate(1).outline_m[0].double()
    nodes = torch.arange(len(outline_m), dtype=torch.float64)
    levels = torch.exp(part.tables.log_level_low + part.tables.log_level_step * nodes)
    truncated = math.exp(-slope * 8.0)
    wanted_mm = -torch.log(levels * slope / n0 + truncated) / slope
    # Rarer than one in 100 m^3 are within 1 % of the largest size, 8 mm, and hardly come.
    seen = (levels > 1e-2) & (wanted_mm > 0.11)
    assert int(seen.sum()) > 50
    assert torch.allclose(1e3 * outline_m[seen], wanted_mm[seen], rtol=5e-3)


def test_a_new_rate_needs_no_new_tables() -> None:
    first, other = (ParticleVeil([Rain(rate)], camera_of(), ambient=0.7).parts[0] for rate in (5.0, 50.0))
    assert first.tables is other.tables


# ---- the mask ------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("depth_m", "far_m"), [(10.0, 200.0), (math.inf, 10.0)], ids=["wall", "sky"])
def test_mask_mean_is_the_extinction_up_to_the_wall_or_to_the_far_limit(depth_m: float, far_m: float) -> None:
    camera = camera_of(128, 192)
    transform = BayerRain(Rain(50.0), camera, near_m=1.5, far_m=far_m, airlight=0.7)
    found = masks(transform, range(16), depth_m).double()
    wanted = -math.expm1(-geometric_extinction(population("rain", 50.0)) * (10.0 - 1.5))
    per_seed = found.mean((1, 2))
    error = float(per_seed.std()) / math.sqrt(len(per_seed))
    assert float(per_seed.mean()) == pytest.approx(wanted, abs=4.5 * error + 0.005 * wanted)


def test_nothing_falls_before_the_near_limit() -> None:
    transform = BayerRain(Rain(50.0), camera_of(), near_m=2.0, airlight=0.7)
    assert float(masks(transform, range(2), 1.9).max()) == 0.0


def test_the_scene_hides_particles_pixel_by_pixel() -> None:
    camera = camera_of()
    transform = BayerRain(Rain(50.0), camera, near_m=1.5, airlight=0.7)
    depth = torch.full((1, 96, 96), 20.0)
    depth[:, :, :48] = 3.0
    free, hidden = masks(transform, range(4), 20.0), masks(transform, range(4), depth)
    assert torch.equal(hidden[..., 48:], free[..., 48:])
    assert bool((hidden[..., :48] <= free[..., :48] + 1e-6).all())
    assert float(hidden[..., :48].mean()) < 0.3 * float(free[..., :48].mean())


@pytest.mark.slow
@pytest.mark.parametrize("weather", [Rain(50.0), Snow(3.0)], ids=["rain", "snow"])
@pytest.mark.parametrize(
    ("limit", "values_of_limit"),
    [("min_listed_coverage", (1 / 256, 1 / 1024, 1 / 4096)), ("max_listed_density", (0.1, 0.25, 1e9))],
    ids=["min_listed_coverage", "max_listed_density"],
)
def test_the_sum_of_listed_and_haze_does_not_depend_on_what_is_listed(
    weather: Rain | Snow, limit: str, values_of_limit: tuple[float, ...]
) -> None:
    n_seeds, camera = 24, camera_of()
    mean, std = [], []
    for value in values_of_limit:
        options: dict[str, float] = {"near_m": 1.5, "airlight": 0.7, limit: value}
        found = masks(BayerWeather(weather, camera, **options), range(n_seeds), 8.0).double()  # type: ignore[arg-type]
        mean.append(found.mean((1, 2)))
        std.append(found.std((1, 2), correction=0))
    for values, share in ((mean, 0.01), (std, 0.03)):
        middle = values[1].mean()
        for other in (values[0], values[2]):
            # Draws at another limit are other draws: two independent means.
            error = math.sqrt(float(other.var() + values[1].var()) / n_seeds)
            assert float(other.mean()) == pytest.approx(float(middle), abs=3.5 * error + share * float(middle))


@pytest.mark.parametrize(("kind", "highest"), [(Rain, 100.0), (Snow, 10.0)], ids=["rain", "snow"])
def test_with_one_draw_held_twenty_rising_rates_never_lower_the_mask_mean(
    kind: type[Rain] | type[Snow], highest: float
) -> None:
    camera = camera_of(64, 64)
    rates = torch.logspace(math.log10(0.2), math.log10(highest), 20)
    given = frame(camera)
    means = []
    noise = BayerWeather(kind(1.0), camera, airlight=0.7).draw(given, seed=5)
    for rate in rates.tolist():
        transform = BayerWeather(kind(rate), camera, near_m=0.5, airlight=0.7)
        means.append(float(transform.run(given, torch.full_like(given, 30.0), noise).particle_mask.double().mean()))
    rises = torch.tensor(means).diff()
    assert bool((rises > 0).all() if kind is Rain else (rises >= 0).all())


def test_with_one_draw_held_earlier_drops_stay_where_they_were_and_grow() -> None:
    camera = camera_of(64, 64)
    earlier: Marks | None = None
    for rate in torch.logspace(math.log10(0.5), math.log10(100.0), 20).tolist():
        marks, _ = marks_of(BayerRain(Rain(rate), camera, near_m=1.0, far_m=6.0, airlight=0.7), seed=5)
        place = {(u, v): n for n, (u, v) in enumerate(zip(marks.u_px.tolist(), marks.v_px.tolist(), strict=True))}
        if earlier is not None:
            old = list(zip(earlier.u_px.tolist(), earlier.v_px.tolist(), strict=True))
            assert set(old) <= set(place)
            now = torch.tensor([place[at] for at in old], dtype=torch.long)
            assert torch.equal(marks.depth_m[now], earlier.depth_m)
            assert bool((marks.width_px[now] >= earlier.width_px * (1 - 1e-5)).all())
        earlier = marks
    assert earlier is not None
    assert len(earlier) > 300


# ---- shape and direction -------------------------------------------------------------------------------------------


def test_a_streak_is_as_long_as_its_drop_falls_in_the_exposure() -> None:
    marks, part = marks_of(BayerRain(Rain(50.0), camera_of(), near_m=1.0, far_m=6.0, airlight=0.7), seed=1)
    diameter_mm = marks.width_px * marks.depth_m / F_PX * 1e3
    speed = part.weather.fall_speed_m_per_s(diameter_mm.double())
    # Sizes and speeds are read from tables over the level, separately: 0.6 % at the speed law's kink at 0.5 mm.
    assert torch.allclose(marks.motion_v_px.double(), F_PX * speed * 0.005 / marks.depth_m, rtol=1e-2)
    assert marks.motion_u_px is None or not bool(marks.motion_u_px.any())


def test_wind_slants_streaks_by_its_share_of_the_fall_speed() -> None:
    weather = Rain(50.0, wind_m_per_s=(0.0, 3.0, 0.0))  # from the right to the left
    marks, part = marks_of(BayerRain(weather, camera_of(), near_m=1.0, far_m=6.0, airlight=0.7), seed=1)
    assert marks.motion_u_px is not None
    speed = part.weather.fall_speed_m_per_s((marks.width_px * marks.depth_m / F_PX * 1e3).double())
    assert torch.allclose((-marks.motion_u_px / marks.motion_v_px).double(), 3.0 / speed, rtol=1e-2)


def test_updraught_slows_the_fall() -> None:
    weather = Rain(50.0, wind_m_per_s=(0.0, 0.0, 1.0))
    marks, part = marks_of(BayerRain(weather, camera_of(), near_m=1.0, far_m=6.0, airlight=0.7), seed=1)
    speed = part.weather.fall_speed_m_per_s((marks.width_px * marks.depth_m / F_PX * 1e3).double())
    assert torch.allclose(
        marks.motion_v_px.double(), F_PX * (speed - 1.0) * 0.005 / marks.depth_m, rtol=1e-2, atol=0.02
    )


@pytest.mark.parametrize("roll_rad", [0.3, -0.6])
def test_a_rolled_camera_sees_tilted_streaks(roll_rad: float) -> None:
    transform = BayerRain(Rain(50.0), camera_of(roll_rad=roll_rad), near_m=1.0, airlight=0.7)
    found = masks(transform, range(4), 6.0).double()
    # Smoothed, because a narrow slanted line on the pixel grid is a staircase.
    found = torch.nn.functional.avg_pool2d(torch.nn.functional.avg_pool2d(found, 5, 1), 5, 1)
    down, across = found.diff(dim=1)[:, :, :-1], found.diff(dim=2)[:, :-1]
    # The image changes least along the streaks: the structure tensor's minor axis, from straight down.
    jvv, juu, juv = float((down**2).mean()), float((across**2).mean()), float((down * across).mean())
    angle = 0.5 * math.atan2(-2 * juv, juu - jvv)
    # Two hundred streaks and the slope between pixels leave a few degrees.
    assert angle == pytest.approx(roll_rad, abs=0.08)


def test_driving_makes_streaks_radial() -> None:
    camera = camera_of()
    transform = BayerRain(Rain(20.0), camera, near_m=1.0, far_m=6.0, ego_speed_m_per_s=40.0, airlight=0.7)
    marks, part = marks_of(transform, seed=1)
    assert marks.motion_u_px is not None
    x, y = (marks.u_px - 47.5) / F_PX, (marks.v_px - 47.5) / F_PX
    speed = part.weather.fall_speed_m_per_s((marks.width_px * marks.depth_m / F_PX * 1e3).double())
    scale = F_PX * 0.005 / marks.depth_m
    assert torch.allclose(marks.motion_u_px, x * 40.0 * scale, rtol=1e-3, atol=1e-4)
    # 1 % of the fall speed, which the tables give; the vehicle's motion may take away nearly all of it.
    off = (marks.motion_v_px.double() - (speed + y * 40.0) * scale).abs()
    assert bool((off <= 1e-2 * speed * scale + 1e-2).all())


def test_pitch_changes_the_apparent_fall() -> None:
    """Straight up, drops come at the camera: their paths are radial and nearly gone on the axis."""
    camera = camera_of(pitch_rad=math.pi / 2)
    marks, part = marks_of(BayerRain(Rain(20.0), camera, near_m=1.0, far_m=6.0, airlight=0.7), seed=1)
    assert marks.motion_u_px is not None
    speed = part.weather.fall_speed_m_per_s((marks.width_px * marks.depth_m / F_PX * 1e3).double())
    x = (marks.u_px - 47.5) / F_PX
    assert torch.allclose(marks.motion_u_px.double(), x * speed * F_PX * 0.005 / marks.depth_m, rtol=1e-2, atol=1e-3)


def test_distortion_moves_and_bends_but_keeps_the_mask() -> None:
    """Barrel distortion shows more of the world at the border, each drop smaller: the mean cover stays."""
    plain, bent = camera_of(128, 192), camera_of(128, 192, k1=-4.0)  # r = 0.1 at the corner: 4 % inwards
    found = [
        masks(BayerRain(Rain(50.0), camera, near_m=1.5, airlight=0.7), range(16), 8.0).double().mean((1, 2))
        for camera in (plain, bent)
    ]
    error = math.sqrt(float(found[0].var() + found[1].var()) / 16)
    assert float(found[1].mean()) == pytest.approx(float(found[0].mean()), abs=4.5 * error)
    marks, _ = marks_of(BayerRain(Rain(50.0), bent, near_m=1.5, far_m=8.0, airlight=0.7), seed=1)
    assert marks.motion_u_px is not None
    x, y = marks.u_px - 95.5, marks.v_px - 63.5
    corner = (x.abs() > 60) & (y.abs() > 40)
    # Under barrel distortion vertical lines bow outwards in the middle: a path in a corner leans towards the axis.
    leaning = marks.motion_u_px[corner] * torch.sign(x[corner]) * torch.sign(y[corner])
    assert bool((leaning < 0).all())


@pytest.mark.parametrize("focus_m", [None, 4.0])
def test_defocus_spreads_the_marks_and_keeps_their_area(focus_m: float | None) -> None:
    sharp = camera_of()
    blurred = camera_of(f_number=2.0, focal_length_mm=25.0, focus_distance_m=focus_m)
    options: dict[str, Any] = {"near_m": 1.5, "far_m": 6.0, "min_listed_coverage": 1e-6, "airlight": 0.7}
    found = masks(BayerRain(Rain(50.0), sharp, **options), range(16), 100.0).double()
    soft = masks(BayerRain(Rain(50.0), blurred, **options), range(16), 100.0).double()
    error = math.sqrt(float(found.mean((1, 2)).var() + soft.mean((1, 2)).var()) / 16)
    assert float(soft.mean()) == pytest.approx(float(found.mean()), abs=4.5 * error)
    assert float(soft.std()) < 0.9 * float(found.std())
    marks, _ = marks_of(BayerRain(Rain(50.0), blurred, **options), seed=1)
    away = 1.0 if focus_m is None else (marks.depth_m - focus_m).abs() / focus_m
    circle_px = 12.5e-3 * F_PX / marks.depth_m * away  # aperture 25 mm / 2
    assert bool((marks.width_px >= circle_px * (1 - 1e-4)).all())


def test_variant_d3_4_blends_by_one_plus_d_over_the_way() -> None:
    options: dict[str, Any] = {"near_m": 1.0, "far_m": 6.0, "airlight": 0.7}
    marks, _ = marks_of(BayerRain(Rain(50.0), camera_of(), variant="d3_4", **options), seed=1)
    assert torch.allclose(marks.opacity, (1 + marks.width_px) / marks.width_px, rtol=1e-5)
    right, _ = marks_of(BayerRain(Rain(50.0), camera_of(), **options), seed=1)
    assert bool((right.opacity == 1).all())


# ---- colour --------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("pattern", ["RGGB", "GBRG", "RCCB"])
def test_drops_show_the_scene_and_six_percent_of_the_sky(pattern: str) -> None:
    """(1 - M) I + M (0.94 mean + 0.06 sky), per colour of the mosaic."""
    camera = camera_of(bayer_pattern=pattern)
    scene = torch.rand((1, 96, 96), generator=torch.Generator().manual_seed(0)) * 0.4
    transform = BayerRain(Rain(80.0), camera, near_m=1.0, depth=20.0, airlight=0.9)
    result = transform.run(scene, noise=transform.draw(scene, seed=2))
    colours = {letter: torch.zeros(96, 96, dtype=torch.bool) for letter in pattern}
    for place, letter in enumerate(pattern):
        colours[letter][place // 2 :: 2, place % 2 :: 2] = True
    for where in colours.values():
        drop = 0.94 * scene[0][where].mean() + 0.06 * 0.9
        mask = result.particle_mask[0][where]
        assert torch.allclose(result.bayer[0][where], (1 - mask) * scene[0][where] + mask * drop, atol=1e-6)


def test_flakes_are_white_in_the_light_of_sky_and_ground() -> None:
    transform = BayerSnow(Snow(3.0, albedo=0.85), camera_of(), near_m=1.0, depth=20.0, airlight=0.8)
    given = frame(transform.camera)
    result = transform.run(given, noise=transform.draw(given, seed=2))
    mask = result.particle_mask
    colour = 0.85 * flake_light(transform.state_of(given), torch.full((1, 3), 0.8))
    per_pixel = colour[0, torch.tensor([[0, 1], [1, 2]])].repeat(given.shape[-2] // 2, given.shape[-1] // 2)
    assert 0.34 < float(colour.min()) < 0.5  # half of 0.8 and a dark ground
    assert torch.allclose(result.bayer, (1 - mask) * given + mask * per_pixel, atol=1e-6)
    assert bool((result.bayer >= given).all())


def test_drops_may_show_the_upper_part_of_the_scene_only() -> None:
    scene = frame(camera_of())
    scene[:, :57] = 0.6  # the upper three fifths of 96 rows are 57.6: 56 whole rows of cells
    options: dict[str, Any] = {"near_m": 1.0, "depth": 20.0, "airlight": 0.6, "min_listed_coverage": 1e-3}
    transform = BayerRain(Rain(80.0), camera_of(), drop_radiance="upper", **options)
    noise = transform.draw(scene, seed=2)
    assert torch.allclose(transform(scene, noise=noise)[:, :56], scene[:, :56], atol=1e-6)
    whole = BayerRain(Rain(80.0), camera_of(), **options)
    assert float((whole(scene, noise=noise)[:, :56] - scene[:, :56]).abs().max()) > 1e-3


def test_fog_hides_far_flakes_and_leaves_near_ones() -> None:
    camera, snow, fog = camera_of(), Snow(8.0), Fog(10.0)
    scene = frame(camera, 0.05)
    without = BayerFog(fog, camera, depth=80.0, airlight=0.9)(scene)

    def seen(near_m: float) -> float:
        transform = BayerWeather(Mixture(snow, fog), camera, near_m=near_m, far_m=80.0, depth=80.0, airlight=0.9)
        return float((transform(scene, noise=transform.draw(scene, seed=1)) - without).abs().max())

    # The flakes are 0.09 darker than the fog; 20 m of it let exp(-0.3 * 20) = 0.25 % of that through.
    assert seen(20.0) < 0.09 * math.exp(-0.29 * 20.0)
    assert seen(0.5) > 0.02


def test_rain_and_snow_together_cover_as_both() -> None:
    camera = camera_of()
    given = frame(camera)
    both = BayerWeather(Mixture(Rain(30.0), Snow(2.0)), camera, depth=20.0, airlight=0.8)
    noise = both.draw(given, seed=3)
    mask = both.run(given, noise=noise).particle_mask
    clear = [
        1 - BayerWeather(one, camera, depth=20.0, airlight=0.8).run(given, noise=noise).particle_mask
        for one in (Rain(30.0), Snow(2.0))
    ]
    assert torch.allclose(1 - mask, clear[0] * clear[1], atol=1e-6)


# ---- other -----------------------------------------------------------------------------------------------------------


def test_measured_drops_fall_too() -> None:
    measured = Rain(20.0, size_distribution=Binned([0.3, 0.6, 1.0, 2.0, 4.0], [2000.0, 900.0, 150.0, 4.0]))
    found = masks(BayerRain(measured, camera_of(), near_m=1.5, airlight=0.7), range(12), 10.0).double()
    distribution = measured.distribution()
    diameter = torch.linspace(0.3, 4.0, 20001, dtype=torch.float64)
    area = torch.trapezoid(diameter**2 * distribution.number_density_per_m3_mm(diameter), diameter)
    wanted = -math.expm1(-math.pi / 4 * 1e-6 * float(area) * 8.5)
    error = float(found.mean((1, 2)).std()) / math.sqrt(12)
    assert float(found.mean()) == pytest.approx(wanted, abs=4.5 * error + 0.01 * wanted)


@pytest.mark.parametrize(
    ("options", "wanted"),
    [
        ({"near_m": 0.0}, "near_m must be above 0 m"),
        ({"near_m": 10.0, "far_m": 15.0}, "far_m must be 20 m or more"),
        ({"min_listed_coverage": 0.0}, "min_listed_coverage must lie in"),
        ({"ego_speed_m_per_s": 300.0}, "ego_speed_m_per_s must lie in -100..100 m/s"),
        ({"drop_radiance": "lower"}, "drop_radiance must be one of frame, upper; got 'lower'"),
        ({"variant": "d34"}, "variant must be one of d3_4; got 'd34'"),
    ],
)
def test_impossible_options_are_refused(options: dict[str, Any], wanted: str) -> None:
    with pytest.raises(ValueError, match=wanted):
        BayerRain(Rain(5.0), camera_of(), airlight=0.7, **options)


def test_what_samples_share_may_be_given_once_or_for_each() -> None:
    """One depth map, rate, count, reach and slant for all, or a row of each for every sample: the same bits."""
    camera = camera_of()
    transform = BayerWeather(Rain(30.0), camera)
    bayer = frame(camera).reshape(1, 1, camera.height, camera.width).expand(3, -1, -1, -1)
    depth_m = torch.linspace(3.0, 60.0, camera.height)[:, None].repeat(1, 1, 1, camera.width)
    depth_m[..., :4, :] = torch.inf  # sky
    state = transform.state_of(bayer, depth_m).changed(keep_truth=True)
    stage = veil_of(transform)
    noise = stage.draw(state, seed=5)
    shared = {"particle_count": 1.3, "particle_reach_m": 40.0, "path_tangent": 0.2}
    once = state.changed(**{name: torch.full((1,), value) for name, value in shared.items()})
    each = state.changed(
        depth_m=depth_m.repeat(3, 1, 1, 1),
        intrinsics=state.scene.intrinsics.repeat(3, 1),
        **{name: torch.full((3,), value) for name, value in shared.items()},
    )
    masks_found = []
    for given, rate in ((once, torch.tensor(30.0)), (each, torch.full((3,), 30.0))):
        for part in stage.parts:
            part.rate_mm_per_h = rate
        masks_found.append(stage(given, noise).image.particle_mask)
    torch.testing.assert_close(*masks_found, rtol=0, atol=0)


def test_the_optical_depth_alone_is_that_of_the_rendered_mask() -> None:
    camera = camera_of()
    transform = BayerWeather(Mixture(Rain(30.0), Snow(2.0)), camera, airlight=0.8)
    state = transform.state_of(frame(camera)[None], torch.full((1, 96, 96), 60.0)).changed(keep_truth=True)
    stage = veil_of(transform)
    noise = stage.draw(state, seed=3)
    mask = stage(state, noise).image.particle_mask
    torch.testing.assert_close(-torch.expm1(-stage.optical_depth(state, noise)), mask, rtol=1e-6, atol=1e-7)
