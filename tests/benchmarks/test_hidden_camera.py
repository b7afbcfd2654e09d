"""The camera's generator of studies with a hidden effect against closed forms."""

import json
import math

import numpy as np
import pytest
import torch

from benchmarks.gap_bench.generator.camera.camera_sensor import Weather, mosaic, shoot, study_camera
from benchmarks.gap_bench.generator.camera.cases import Case, Places, build
from benchmarks.gap_bench.generator.camera.design import Size
from benchmarks.gap_bench.generator.camera.detectability import Table
from benchmarks.gap_bench.generator.camera.effects import path_weights
from benchmarks.gap_bench.generator.camera.outside import KINDS
from benchmarks.gap_bench.generator.camera.particles import NEAR_M, Streaks, draw, optical_depth, population
from benchmarks.gap_bench.generator.camera.scene import ROAD, SKY, Eye, Street, draw_street
from benchmarks.gap_bench.sealed import plain
from torchweather.atmosphere.weather import Rain, Snow
from torchweather.transforms import BayerWeather

DEPTHS_M = (8.0, 20.0, 60.0)
FRAMES = 12


def _fronts(eye: Eye) -> Street:
    """Three walls across, one below the other."""
    depth_m = np.repeat(DEPTHS_M, eye.height // 3)[:, None] * np.ones((1, eye.width))
    nothing = np.zeros((*depth_m.shape, 3))
    return Street(eye, depth_m, nothing, np.zeros(depth_m.shape, dtype=np.int64), nothing, (0, ()))


@pytest.mark.parametrize(("kind", "rate_mm_per_h"), [("rain", 40.0), ("snow", 1.0)])
def test_particles_cover_what_beer_and_lambert_say(kind, rate_mm_per_h):
    # Independent particles that each cover a share of the exposure leave exp(-sum of n pi D^2 / 4 times the way), which
    # is longer off the axis.
    street, found = _fronts(Eye(160, 120)), population(kind, rate_mm_per_h)
    area_per_m = float((found.number_per_m3 * 0.25e-6 * math.pi * found.diameter_mm**2).sum())
    way_m = (np.array(DEPTHS_M) - NEAR_M)[:, None] * street.ray_per_depth.reshape(3, -1)
    expected = -np.expm1(-area_per_m * way_m).mean(1)
    rng = np.random.default_rng(5)
    covered = []
    for _ in range(FRAMES):
        streaks = draw(street, kind, rate_mm_per_h, 1.0, math.inf, rng)
        covered.append(-np.expm1(-optical_depth(street, streaks, rng)).reshape(3, -1).mean(1))
    error = np.std(covered, 0, ddof=1) / math.sqrt(FRAMES)
    np.testing.assert_array_less(np.abs(np.mean(covered, 0) - expected), 4.0 * error)
    assert error[-1] < 0.01 * expected[-1]


@pytest.mark.parametrize(("kind", "rate_mm_per_h"), [("rain", 45.0), ("snow", 2.2)])
def test_the_library_s_weather_dims_and_brightens_as_that_of_the_generator(kind, rate_mm_per_h):
    """Two codes of one physics: what becomes of the light by depth, and in rings about the axis."""
    eye = Eye(160, 120)
    street = draw_street(np.random.default_rng(8), eye)
    clear = np.log(mosaic(street.colour))
    near, far = (street.label == ROAD) & (street.depth_m < 12.0), (street.depth_m > 25.0) & (street.label != SKY)
    x, y = eye.rays
    outer = np.hypot(x, y) > 0.4
    masks = [near, far, outer & (street.label != SKY), ~outer & (street.label != SKY)]

    def rows(frames):
        return np.array([[(np.log(np.maximum(one, 2e-3)) - clear)[mask].mean() for mask in masks] for one in frames])

    model = BayerWeather((Rain if kind == "rain" else Snow)(rate_mm_per_h), study_camera(eye))
    bayer = torch.from_numpy(mosaic(street.colour)).float().expand(FRAMES, 1, -1, -1)
    depth = torch.from_numpy(street.depth_m).float().expand(FRAMES, 1, -1, -1)
    with torch.no_grad():
        own = rows(model(bayer, depth, model.draw(bayer, seed=3))[:, 0].double().numpy())
    other = rows(shoot(street, Weather(kind, rate_mm_per_h), (), FRAMES, np.random.default_rng(9)))
    error = np.hypot(*(one.std(0, ddof=1) / math.sqrt(FRAMES) for one in (own, other)))
    np.testing.assert_array_less(np.abs(own.mean(0) - other.mean(0)), 4.0 * error + 0.01 * np.abs(other.mean(0)))
    # Half of the sky's light on flakes (PHYSICS.md 10.2) or marks without their growth off the axis (10.1) would show.
    assert (error[1:] < 0.05 * np.abs(other.mean(0))[1:]).all()


@pytest.mark.parametrize("length_px", [0.3, 0.8, 1.0, 2.5, 3.0, 8.0])
def test_weights_along_a_path_have_its_variance(length_px):
    weights = path_weights(length_px)
    place = np.arange(len(weights)) - len(weights) // 2
    assert weights.sum() == pytest.approx(1.0)
    assert (weights * place**2).sum() == pytest.approx(length_px**2 / 12.0)
    assert weights.min() >= 0.0
    assert weights.max() <= 1.0 / max(1.0, length_px - 1.0)


def test_a_narrow_defocus_has_the_variance_of_its_disk():
    light = np.zeros((33, 33, 3))
    light[16, 16] = 1.0
    seen = KINDS["camera.defocus"]({"radius_px": 0.6}).on_light(None, light)[..., 0]
    place = np.arange(33) - 16
    assert seen.sum() == pytest.approx(1.0)
    for axis in (0, 1):
        assert (seen.sum(axis) * place**2).sum() == pytest.approx(0.6**2 / 4.0)


@pytest.mark.parametrize(("width_px", "down_px"), [(0.8, 6.0), (2.0, 3.0), (2.4, 0.8), (3.0, 2.0)])
def test_a_slanted_streak_leans_by_the_path_of_its_disk(width_px, down_px):
    """The disk moves, it is not sheared: covariance of a uniform path, variance of the disk and of pixels besides."""
    aside_px, one = 0.4 * down_px, np.ones(1)
    at = {"column_px": 20.3 * one, "row_px": 20.6 * one, "depth_m": 5.0 * one, "peak": 0.01 * one}
    path = {"width_px": width_px * one, "aside_px": aside_px * one, "down_px": down_px * one}
    streaks = Streaks(**at, **path, crowds=[], slant=0.0, veil_per_m=np.zeros(1), veil_edges_m=np.array([0.5, 200.0]))
    found = optical_depth(_fronts(Eye(42, 42)), streaks, np.random.default_rng(0))
    rows, columns = np.indices(found.shape)
    weight = found / found.sum()
    x, y = columns - (weight * columns).sum(), rows - (weight * rows).sum()
    assert (weight * x * y).sum() == pytest.approx(aside_px * down_px / 12.0, abs=0.01, rel=0.03)
    assert (weight * y**2).sum() == pytest.approx(down_px**2 / 12.0 + width_px**2 / 16.0 + 1.0 / 12.0, rel=0.1)


@pytest.mark.parametrize("slope", [0.1, 0.3, 0.6])
def test_a_slanted_streak_is_as_wide_in_each_row_as_its_disk_that_moves_on(slope):
    """Variance across: of the disk, of the columns, and by the slope of how far down it is seen in a row."""
    width_px, down_px, one = 0.8, 30.0, np.ones(1)
    path = {"width_px": width_px * one, "aside_px": slope * down_px * one, "down_px": down_px * one}
    beside = {"crowds": [], "slant": 0.0, "veil_per_m": np.zeros(1), "veil_edges_m": np.array([0.5, 200.0])}
    variances, column = [], np.arange(42)
    for place in np.linspace(0.0, 1.0, 16, endpoint=False):  # what pixels add depends on where in them it lies
        at = {"column_px": 20.0 + place * one, "row_px": 20.6 * one, "depth_m": 5.0 * one, "peak": 0.01 * one}
        rows = optical_depth(_fronts(Eye(42, 42)), Streaks(**at, **path, **beside), np.random.default_rng(0))[12:30]
        middle = 20.0 + place + slope * (np.arange(12, 30)[:, None] - 20.6)
        variances.append((rows * (column - middle) ** 2).sum(1) / rows.sum(1))
    of_disk = width_px**2 / 16.0
    assert np.mean(variances) == pytest.approx((1.0 + slope**2) * (of_disk + 1.0 / 12.0), rel=0.02)


class _NothingShows(Places):
    """Streets on which no effect reaches a level; the strongest has a d' of 2.3."""

    def strength(self, weather, size, name, level):
        return None

    def table(self, weather, size, name):
        return None, Table(name, np.array([0.0, 2.3]), np.zeros((2, 2, 1)))


def test_an_effect_that_shows_nowhere_is_hidden_at_its_strongest():
    size = Size(width=64, height=48, streets=1, clear_frames=2, rates=2, frames=2)
    case = Case("x", "single", "fog", ("camera.rolling_shutter",), (30.0,), size, (1, 2, 3))
    _, truth = build(case, _NothingShows((1, 2), few=True))
    effect = truth["effects"][0]
    assert truth["weather"] == "snow"  # the next one in which it could show
    assert effect["level"] == 2.3
    assert effect["parameters"]["row_time_s"] == pytest.approx(2e-4)


def test_a_sealed_truth_gives_its_study_again():
    size = Size(width=64, height=48, streets=1, clear_frames=2, rates=2, frames=2)
    case = Case("x", "single", "snow", ("camera.particle_count",), (30.0,), size, (1, 2, 3))
    study, truth = build(case, _NothingShows((1, 2), few=True))
    again, same = build(case, Places((1, 2), few=True), json.loads(json.dumps(plain(truth))))
    assert plain(same) == plain(truth)
    for one, other in zip(study.conditions, again.conditions, strict=True):
        np.testing.assert_array_equal(one.frames[0]["bayer"], other.frames[0]["bayer"])


def test_a_pair_of_which_one_shows_nowhere_is_not_made():
    size = Size(width=64, height=48, streets=1, clear_frames=2, rates=2, frames=2)
    names = ("camera.defocus", "camera.wind_slant")
    case = Case("x", "pair", "rain", names, (30.0, 30.0), size, (1, 2, 3))
    with pytest.raises(ValueError, match=r"x: no street shows camera.defocus, camera.wind_slant at any level"):
        build(case, _NothingShows((1, 2), few=True))
