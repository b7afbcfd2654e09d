"""Intensities that contradict the declared unit are judged by their bulk, not by their maximum."""

from __future__ import annotations

import warnings

import pytest
import torch
from torch import Tensor

from torchweather.core.errors import TorchweatherWarning
from torchweather.lidar.clouds import _too_bright, check_points
from torchweather.sensors import Lidar


def cloud(intensities: Tensor) -> Tensor:
    xyz = torch.tensor([10.0, 0.0, 0.0]).expand(len(intensities), 3)
    return torch.cat([xyz, intensities[:, None]], 1)


def check(unit: str, intensities: Tensor) -> str:
    """The warning, or nothing."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always", TorchweatherWarning)
        check_points(cloud(intensities), Lidar(905.0, intensity_unit=unit), "test")
    return str(caught[0].message) if caught else ""


DIM = torch.linspace(0.0, 1.0, 1000)  # reflectivities of a road
COUNTS = (DIM * 100).floor()


@pytest.mark.parametrize(
    ("unit", "values"),
    [
        ("reflectivity", DIM),
        ("reflectivity", torch.cat([DIM, torch.tensor([40.0, 90.0])])),  # two retroreflectors
        ("uint8_linear", COUNTS),
        ("uint8_calibrated", torch.cat([COUNTS, torch.tensor([255.0])])),
        ("photons", COUNTS * 100),
        ("uint8_linear", torch.zeros(9)),
    ],
)
def test_plausible_intensities_pass(unit: str, values: Tensor) -> None:
    assert check(unit, values) == ""


@pytest.mark.parametrize(
    ("unit", "values", "guess"),
    [
        ("reflectivity", COUNTS, r"a tenth lies above 90, .*Is the unit uint8_linear"),
        ("reflectivity", COUNTS * 40, r"a tenth lies above 3[0-9]{3}, .*Is the unit photons"),
        ("uint8_linear", COUNTS * 40, "Is the unit photons"),
        ("uint8_linear", DIM, r"Is the unit reflectivity \(0-1\)"),
        ("reflectivity_percent", DIM * 0.9, r"Is the unit reflectivity \(0-1\)"),
    ],
)
def test_a_bulk_that_is_no_such_unit_is_questioned(unit: str, values: Tensor, guess: str) -> None:
    with pytest.warns(TorchweatherWarning, match=guess):
        check_points(cloud(values), Lidar(905.0, intensity_unit=unit), "test")


def test_a_few_points_above_eight_bits_do_not_make_photons() -> None:
    text = check("uint8_linear", torch.cat([COUNTS, torch.tensor([3000.0, 400.0])]))
    assert "2 of 992 lie above 255" in text
    assert "nine tenths lie at 90 or below" in text
    assert "photons" not in text


@pytest.mark.parametrize(("bright", "says"), [(1, False), (2, True)])
def test_a_tenth_of_bright_returns_is_no_evidence_against_reflectivity(bright: int, says: bool) -> None:
    """Nine of ten values at 4 or below hold the 90 % quantile down; eight of ten do not."""
    intensity = torch.tensor([0.0] * 5 + [4.0] * (10 - bright) + [30.0] * bright)
    assert bool(_too_bright(intensity, "reflectivity")) == says
