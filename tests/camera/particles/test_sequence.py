"""Sequences: the same particles frame after frame, where kinematics says they are, in unchanged number."""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping
from functools import lru_cache
from typing import Any

import numpy as np
import pytest
import torch
from torch import Tensor

from torchweather.atmosphere.weather import Fog, Mixture, Rain, Snow
from torchweather.camera.particles.population import COLUMN_DEPTH, COLUMN_LEVEL, COLUMN_U, COLUMN_V, Population
from torchweather.core.random import ABSENT
from torchweather.sensors import Camera
from torchweather.stages import ParticleVeil
from torchweather.transforms import BayerFog, BayerRain, BayerSnow, BayerWeather

H, W = 48, 64
FOCAL_PX = 300.0
INTERVAL_S = 1 / 30
LIGHT = (0.5, 0.6, 0.7)
STRAIGHT = Camera.from_intrinsics(FOCAL_PX, FOCAL_PX, 31.5, 23.5, W, H)
SIDE_WIND = (0.0, 4.0, 0.0)  # m/s to the left of the vehicle
CASES: dict[str, dict[str, Any]] = {
    "still air": {},
    "side wind": {"wind": SIDE_WIND},
    "driving": {"ego_speed_m_per_s": 10.0},
    "pitched up": {"camera": Camera.from_intrinsics(FOCAL_PX, FOCAL_PX, 31.5, 23.5, W, H, pitch_rad=0.2)},
    "rolled, driving in wind": {
        "camera": Camera.from_intrinsics(FOCAL_PX, 280.0, 30.0, 20.0, W, H, pitch_rad=-0.1, roll_rad=0.3),
        "wind": (2.0, -1.0, 0.5),
        "ego_speed_m_per_s": 8.0,
    },
    "behind a lens": {
        "camera": Camera.from_intrinsics(200.0, 200.0, 31.5, 23.5, W, H, k1=-0.4, p1=2e-3),
        "wind": (0.0, 1.0, 0.0),
        "ego_speed_m_per_s": 5.0,
    },
}
every_motion = pytest.mark.parametrize("case", list(CASES))


def rain(
    rate: float = 50.0, camera: Camera = STRAIGHT, wind: tuple[float, float, float] = (0.0, 0.0, 0.0), **more: Any
) -> BayerWeather:
    return BayerRain(
        Rain(rate, wind_m_per_s=wind),
        camera,
        **{"depth": 30.0, "airlight": LIGHT, "near_m": 1.0, "far_m": 20.0, **more},
    )


def frame(*batch: int) -> Tensor:
    return torch.full((*batch, 1, H, W), 0.2)


def population(transform: BayerWeather) -> Population:
    veil = transform.chain.stages["particle_veil"]
    assert isinstance(veil, ParticleVeil)
    return veil.parts[0]


def shells(transform: BayerWeather) -> list[str]:
    return [key for key in transform.draw(frame(), seed=0) if "_shell_" in key]


def listed(noise: Mapping[str, Tensor], key: str) -> Tensor:
    """Slots in use, ``(P,)``."""
    return noise[key][..., COLUMN_LEVEL] < ABSENT


def busiest(transform: BayerWeather) -> str:
    """The shell with the most particles."""
    noise = transform.draw(frame(), seed=0)
    return max(shells(transform), key=lambda key: noise[key].shape[-2])


class Drops:
    """What the slots of a shell mean: place in the camera's frame, metres, and fall speed, m/s.

    Written from the definition of the slots, in float64, apart from the code under test.
    """

    def __init__(self, part: Population, key: str, points: Tensor) -> None:
        number = int(key.rpartition("_")[2])
        t, camera = part.tables, part.camera
        shell = t.listed[number]
        reach_u, reach_v = part.reach_px(number)
        cube = points.double().numpy()
        fx, fy, cx, cy = camera.intrinsics
        focal = math.sqrt(fx * fy)
        quantile = np.linspace(0, 1, len(shell.log_footprint))
        foot = np.interp(cube[:, COLUMN_DEPTH], quantile, np.exp(shell.log_footprint))
        u = cube[:, COLUMN_U] * (W + 2 * reach_u) - reach_u - 0.5
        v = cube[:, COLUMN_V] * (H + 2 * reach_v) - reach_v - 0.5
        xd, yd = torch.from_numpy((u - cx) / fx), torch.from_numpy((v - cy) / fy)
        x, y = (value.numpy() for value in camera.undistort(xd, yd))
        self.depth_m = foot * focal
        self.place_m = np.stack([x * self.depth_m, y * self.depth_m, self.depth_m], -1)
        # The level is the number of larger drops per m^3; the table says how fast the drop of that level falls.
        most = np.interp(cube[:, COLUMN_DEPTH], quantile, t.log_at(t.tail_most, shell.log_footprint))
        scale = part.camera.magnification(torch.from_numpy(x), torch.from_numpy(y)).numpy()
        log_level = np.log(np.clip(cube[:, COLUMN_LEVEL], 1e-30, 1)) + most + np.log(scale * part.headroom())
        stop = (log_level - t.log_level_low) / t.log_level_step
        table = part.at_rate(1).fall_speed[0].double().numpy()
        self.fall_m_per_s = np.interp(stop, np.arange(len(table)), table)
        self.log_level = log_level


def velocity_in_camera(camera: Camera, fall: np.ndarray, wind: tuple[float, ...], ego: float) -> np.ndarray:
    """Velocity relative to the camera, from the vehicle's frame by hand: x forward, y left, z up.

    ``right, down, axis`` of a camera pitched up by p and rolled clockwise (seen from behind) by r.
    """
    p, r = camera.pitch_rad, camera.roll_rad
    axis = np.array([math.cos(p), 0.0, math.sin(p)])
    level_right, level_down = np.array([0.0, -1.0, 0.0]), np.array([math.sin(p), 0.0, -math.cos(p)])
    right = math.cos(r) * level_right + math.sin(r) * level_down
    down = -math.sin(r) * level_right + math.cos(r) * level_down
    relative = np.array(wind) - np.array([ego, 0.0, 0.0]) + fall[:, None] * np.array([0.0, 0.0, -1.0])
    return np.stack([relative @ right, relative @ down, relative @ axis], -1)


@every_motion
def test_the_first_frame_is_the_draw(case: str) -> None:
    more = dict(CASES[case])
    transform = rain(**more)
    first = next(transform.draw_sequence(frame(), 3, INTERVAL_S, seed=7))
    drawn = transform.draw(frame(), seed=7)
    assert set(first) == set(drawn)
    assert all(torch.equal(first[key], drawn[key]) for key in drawn)


@every_motion
def test_drops_move_by_fall_speed_wind_and_ego_motion(case: str) -> None:
    more = dict(CASES[case])
    wind, ego = more.get("wind", (0.0, 0.0, 0.0)), more.get("ego_speed_m_per_s", 0.0)
    transform = rain(**more)
    part = population(transform)
    before, after = itertools.islice(transform.draw_sequence(frame(), 2, INTERVAL_S, seed=3), 2)
    compared = 0
    for key in shells(transform):
        present = listed(before, key) & listed(after, key)
        if not bool(present.any()):
            continue
        start, end = (Drops(part, key, noise[key][present]) for noise in (before, after))
        velocity = velocity_in_camera(part.camera, start.fall_m_per_s, wind, ego)
        expected = start.place_m + velocity * INTERVAL_S
        error = np.abs(end.place_m - expected).max(1)
        # A slot that did not stay holds a newcomer somewhere else, metres away. Float32 slots: 6e-8 of the image's
        # width with its margins, some 1e-5 m, and the depth's quantiles likewise.
        stayed = error < 2e-3
        compared += int(stayed.sum())
        number = int(key.rpartition("_")[2])
        assert stayed.mean() > 0.98 * expected_share_that_stays(part, number, expected)
        # The same drop: its level, and with it its size, is kept.
        assert np.abs(end.log_level - start.log_level)[stayed].max(initial=0.0) < 2e-3
    assert compared > 100


def expected_share_that_stays(part: Population, number: int, place_m: np.ndarray) -> float:
    """Share of the drops whose next place lies in the shell and in the image with its margins."""
    camera, shell = part.camera, part.tables.listed[number]
    reach_u, reach_v = part.reach_px(number)
    fx, fy, cx, cy = camera.intrinsics
    x, y = (torch.from_numpy(place_m[:, axis] / place_m[:, 2]) for axis in (0, 1))
    if camera.distorted:
        x, y = camera.distort(x, y)
    u, v = x.numpy() * fx + cx, y.numpy() * fy + cy
    near, far = np.exp(shell.log_footprint[[0, -1]]) * math.sqrt(fx * fy)
    inside = (u > -0.5 - reach_u) & (u < W - 0.5 + reach_u) & (v > -0.5 - reach_v) & (v < H - 0.5 + reach_v)
    return float((inside & (place_m[:, 2] > near) & (place_m[:, 2] < far)).mean())


def test_a_drop_in_still_air_falls_at_its_own_speed() -> None:
    """One drop by hand: 6.5 m/s falls 0.217 m in 1/30 s; at 10 m and f = 300 px that is 6.5 px down, none aside."""
    transform = rain()
    part = population(transform)
    before, after = itertools.islice(transform.draw_sequence(frame(), 2, INTERVAL_S, seed=3), 2)
    key = shells(transform)[0]
    start, end = (Drops(part, key, noise[key]) for noise in (before, after))
    same = listed(before, key).numpy() & (np.abs(start.place_m[:, 0] - end.place_m[:, 0]) < 1e-4)
    fallen = (end.place_m - start.place_m)[same]
    assert same.sum() > 10
    assert np.allclose(fallen[:, 1], start.fall_m_per_s[same] * INTERVAL_S, atol=1e-4)
    assert np.all((start.fall_m_per_s[same] > 0.5) & (start.fall_m_per_s[same] < 9.7))  # Atlas: 9.65 m/s at most
    assert np.allclose(fallen[:, 2], 0.0, atol=1e-4)


@lru_cache
def films(case: str) -> tuple[list[list[int]], Tensor]:
    """Of four films of 16 frames: the number of drops in each frame, and the variates of those in the last."""
    transform = rain(**CASES[case])
    key = busiest(transform)
    counts: list[list[int]] = []
    last = []
    for seed in range(4):
        counts.append([])
        for noise in transform.draw_sequence(frame(), 16, INTERVAL_S, seed=seed):
            there = listed(noise, key)
            counts[-1].append(int(there.sum()))
            end = noise[key][there]
        last.append(end)
    return counts, torch.cat(last).double()


@every_motion
def test_the_number_of_drops_stays_that_of_a_single_frame(case: str) -> None:
    transform = rain(**CASES[case])
    key = busiest(transform)
    (variate,) = (v for v in population(transform).variates() if key.endswith(v.name))
    mean = variate.mean_points({"H": H, "W": W})
    counts, _ = films(case)
    # Newcomers take the slots of those that left: the number of each film is its first frame's Poisson count.
    assert all(len(set(row)) == 1 for row in counts)
    assert abs(np.mean(counts) - mean) < 4.5 * math.sqrt(mean / len(counts))


@every_motion
def test_drops_stay_uniform_in_their_slots_over_a_film(case: str) -> None:
    """A film whose newcomers came from the wrong places would thin out on one side."""
    _, points = films(case)
    n = len(points)
    assert n > 400
    for column in range(points.shape[1]):
        values = points[:, column].sort().values
        ideal = (torch.arange(n) + 0.5) / n
        # Kolmogorov-Smirnov at 1e-4 significance: 2.23 / sqrt(n).
        assert float((values - ideal).abs().max()) < 2.23 / math.sqrt(n), column


@pytest.mark.parametrize(
    "make", [rain, lambda **k: BayerSnow(Snow(3.0), STRAIGHT, depth=20.0, airlight=LIGHT, far_m=20.0, **k)]
)
def test_the_mask_of_the_last_frame_is_that_of_a_single_one(make: Any) -> None:
    transform = make(ego_speed_m_per_s=10.0)
    given, seeds = frame(), 8
    first, last = [], []
    for seed in range(seeds):
        film = list(transform.draw_sequence(given, 8, INTERVAL_S, seed=seed))
        for noise, into in ((film[0], first), (film[-1], last)):
            mask = transform.run(given, noise=noise).particle_mask
            into.append((float(mask.mean()), float(mask.std())))
    for a, b in zip(np.array(first).T, np.array(last).T, strict=True):
        # Two means over independent films; 4.5 standard errors of their difference.
        scatter = math.sqrt((a.var(ddof=1) + b.var(ddof=1)) / seeds)
        assert abs(a.mean() - b.mean()) < 4.5 * scatter


def test_newcomers_enter_through_the_border_that_the_motion_opens() -> None:
    """In still air drops come in at the top, and the new ones are no further in than a fall of one interval."""
    transform = rain()
    part = population(transform)
    before, after = itertools.islice(transform.draw_sequence(frame(), 2, INTERVAL_S, seed=3), 2)
    new = 0
    for number, key in enumerate(shells(transform)):
        present = listed(before, key) & listed(after, key)
        start, end = (Drops(part, key, noise[key][present]) for noise in (before, after))
        expected = start.place_m + velocity_in_camera(part.camera, start.fall_m_per_s, (0, 0, 0), 0) * INTERVAL_S
        came = np.abs(end.place_m - expected).max(1) > 2e-3
        _, reach_v = part.reach_px(number)
        v = after[key][present][came][:, COLUMN_V].numpy() * (H + 2 * reach_v)  # px below the upper border
        fallen = end.fall_m_per_s[came] * INTERVAL_S * FOCAL_PX / end.depth_m[came]
        assert np.all(v < fallen + 1e-2)
        new += int(came.sum())
    assert new > 20


def test_the_same_seed_gives_the_same_film_and_another_another() -> None:
    transform = rain(wind=SIDE_WIND)
    first, again, other = (list(transform.draw_sequence(frame(), 4, INTERVAL_S, seed=seed)) for seed in (5, 5, 6))
    for a, b in zip(first, again, strict=True):
        assert all(torch.equal(a[key], b[key]) for key in a)
    assert not any(torch.equal(first[-1][key], other[-1][key]) for key in first[-1])


def test_a_generator_decides_the_film() -> None:
    transform = rain()
    torch.manual_seed(1)
    state = torch.get_rng_state()
    films = [
        list(transform.draw_sequence(frame(), 3, INTERVAL_S, generator=torch.Generator().manual_seed(seed)))
        for seed in (1, 1, 2)
    ]
    key = shells(transform)[-1]
    assert torch.equal(films[0][-1][key], films[1][-1][key])
    assert not torch.equal(films[0][-1][key], films[2][-1][key])
    assert torch.equal(torch.get_rng_state(), state)


def test_a_batch_equals_its_samples_films() -> None:
    transform = rain(wind=SIDE_WIND, ego_speed_m_per_s=5.0)
    together = list(transform.draw_sequence(frame(2), 3, INTERVAL_S, seed=torch.tensor([8, 21])))
    for row, seed in enumerate((8, 21)):
        alone = list(transform.draw_sequence(frame(), 3, INTERVAL_S, seed=seed))
        for a, b in zip(together, alone, strict=True):
            assert all(torch.equal(a[key][row], b[key]) for key in b)


def test_every_frame_of_a_mixture_is_noise_for_forward() -> None:
    transform = BayerWeather(
        Mixture(Rain(20.0), Snow(1.0), Fog(80.0)),
        STRAIGHT,
        depth=20.0,
        airlight=LIGHT,
        far_m=20.0,
        ego_speed_m_per_s=5.0,
    )
    given = frame(2)
    film = list(transform.draw_sequence(given, 4, INTERVAL_S, seed=1))
    pictures = [transform(given, noise=noise) for noise in film]
    for noise, picture in zip(film, pictures, strict=True):
        assert all(value.dtype == torch.float32 and bool(value.isfinite().all()) for value in noise.values())
        assert picture.shape == given.shape
        assert bool(((picture >= 0) & (picture <= 1)).all())
        assert torch.equal(picture, transform(given, noise=noise))
    assert not torch.equal(pictures[0], pictures[1])


def test_fog_alone_has_nothing_to_move() -> None:
    film = list(BayerFog(Fog(50.0), STRAIGHT, depth=20.0).draw_sequence(frame(), 3, INTERVAL_S, seed=1))
    assert film == [{}, {}, {}]


def test_the_haze_moves_down_with_its_drops() -> None:
    transform = rain()
    part = population(transform)
    film = list(transform.draw_sequence(frame(), 4, INTERVAL_S, seed=2))
    key = "particle_veil.rain_haze"
    shell = part.haze_shells[-1]
    t = part.tables
    middle_m = FOCAL_PX * math.exp(
        t.log_footprint_low + t.log_footprint_step * 0.5 * (shell.first_node + shell.last_node)
    )
    for number, noise in enumerate(film):
        rows = round(t.haze_speed_m_per_s * number * INTERVAL_S * FOCAL_PX / middle_m)
        assert torch.equal(noise[key][-1], torch.roll(film[0][key][-1], rows, -2))
    assert rows > 0


@pytest.mark.parametrize("interval", [0.0, -0.1, math.nan])
def test_an_interval_that_is_no_time_is_refused(interval: float) -> None:
    with pytest.raises(ValueError, match=r"BayerRain: frame_interval_s must be above 0 s"):
        next(rain().draw_sequence(frame(), 2, interval, seed=1))


def test_no_frames_are_refused() -> None:
    with pytest.raises(ValueError, match=r"BayerRain: frames must be 1 or more; got 0"):
        next(rain().draw_sequence(frame(), 0, INTERVAL_S, seed=1))
