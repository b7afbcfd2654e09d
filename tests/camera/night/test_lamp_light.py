"""Light of lamps on fog, drops and flakes: against photons, closed forms, and limits."""

from __future__ import annotations

import json
import math

import numpy as np
import pytest
import torch

import torchweather as tw
from tests.reference import fog_photons, headlamp_veil
from torchweather.atmosphere.forward_scattering import WIDTHS_RAD, ForwardScattering
from torchweather.camera.night import lamp_light as light_module
from torchweather.camera.night.lamp_light import fog_optics, lamp_light
from torchweather.camera.night.lamps import Lamp, beam_share, own_headlamps
from torchweather.physics import extinction_and_backscatter, extinction_per_m

NM = 530.0
OPEN = torch.full((96, 128), math.inf)
CAMERA = tw.Camera.from_intrinsics(100.0, 100.0, 63.5, 47.5, 128, 96, height_m=1.4)


def veil_ahead(lamp: Lamp, mor_m: float, *, single: bool = False) -> tuple[float, float]:
    """Radiance of the middle pixel up to 200 m, cd/m2, and the extinction, 1/m."""
    fog = tw.Fog(mor_m)
    extinction = float(extinction_per_m(fog.distribution(mor_m), NM))
    optics = fog_optics(fog, mor_m, extinction, NM)
    if single:
        optics = light_module.FogOptics(extinction, None, optics.per_sr, optics.smooth_per_sr)
    down = ((torch.arange(96.0) - 47.5) / 100.0)[:, None].expand(96, 128)
    road_m = torch.where(down > 0, CAMERA.height_m / down, math.inf)
    found = lamp_light(CAMERA, road_m, 200.0, [lamp], [], [], optics, None, None, 1.0)
    veil = found.seen(found.fog, torch.full((1, 1, 96, 128), 200.0))
    return float(veil[0, 1, 47:49, 63:65].mean()), extinction


def test_once_scattered_light_is_the_lidars_backscatter_of_the_illuminance() -> None:
    lamp = Lamp((-1.0, 0.0, 1.4), 1000.0)  # behind the camera, on its axis: scattering is straight back
    found, extinction = veil_ahead(lamp, 100.0, single=True)
    _, beta = extinction_and_backscatter(tw.Fog(100.0).distribution(100.0), NM)
    range_m = np.geomspace(light_module.NEAREST_M, 200.0, 4000)
    signal = 1000.0 / (range_m + 1.0) ** 2 * np.exp(-extinction * (2.0 * range_m + 1.0)) * float(beta)
    # The glory is narrow: the pixels lie 0.4 degrees off the axis.
    assert found == pytest.approx(float(np.trapezoid(signal, range_m)), rel=0.05)


@pytest.mark.parametrize("veil", json.loads(headlamp_veil.FILE.read_text(encoding="utf-8"))["veils"])
def test_the_veil_of_headlamps_is_that_of_photons_traced_one_by_one(veil) -> None:
    left, _ = own_headlamps()
    truth, error = veil["radiance"], veil["error"]
    assert error < 0.02 * truth
    found, _ = veil_ahead(left, veil["mor_m"])
    assert found == pytest.approx(truth, rel=0.1)  # 0.442 for 0.436 in fog of 20 m, 0.206 for 0.225 in fog of 50 m
    once, _ = veil_ahead(left, veil["mor_m"], single=True)
    assert once < 0.35 * truth  # the low beam is below this pixel: only light scattered onward lights the fog there


def test_the_photons_of_the_file_are_those_of_the_script() -> None:
    veil = json.loads(headlamp_veil.FILE.read_text(encoding="utf-8"))["veils"][1]
    paths = 8_000  # their error is that of the file by the root of the paths
    error = veil["error"] * math.sqrt(headlamp_veil.RUNS * headlamp_veil.PATHS / paths)
    assert headlamp_veil.traced(50.0, paths, seed=5) == pytest.approx(veil["radiance"], abs=3.0 * error)


@pytest.mark.parametrize("optical_depth", [1.0, 3.0])
@pytest.mark.parametrize("off_rad", [0.03, 0.1, 0.2])
def test_the_glow_of_a_lamp_is_that_of_photons_traced_one_by_one(optical_depth, off_rad) -> None:
    distribution = tw.Fog(30.0).distribution(30.0)
    angles, per_sr = fog_photons.scattering_angles(distribution, NM), fog_photons.phase_of_cosine(distribution, NM)
    look = np.array([math.cos(off_rad), math.sin(off_rad), 0.0])
    lamp = np.array([optical_depth, 0.0, 0.0])
    arguments = (look, lamp, lambda unit: np.ones(len(unit)), 1.0, angles, per_sr, 30_000)
    truth = fog_photons.lamp_radiance(*arguments, seed=2, size_m=0.02 * optical_depth)
    kernel = ForwardScattering.of_fog(distribution, NM).weights(torch.tensor([optical_depth]))[0].numpy()
    width = np.array(WIDTHS_RAD)
    glow = (kernel / (2.0 * math.pi * width**2) * np.exp(-0.5 * (off_rad / width) ** 2)).sum() / optical_depth**2
    # 5 % of the photons' scatter; the sum of Gaussians is a twentieth to a fifth too dark.
    assert 0.7 < glow / truth < 1.1


def test_a_drop_and_a_flake_show_the_illuminance_times_what_they_scatter() -> None:
    lamp = Lamp((0.0, 0.0, 1.4), 900.0)  # at the camera
    snow = tw.Snow(1.0)
    found = lamp_light(CAMERA, OPEN, 200.0, [lamp], [], [], None, tw.Rain(10.0), snow, 2.0)
    u, v, depth_m = torch.tensor([63.5, 20.0]), torch.tensor([47.5, 80.0]), torch.tensor([3.0, 10.0])
    square = depth_m.square() * (1.0 + ((u - 63.5) / 100.0).square() + ((v - 47.5) / 100.0).square())
    drop = found.at_points(found.drop, None, u, v, depth_m, (96, 128))
    torch.testing.assert_close(drop, 900.0 / square / 2.0 * 0.2 / (4.0 * math.pi), rtol=0.02, atol=0.0)
    flake = found.at_points(found.flake, None, u, v, depth_m, (96, 128))
    torch.testing.assert_close(flake, 900.0 / square / 2.0 * 0.25 / math.pi, rtol=0.02, atol=0.0)
    whole = found.seen(found.flake, torch.full((1, 1, 96, 128), 10.0))[0, 0]
    assert float(whole[80, 20]) == pytest.approx(float(flake[1]), rel=0.02)


def test_the_low_beam_keeps_to_the_regulation_at_its_points() -> None:
    def candela(name: str, aside_deg: float, up_deg: float) -> float:
        angle = (torch.tensor(math.radians(aside_deg)), torch.tensor(math.radians(up_deg)))
        return float(beam_share(name, *angle)) * own_headlamps(name)[0].intensity_cd

    assert candela("low_beam", 3.43, 0.57) < 350.0  # B50L
    assert candela("low_beam", 0.0, -0.86) > 5_100.0  # 50V
    assert candela("low_beam", 9.0, -1.72) > 1_700.0  # 25L
    assert candela("high_beam", 0.0, 0.0) > candela("low_beam", 0.0, -1.5)


def test_lamps_at_the_same_place_add_up_and_none_is_dark() -> None:
    one, two = Lamp((2.0, 0.5, 0.7), 500.0), Lamp((2.0, 0.5, 0.7), 1000.0)
    optics = fog_optics(tw.Fog(50.0), 50.0, 0.06, NM)

    def veil(lamps):
        return lamp_light(CAMERA, OPEN, 200.0, lamps, [], [], optics, None, None, 1.0).fog

    torch.testing.assert_close(veil([one, one]), veil([two]))
    assert float(veil([]).abs().max()) == 0.0
