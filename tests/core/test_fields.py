"""Every field of a sensor or a weather refuses what is no value of it, by name, unit and value."""

from __future__ import annotations

import math
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np
import pytest
import torch

import torchweather as tw
from torchweather import physics
from torchweather.core.errors import TorchweatherError
from torchweather.core.fields import above, at_least, between, check_fields

GOOD: dict[str, Any] = {
    "camera": tw.Camera.preset("lucid-triton"),
    "lidar": tw.Lidar.preset("velodyne-hdl-64e"),
    "radar": tw.Radar.preset("imaging-77ghz"),
    "rain": tw.Rain(5.0),
    "snow": tw.Snow(1.0),
    "fog": tw.Fog(100.0),
}
WRONG: dict[str, Any] = {
    "inf": math.inf,
    "nan": math.nan,
    "huge": 1e308,
    "minus huge": -1e308,
    "tensor of nan": torch.tensor(math.nan),
    "text": "3",
    "word": "no",
    "object": object(),
    "list": [1, 2],
    "complex": 1j,
    "empty": torch.zeros(0),
}
# What is a value all the same: no fog, focus at infinity, an empty batch.
TAKEN = {
    *(("fog", "mor_m", what) for what in ("inf", "huge", "empty")),
    *(("camera", "focus_distance_m", what) for what in ("inf", "huge")),
    *((name, "rate_mm_per_h", "empty") for name in ("rain", "snow")),
    *((name, f"patch_{what}", "empty") for name in ("rain", "snow", "fog") for what in ("log_std", "length_m")),
}


@pytest.mark.parametrize(
    ("name", "field"), [(name, field.name) for name, one in GOOD.items() for field in fields(one) if field.init]
)
def test_what_is_no_value_of_a_field_is_refused_by_its_name(name: str, field: str) -> None:
    for what, value in WRONG.items():
        if (name, field, what) in TAKEN:
            continue
        with pytest.raises(TorchweatherError) as caught:
            replace(GOOD[name], **{field: value})
        assert type(GOOD[name]).__name__ in str(caught.value), what


@pytest.mark.parametrize("name", ["rain", "snow"])
def test_a_flag_is_a_flag(name: str) -> None:
    with pytest.raises(TypeError, match="close_rate must be True or False; got 'no'"):
        replace(GOOD[name], close_rate="no")


@dataclass(frozen=True)
class Made:
    """A dataclass as the library has them."""

    count: int = 3
    length_m: float = 1.0
    angles_rad: tuple[float, ...] | None = None
    pair: tuple[float, float] = (0.0, 1.0)
    name: str = "x"

    def __post_init__(self) -> None:
        check_fields(
            self,
            {
                "count": at_least(1, 10, "pieces"),
                "length_m": above(0.0, 5.0, "m", advice="A car is 4 m."),
                "angles_rad": between(-1.0, 1.0, "rad"),
            },
        )


def test_numbers_become_plain_ones() -> None:
    made = Made(np.int64(4), torch.tensor(2), np.array([0.5, -0.5]), [1, 2])  # type: ignore[arg-type]
    assert made == Made(4, 2.0, (0.5, -0.5), (1.0, 2.0))
    assert [type(one) for one in (made.count, made.length_m, made.pair[0])] == [int, float, float]


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"count": 2.5}, r"Made: count must be a whole number in pieces; got 2\.5"),
        ({"count": 0}, r"Made: count must be 1 pieces or more; got 0"),
        ({"count": 11}, r"Made: count must lie in 1\.\.10 pieces; got 11"),
        ({"length_m": 0.0}, r"Made: length_m must be above 0 m; got 0\.0\. A car is 4 m\."),
        ({"length_m": 6.0}, r"Made: length_m must lie in 0\.\.5 m; got 6\.0"),
        ({"length_m": True}, r"Made: length_m must be above 0 m; got True"),
        ({"angles_rad": (0.0, 2.0)}, r"Made: angles_rad must lie in -1\.\.1 rad; got 2\.0"),
        ({"angles_rad": 0.5}, r"Made: angles_rad must be a sequence of numbers in rad; got 0\.5"),
        ({"pair": (1.0,)}, r"Made: pair must be a sequence of 2 numbers; got \(1\.0,\)"),
        ({"pair": (1.0, math.inf)}, r"Made: pair must be a finite number; got inf"),
        ({"name": 3}, r"Made: name must be text; got 3"),
        ({"name": None}, r"Made: name must be text; got None"),
    ],
)
def test_messages_name_unit_value_and_remedy(given: dict[str, Any], message: str) -> None:
    with pytest.raises((TypeError, ValueError), match=message):
        Made(**given)


@pytest.mark.parametrize("size", [-1.0, math.nan])
@pytest.mark.parametrize(
    "function",
    [
        physics.rain_fall_speed_m_per_s,
        physics.snow_fall_speed_m_per_s,
        physics.flake_fall_speed_m_per_s,
        physics.physical_diameter_mm,
        physics.melted_diameter_mm,
        physics.snow_bulk_density_g_per_cm3,
    ],
)
def test_a_size_below_nothing_has_no_physics(function: Any, size: float) -> None:
    for value in (size, torch.tensor([1.0, size])):
        with pytest.raises(ValueError, match=r"_mm must be 0 mm or more; got"):
            function(value)


@pytest.mark.parametrize("value", ["3", object(), True, None])
def test_physics_takes_numbers(value: Any) -> None:
    for function in (physics.rain_fall_speed_m_per_s, physics.normal_reflectance, physics.water_refractive_index):
        with pytest.raises(TypeError, match=r"a number or a tensor of (real )?numbers; got"):
            function(value)
    with pytest.raises((TypeError, ValueError)):
        physics.mie_efficiencies(3.0, value)


def test_an_index_of_refraction_is_finite() -> None:
    for index in (math.inf, math.nan, -1.0, 1.3 - 0.1j):
        for function in (physics.normal_reflectance, physics.axial_q_back, lambda m: physics.mie_efficiencies(3.0, m)):
            with pytest.raises(ValueError, match="refractive_index"):
                function(index)
