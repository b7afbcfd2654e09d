"""Numbers of the third reading (PHYSICS.md 10) that no other test holds, and the table that names a test for each."""

from __future__ import annotations

import math
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from tests.oracles import load
from tests.reference.every_lidar_particle import Link, Medium, lambda_by_quadrature
from tests.reference.every_particle import geometric_extinction, population
from tests.reference.make_fog_backscatter import backscatter_efficiency
from tests.reference.make_lidar_table import effective_extinction_per_m as effective
from torchweather.atmosphere.weather import Fog, Snow
from torchweather.core.errors import InputValueError
from torchweather.lidar.sensor import Lidar
from torchweather.physics import (
    effective_extinction_per_m,
    extinction_per_m,
    marshall_palmer,
    rehearse_fog,
    sekhon_srivastava,
)
from torchweather.sensors import Camera
from torchweather.transforms import LidarFog, LidarSnow, LidarWeather

ROOT = Path(__file__).parents[2]


def share_above(transform: LidarWeather, kind: str, signal: float, range_m: float) -> float:
    """Share of beams with a reading above a signal in front of a range."""
    returns: Any = transform.chain.stages["particle_returns"]
    number = returns.kinds[kind].expected_above(
        returns.beam, torch.tensor([[signal]]), transform.extinction_per_m, torch.tensor([[range_m]])
    )
    return float(-torch.expm1(-number))


def test_a_corner_has_less_rain_without_the_secant() -> None:
    """10.1: 50 mm/h and 20 m. The near limit is not stated there; 0.7 m gives its cover on the axis."""
    alpha = geometric_extinction(population("rain", 50.0))
    secant = math.hypot(1.0, math.tan(math.radians(40.4)), math.tan(math.radians(30.8)))
    on_axis, corner = (-math.expm1(-alpha * (20.0 - 0.7) * way) for way in (1.0, secant))
    assert on_axis == pytest.approx(0.0408, rel=0.01)
    # 0.0570 is the mean of the corner's pixels, this the cover of its last one: 2 % more.
    assert corner == pytest.approx(0.0570, rel=0.03)
    assert on_axis / corner == pytest.approx(0.715, abs=0.02)


def test_light_of_a_flake_over_that_of_the_horizon() -> None:
    """10.2, by integrals over the hemispheres: radiance of the sky 1 + g sin e, ground of albedo a below it.

    The 67 % that is printed for albedo 0.1 is that of 0.2; the 28 % of an overcast sky is that of 0.33.
    """

    def light(gradient: float, albedo: float) -> float:
        sky = 1.0 + gradient / 2.0
        ground = albedo * (1.0 + gradient * 2.0 / 3.0)
        return (sky + ground) / 2.0

    assert 1.0 / light(0.0, 0.1) - 1.0 == pytest.approx(0.82, abs=0.005)
    assert 1.0 / light(0.0, 0.2) - 1.0 == pytest.approx(0.67, abs=0.005)
    assert 1.0 - 1.0 / light(2.0, 0.1) == pytest.approx(0.10, abs=0.006)
    assert 1.0 - 1.0 / light(2.0, 1.0 / 3.0) == pytest.approx(0.28, abs=0.005)
    assert light(0.0, 1.0) == 1.0  # snow


@pytest.mark.parametrize(
    ("wavelength_nm", "reflectivity", "empty", "replaced"),
    [(905.0, 0.9, 0.70, 0.39), (1550.0, 0.05, 0.05, 0.009)],
    ids=["pack", "1550 nm"],
)
def test_shares_of_an_hdl_64e_in_snow(wavelength_nm: float, reflectivity: float, empty: float, replaced: float) -> None:
    """10.3 at 1 mm/h; particles of one pulse add here (10.4), by 2 to 9 %. The default's shares: lidar_table.json."""
    lidar = Lidar.from_dict({**Lidar.preset("velodyne-hdl-64e").to_dict(), "wavelength_nm": wavelength_nm})
    snow = LidarSnow(Snow(1.0, flake_reflectivity=reflectivity), lidar)
    threshold = lidar.threshold_per_m2_sr
    wall = 0.1 / math.pi / 28.0**2 * math.exp(-2.0 * float(snow.extinction_per_m) * 28.0)
    assert share_above(snow, "snow", threshold, lidar.max_range_m) == pytest.approx(empty, rel=0.09)
    assert share_above(snow, "snow", max(threshold, wall), 28.0) == pytest.approx(replaced, rel=0.09)


def test_the_strongest_drop_alone_is_too_few() -> None:
    """10.4: rain of 50 mm/h on an OS1, by integration; 16 % is printed there, and this is 19 %."""
    os1 = Lidar.preset("ouster-os1-128")
    air = Medium(population("rain", 50.0), 0.2, extinction_per_m=effective("rain", 50.0, os1.wavelength_nm))
    alone, together = (
        -math.expm1(-lambda_by_quadrature(os1.threshold_per_m2_sr, 120.0, link, air))
        for pulse_m in (0.0, os1.pulse_length_m)
        for link in [
            Link(
                exit_diameter_m=1e-3 * os1.exit_diameter_mm,
                divergence_rad=1e-3 * os1.divergence_mrad,
                range_at_10_percent_m=os1.range_at_10_percent_m,
                max_range_m=120.0,
                pulse_length_m=pulse_m,
            )
        ]
    )
    assert 1.0 - alone / together == pytest.approx(0.16, abs=0.03)


def test_the_receivers_filter_decides_by_a_factor_of_two_near_the_threshold() -> None:
    """10.5: beams into the sky that return fog, the table of docs/lidar.md for the OS1."""
    lidar = Lidar.preset("ouster-os1-128")
    for mor_m, wanted in ((200.0, (0.457, 0.806)), (300.0, (0.107, 0.349))):
        found = [
            share_above(
                LidarFog(Fog(mor_m=mor_m), lidar, receiver=receiver),
                "fog",
                lidar.threshold_per_m2_sr,
                lidar.max_range_m,
            )
            for receiver in ("gate", "matched")
        ]
        assert found == pytest.approx(wanted, rel=0.02)
        assert 1.7 < found[1] / found[0] < 3.4


def test_ranges_of_rain_and_snow() -> None:
    """10.8: extinction per km of rain against 0.16 R^0.74, and of Sekhon and Srivastava's snow by rate."""
    rate = torch.tensor([10.0, 25.0, 50.0], dtype=torch.float64)
    found = 1e3 * effective_extinction_per_m(extinction_per_m(marshall_palmer(rate), 550.0), 1.1)
    assert found[:2].tolist() == pytest.approx([0.86, 1.53], abs=0.005)
    published = 0.16 * rate**0.74
    assert published[:2].tolist() == pytest.approx([0.88, 1.73], abs=0.005)
    assert float(found[2] / published[2]) == pytest.approx(1.0 - 0.19, abs=0.01)
    snow = extinction_per_m(sekhon_srivastava(torch.tensor([10.0, 12.0, 20.0])), 905.0)
    assert snow[1] / snow[0] < 1.03  # it has stopped growing
    assert snow[2] < snow[1]
    with pytest.raises(InputValueError, match="10 mm/h"):
        Snow(20.0)


# Backscatter of the block fog_table5 at 530 and 905 nm as it was, of 3,000 radii.
OF_3000_RADII = {
    "10": (0.018041377975059072, 0.017463037664751675),
    "30": (0.005954239431425621, 0.005724759466917525),
    "50": (0.0035750724060018826, 0.0032739116964900666),
}


def test_the_fog_oracle_is_corrected() -> None:
    """10.9 prints 0.9722 and 1.0183 for a fog of 20 m, which the block lacks; its three fogs lie on both sides."""
    rows = load("fog_table5")["rows"]
    new = [
        [rows[mor]["extinction_1_per_m"][band]["backscatter_per_sr"] for band in ("G", "905")] for mor in OF_3000_RADII
    ]
    ratio = np.array(new) / np.array(list(OF_3000_RADII.values()))
    np.testing.assert_allclose(ratio, [[0.9706, 1.0217], [0.9763, 1.0199], [0.9924, 1.0123]], atol=1e-4)
    assert (ratio.min(0) < [0.9722, 1.0183]).all()
    assert (ratio.max(0) > [0.9722, 1.0183]).all()


@pytest.mark.parametrize(("band", "wavelength_nm"), [("G", 530.0), ("905", 905.0)])
def test_the_fog_oracle_is_what_its_script_computes(band: str, wavelength_nm: float) -> None:
    """10.9: the fog of 50 m anew from its radii of 0.2 to 25 um, beyond which lie 3e-4 of the cross-section."""
    optical = load("refractive_index")["optical"][f"{wavelength_nm:g}nm"]
    index = complex(optical["water_n_iapws"]["10"], optical["water_segelstein"][1])
    radius_um = np.geomspace(0.02, 150.0, 20_001)
    step = math.log(radius_um[1] / radius_um[0])
    radius_um = radius_um[(radius_um > 0.2) & (radius_um < 25.0)]
    size = 2e3 * math.pi * radius_um / wavelength_nm
    efficiency = np.concatenate([backscatter_efficiency(index, size[i : i + 500]) for i in range(0, len(size), 500)])
    diameter_mm = torch.from_numpy(2e-3 * radius_um)
    density = (rehearse_fog(50).number_density_per_m3_mm(diameter_mm) * diameter_mm).numpy()  # per log of the size
    found = (density * math.pi * (1e-6 * radius_um) ** 2 * efficiency).sum() * step / (4.0 * math.pi)
    wanted = load("fog_table5")["rows"]["50"]["extinction_1_per_m"][band]["backscatter_per_sr"]
    assert float(found) == pytest.approx(wanted, rel=1e-3)


def test_the_sky_at_ten_degrees_through_200_m_of_fog() -> None:
    """10.11: exp(-3.5) of its own light at 1 km of visibility, nothing below 500 m."""
    up_m = 200.0 / math.sin(math.radians(10.0))
    assert math.log(20.0) / 1000.0 * up_m == pytest.approx(3.5, abs=0.06)
    assert math.exp(-math.log(20.0) / 500.0 * up_m) < 1.1e-3


def test_the_measured_near_response_of_an_os2() -> None:
    """10.13: (R / 30 m)^2 below 30 m and 1 beyond."""
    range_m = torch.tensor([3.1, 10.0, 30.0, 80.0])
    found = Lidar.preset("ouster-os2-128").near_response(range_m)
    torch.testing.assert_close(found, (range_m / 30.0).clamp_max(1.0).square())


def test_a_lens_of_a_typical_mtf_as_a_disk() -> None:
    """10.14: half of the contrast at 0.25 to 0.35 cycles a pixel."""
    sigma_px = [math.sqrt(math.log(2.0) / 2.0) / math.pi / f50 for f50 in (0.35, 0.25)]
    assert sigma_px == pytest.approx([0.53, 0.75], abs=0.006)
    beyond_the_pixel = [math.sqrt(sigma**2 - 1.0 / 12.0) for sigma in sigma_px]
    assert beyond_the_pixel == pytest.approx([0.45, 0.69], abs=0.006)
    disk_px = [4.0 * sigma for sigma in beyond_the_pixel]  # a disk's variance along an axis is d^2 / 16
    assert disk_px == pytest.approx([1.8, 2.8], abs=0.04)
    assert disk_px[0] < Camera.preset("kitti").lens_blur_px < disk_px[1]


def rows_of_the_page() -> list[list[str]]:
    """Cells of the table "Corrections of the third reading"."""
    page = (ROOT / "docs" / "validation.md").read_text(encoding="utf-8")
    section = page.split("## Corrections of the third reading")[1].split("\n## ")[0]
    return [
        [cell.strip() for cell in line.strip("|").split("|")]
        for line in section.splitlines()
        if line.startswith("| 10.")
    ]


def test_the_table_of_the_page_names_a_test_for_each_correction() -> None:
    rows = rows_of_the_page()
    assert [row[0] for row in rows] == [f"10.{number}" for number in range(1, 15)]
    for number, _, tests, _ in rows:
        named = re.findall(r"`(tests/[\w/]+\.py)::(\w+)`", tests)
        assert named, number
        for file, name in named:
            assert re.search(rf"^def {name}\(", (ROOT / file).read_text(encoding="utf-8"), re.MULTILINE), (file, name)
    for script in {one for row in rows for one in re.findall(r"`((?:tests|benchmarks|examples)/[\w/]+\.\w+)`", row[3])}:
        assert (ROOT / script).is_file(), script
