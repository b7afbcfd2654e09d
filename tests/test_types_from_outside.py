"""Types as a user's strict type checker sees them: ``mypy`` checks the scripts in ``tests/typing`` with the package."""

from __future__ import annotations

import ast
import runpy
from dataclasses import fields
from pathlib import Path

import pytest

from torchweather.camera.sensor import Camera, CameraFields
from torchweather.lidar.sensor import Lidar, LidarFields
from torchweather.radar.sensor import Radar, RadarFields

SCRIPT = Path(__file__).parent / "typing" / "user_script.py"


def test_the_users_script_runs() -> None:
    assert runpy.run_path(str(SCRIPT))["wet"].shape == (1, 48, 64)


@pytest.mark.parametrize(("sensor", "typed"), [(Camera, CameraFields), (Lidar, LidarFields), (Radar, RadarFields)])
def test_the_typed_fields_of_a_preset_are_those_of_the_sensor(sensor: type, typed: type) -> None:
    declared = {one.name: str(one.type) for one in fields(sensor)}  # type: ignore[arg-type]
    found = {name: ast.unparse(ast.parse(one.__forward_arg__)) for name, one in typed.__annotations__.items()}
    for name in sensor.drawable:  # type: ignore[attr-defined]
        assert " | Distribution" in found[name], name
    plain = {name: text.replace(" | Distribution", "") for name, text in found.items()}
    assert plain == {name: ast.unparse(ast.parse(text)) for name, text in declared.items()}
