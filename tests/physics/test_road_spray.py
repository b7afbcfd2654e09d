"""Spray of tyres: its water is kept, and rays through it are those of small steps."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from torchweather.physics.road_spray import (
    SprayCloud,
    spray_cross_section_m2_per_kg,
    spray_drop_mm,
    spray_length_m,
    spray_water_kg_per_m,
)


def cloud() -> SprayCloud:
    return SprayCloud(*(torch.tensor(v, dtype=torch.float64) for v in (0.005, 15.0, 0.7, 12.0, 0.9)))


def test_the_cloud_holds_the_water_that_the_tyres_lift() -> None:
    """Both rows together, over the length of the plume: 2 M L."""
    generator = torch.Generator().manual_seed(1)
    u = torch.rand(3, 400_000, generator=generator, dtype=torch.float64)
    x, y, z = 15.0 - 120.0 * u[0], -6.0 + 12.0 * u[1], 12.0 * u[2]
    density = cloud().density(x, y, z)
    volume = 120.0 * 12.0 * 12.0
    error = 4.0 * float(density.std()) * volume / len(density.view(-1)) ** 0.5
    assert float(density.mean()) * volume == pytest.approx(2 * 0.005 * 12.0, abs=error)
    assert float(cloud().density(*(torch.tensor(v, dtype=torch.float64) for v in (15.1, 0.7, 0.5)))) == 0.0


@pytest.mark.parametrize("direction", [(1.0, 0.0, 0.0), (1.0, 0.1, -0.05), (1.0, -0.4, 0.02), (-1.0, 0.05, 0.0)])
@pytest.mark.parametrize("end_m", [4.0, 200.0])
def test_water_along_a_ray_is_that_of_small_steps(direction: tuple[float, float, float], end_m: float) -> None:
    unit = np.asarray(direction) / np.linalg.norm(direction)
    reach = min(end_m, 15.0 / unit[0] if unit[0] > 0 else 72.0)
    edges = np.linspace(0.0, reach, 200_001)
    t = torch.from_numpy(0.5 * (edges[1:] + edges[:-1]))
    height = 1.2
    z = (height + t * unit[2]).clamp_min(0.0)
    stepped = float((cloud().density(t * unit[0], t * unit[1], z)).mean()) * reach
    found = cloud().column(tuple(torch.tensor([v]) for v in unit), height, torch.tensor([end_m], dtype=torch.float64))
    assert float(found) == pytest.approx(stepped, rel=5e-3, abs=1e-7)


def test_spray_grows_with_speed_and_water() -> None:
    slow, fast = (spray_water_kg_per_m(v, 1.0) * v for v in (15.0, 30.0))
    assert fast / slow == pytest.approx(2.0**2.8)  # Weir: mass per time
    assert spray_water_kg_per_m(20.0, 2.0) == pytest.approx(2.0 * spray_water_kg_per_m(20.0, 1.0))
    assert spray_water_kg_per_m(0.0, 5.0) == spray_water_kg_per_m(20.0, 0.0) == 0.0
    assert spray_drop_mm(4.9) == pytest.approx(0.8)
    assert spray_drop_mm(9.8) == pytest.approx(0.4)
    assert spray_length_m(30.0, 0.1, 0.8) > spray_length_m(30.0, 0.5, 0.8)


def test_cross_section_is_that_of_spheres() -> None:
    diameter = 2.5e-4
    number = 1.0 / (1000.0 * np.pi / 6 * diameter**3)
    assert float(spray_cross_section_m2_per_kg(torch.tensor(0.25))) == pytest.approx(number * np.pi / 4 * diameter**2)


@pytest.mark.parametrize(
    ("call", "said"),
    [
        (lambda: spray_water_kg_per_m(61.0, 1.0), "speed_m_per_s must lie in 0..60 m/s; got 61"),
        (lambda: spray_water_kg_per_m(20.0, 11.0), "water_mm must lie in 0..10 mm"),
        (lambda: spray_length_m(20.0, 3.0, 0.8), "drop_mm must lie in 0.02..2 mm"),
    ],
)
def test_beyond_the_range_of_a_law_is_refused(call: object, said: str) -> None:
    with pytest.raises(ValueError, match=said.replace(".", r"\.")):
        call()  # type: ignore[operator]
