"""The independent renderer: closed forms of its fog, hidden particles, the law of its snow before a LiDAR."""

from __future__ import annotations

import importlib.util
import math
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

PATH = Path(__file__).parents[2] / "benchmarks" / "independent_weather.py"


def loaded() -> Any:
    spec = importlib.util.spec_from_file_location("independent_weather", PATH)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules["independent_weather"] = module
    spec.loader.exec_module(module)
    return module


independent = loaded()


def test_a_street_is_the_same_for_the_same_seed_and_another_in_another_place() -> None:
    first, again = (independent.street(3, "town", 64, 48) for _ in range(2))
    assert np.array_equal(first.picture, again.picture)
    assert not np.array_equal(first.picture, independent.street(3, "country", 64, 48).picture)
    assert set(np.unique(first.classes)) <= set(range(len(independent.CLASSES)))
    assert np.isinf(first.depth_m[first.classes == independent.SKY]).all()
    assert np.isfinite(first.depth_m[first.classes != independent.SKY]).all()


def test_fog_of_a_layer_is_the_integral_along_the_ray() -> None:
    scene = independent.street(1, "country", 64, 48)
    found = independent.fog_depth(scene, 0.03, 20.0)
    for row, column in ((40, 10), (30, 30), (26, 50)):
        depth_m = min(float(scene.depth_m[row, column]), 5e3)
        rise = -(row - scene.horizon_row) / scene.focal_px
        way = (np.arange(200_000) + 0.5) / 200_000 * depth_m
        height = independent.CAMERA_HEIGHT_M + rise * way
        sum_of_steps = 0.03 * np.exp(-height / 20.0).mean() * depth_m
        assert math.isclose(found[row, column], sum_of_steps, rel_tol=1e-4)


def test_no_particle_shows_before_a_nearer_surface() -> None:
    scene = independent.street(2, "town", 64, 48)
    wall = replace(scene, depth_m=np.full_like(scene.depth_m, 0.3))
    options = {"per_m3": 500.0, "sizes": lambda n: np.full(n, 3.0), "fall": lambda d: d * 0 + 1.0, "shine": np.ones(3)}
    for seen, changed in ((scene, True), (wall, False)):
        after = independent.with_objects(
            seen.light, seen, np.random.default_rng(1), **options, exposure_s=0.005, forward=0.0, aside=0.0
        )
        assert np.array_equal(after, seen.light) != changed


def test_snow_before_a_lidar_lies_on_its_beams_and_grows_with_the_rate() -> None:
    along = np.random.default_rng(0).normal(size=(4000, 3)).astype(np.float32)
    along /= np.linalg.norm(along, axis=1, keepdims=True)
    points = np.concatenate([along * 30.0, np.full((4000, 1), 90.0, np.float32)], 1)
    shares = []
    for rate in (0.5, 3.0):
        out, flake = independent.snow_on_beams(points, along, 5, snow_mm_per_h=rate)
        range_m = np.linalg.norm(out[flake, :3], axis=1)
        np.testing.assert_allclose(out[flake, :3], along[flake] * range_m[:, None], atol=1e-4)
        assert range_m.max() < 30.0
        shares.append(flake.mean())
    assert 0 < shares[0] < shares[1]
