"""Measured spectra."""

from __future__ import annotations

import math

import pytest
import torch

from torchweather.physics import Binned, extinction_per_m, marshall_palmer, rain_fall_speed_m_per_s

EDGES = [0.2, 0.4, 0.8, 2.0]
DENSITY = [1000.0, 0.0, 50.0]


def test_moments_of_boxes_are_exact() -> None:
    spectrum = Binned(EDGES, DENSITY)
    assert float(spectrum.total_per_m3) == pytest.approx(260.0)
    third = 1000.0 * (0.4**4 - 0.2**4) / 4 + 50.0 * (2.0**4 - 0.8**4) / 4
    assert float(spectrum.moment(3.0)) == pytest.approx(third, rel=1e-12)
    assert float(spectrum.liquid_water_g_per_m3()) == pytest.approx(math.pi / 6e3 * third, rel=1e-12)
    diameter, width = spectrum.quadrature()
    summed = (diameter**3 * spectrum.number_density_per_m3_mm(diameter) * width).sum()
    assert float(summed) == pytest.approx(third, rel=1e-12)


def test_tail_and_its_inverse_over_an_empty_bin() -> None:
    spectrum = Binned(EDGES, DENSITY)
    tail = spectrum.tail_per_m3(torch.tensor([0.1, 0.3, 0.5, 0.8, 1.4, 2.0, 3.0]))
    torch.testing.assert_close(tail, torch.tensor([260.0, 160.0, 60.0, 60.0, 30.0, 0.0, 0.0], dtype=torch.float64))
    back = spectrum.inverse_tail(torch.tensor([260.0, 160.0, 30.0, 0.0]))
    torch.testing.assert_close(back, torch.tensor([0.2, 0.3, 1.4, 2.0], dtype=torch.float64))


def test_no_drop_is_sampled_in_an_empty_bin() -> None:
    sample = Binned(EDGES, DENSITY).sample_diameter_mm(torch.linspace(0, 0.999999, 4001, dtype=torch.float64))
    assert not bool(((sample > 0.4 + 1e-9) & (sample < 0.8 - 1e-9)).any())


def test_disdrometer_counts_become_a_density() -> None:
    speed = [1.0, 4.0]
    spectrum = Binned.from_counts(
        [54.0, 21.6], [0.5, 1.0, 3.0], area_m2=0.0054, duration_s=60.0, fall_speed_m_per_s=speed
    )
    volume_m3 = [0.0054 * 60.0 * v for v in speed]
    wanted = [54.0 / volume_m3[0] / 0.5, 21.6 / volume_m3[1] / 2.0]
    torch.testing.assert_close(spectrum.density_per_m3_mm, torch.tensor(wanted, dtype=torch.float64))


def test_binned_marshall_palmer_has_its_extinction() -> None:
    rain = marshall_palmer(10.0)
    edges = torch.linspace(0.1, 8.0, 300, dtype=torch.float64)
    middle = 0.5 * (edges[1:] + edges[:-1])
    binned = Binned(edges, rain.number_density_per_m3_mm(middle))
    got, wanted = (float(extinction_per_m(spectrum, 905.0)) for spectrum in (binned, rain))
    assert got == pytest.approx(wanted, rel=1e-3)  # boxes 0.026 mm wide
    shadows = float(binned.moment(2.0) / rain.moment(2.0))
    # 4e-4: trapezoids 2 % wide overestimate D^3 by 3e-4, which only cancels where the density is smooth
    assert got / wanted == pytest.approx(shadows, rel=4e-4)


def test_extinction_of_coarse_bins_is_that_of_their_boxes() -> None:
    spectrum = Binned(EDGES, DENSITY)
    geometric = 2.0 * 0.25 * math.pi * 1e-6 * float(spectrum.moment(2.0))
    assert float(extinction_per_m(spectrum, 550.0, q_ext=2.0)) == pytest.approx(geometric, rel=1e-12)
    # Q_ext is 1 % above 2 for these sizes; 2e-3 for the nodes next to the jumps
    mie = float(extinction_per_m(spectrum, 550.0))
    edge_term = 1.0 + 0.5 * 1.9923861 * (math.pi * 1.1e6 / 550.0) ** (-2 / 3)
    assert mie / geometric == pytest.approx(edge_term, abs=2e-3)


def test_per_radius_bins_hold_the_same_particles() -> None:
    per_radius = Binned([0.1, 0.2, 0.4, 1.0], [2000.0, 0.0, 100.0], per_size="radius")
    assert float(per_radius.total_per_m3) == pytest.approx(260.0)
    assert per_radius.diameter_max_mm == 2.0


def test_batched_spectra() -> None:
    batch = Binned(EDGES, torch.tensor([DENSITY, [1.0, 2.0, 3.0]]))
    assert batch.batch_shape == (2,)
    assert batch.total_per_m3.shape == (2,)
    diameter = torch.tensor([0.3, 1.0, 5.0])
    assert batch.number_density_per_m3_mm(diameter).tolist() == [[1000.0, 50.0, 0.0], [1.0, 3.0, 0.0]]
    assert batch.tail_per_m3(diameter).shape == (2, 3)
    assert batch.sample_diameter_mm(torch.rand(2, 5)).shape == (2, 5)
    assert batch.scaled(torch.tensor([2.0, 1.0])).total_per_m3.tolist() == [520.0, float(batch.total_per_m3[1])]


def test_cutting_a_spectrum_cuts_a_bin_in_two() -> None:
    cut = Binned(EDGES, DENSITY).within(0.3, 1.0)
    assert float(cut.total_per_m3) == pytest.approx(100.0 + 10.0)


@pytest.mark.parametrize(
    ("edges", "density", "message"),
    [
        ([0.1, 0.2], [1.0, 2.0], r"\(K \+ 1,\)"),
        ([0.2, 0.1], [1.0], "rise"),
        ([0.1, 0.2], [-1.0], "density_per_m3_mm"),
        ([0.1, 0.2], [math.nan], "density_per_m3_mm"),
    ],
)
def test_broken_bins_are_refused(edges: list[float], density: list[float], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        Binned(edges, density)


def test_counts_need_a_speed() -> None:
    with pytest.raises(ValueError, match="fall_speed_m_per_s"):
        Binned.from_counts([1.0], [0.1, 0.2], area_m2=0.005, duration_s=60.0, fall_speed_m_per_s=[0.0])
    speed = rain_fall_speed_m_per_s(torch.tensor([0.15]))
    assert Binned.from_counts([1.0], [0.1, 0.2], area_m2=0.005, duration_s=60.0, fall_speed_m_per_s=speed)
