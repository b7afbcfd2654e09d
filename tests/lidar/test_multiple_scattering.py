"""Multiple scattering of a LiDAR's pulse in dense fog: photons traced one by one show how little a narrow view has."""

from __future__ import annotations

import numpy as np

import torchweather as tw
from tests.reference import fog_photons
from torchweather.physics import extinction_per_m

NM = 865.0


def gain(mor_m: float, half_angle_rad: float, photons: int) -> np.ndarray:
    """Light of all orders of scattering over that scattered once, in ranges of 2-5, 5-10 and 10-15 m."""
    fog = tw.Fog(mor_m).distribution(mor_m)
    optics = fog_photons.scattering_angles(fog, NM), fog_photons.phase_of_cosine(fog, NM)
    alpha, edges_m = float(extinction_per_m(fog, NM)), np.array([2.0, 5.0, 10.0, 15.0])
    orders = fog_photons.lidar_orders(half_angle_rad, 0.0095, alpha, *optics, photons, 3, edges_m)
    return orders.sum(0) / orders[0]


def test_a_narrow_view_sees_hardly_more_than_light_scattered_once() -> None:
    os1 = tw.Lidar.preset("ouster-os1-128")
    found = gain(20.0, 0.5e-3 * os1.divergence_mrad, 300_000)
    # 0.5 dB in fog of 20 m; the near-range response, which nobody knows, decides by a factor of two (PHYSICS.md 10.13).
    assert np.all(found > 1.0)
    assert np.all(found < 1.2)


def test_a_wide_view_sees_more() -> None:
    assert gain(20.0, 10e-3, 300_000)[1] > 1.15


def test_neither_a_wall_nor_fog_has_a_tail_in_a_narrow_view() -> None:
    """Light of a wall of 10 % at 10 m in fog of 20 m, and light that fog scattered twice or more."""
    fog, os1 = tw.Fog(20.0).distribution(20.0), tw.Lidar.preset("ouster-os1-128")
    alpha = float(extinction_per_m(fog, NM))
    optics = fog_photons.scattering_angles(fog, NM), fog_photons.phase_of_cosine(fog, NM)
    half_rad = 0.5e-3 * os1.divergence_mrad
    kind, delay_m, power = fog_photons.lidar_wall_echo(10.0, 0.1, half_rad, 0.0095, alpha, *optics, 60_000, 1)
    straight = power[kind == fog_photons.WALL_STRAIGHT].sum()
    alone = 0.1 / np.pi / 10.0**2 * np.exp(-2.0 * alpha * 10.0)
    # Photons that come through, 19 % of 60,000: 0.9 % (1 standard error).
    assert abs(straight / alone - 1.0) < 0.03
    # A pulse of 10 ns is 1.5 m long: 5 cm is a thirtieth of it.
    by_fog = kind == fog_photons.WALL_BY_FOG
    assert 0.02 < power[by_fog].sum() / straight < 0.3
    assert power[by_fog & (delay_m > 0.05)].sum() / straight < 0.001
    twice = kind == fog_photons.FOG_LIGHT
    assert power[twice & (delay_m > 0.05)].sum() / power[twice].sum() < 0.01
