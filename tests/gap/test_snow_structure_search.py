"""The search names a hidden structure of snow, and where it is."""

from __future__ import annotations

from typing import Any

import pytest

from torchweather.gap import find_gap
from torchweather.gap.study.hidden import WEATHERS, hidden_study
from torchweather.lidar.effects.all import EFFECTS

HIDDEN: list[tuple[str, dict[str, float]]] = [
    ("lidar.particle_density_azimuth", {"amplitude": 3.0, "azimuth_rad": 2.0, "width_rad": 0.6}),
    ("lidar.particle_density_elevation", {"amplitude": 3.0, "elevation_rad": 0.1, "width_rad": 0.15}),
    ("lidar.particle_sizes", {"factor_1mm": 4.0}),
    ("lidar.near_response", {"full_m": 15.0, "power": 2.0}),
]


@pytest.mark.long
@pytest.mark.parametrize(("name", "values"), HIDDEN, ids=[name for name, _ in HIDDEN])
def test_a_hidden_structure_of_snow_is_named(name: str, values: dict[str, Any]) -> None:
    hidden = hidden_study([EFFECTS[name](**values)], WEATHERS["snow"], columns=64, seed=5)
    found = find_gap(hidden.study, seed=0).to_dict()
    assert (found["verdict"], [one["name"] for one in found["effects"]]) == ("named", [name])
    for parameter, value in values.items():
        # 4,096 beams; the model that searches is the one that hid it.
        assert found["effects"][0]["parameters"][parameter] == pytest.approx(value, rel=0.2)
