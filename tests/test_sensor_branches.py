"""Branches on the kind of a sensor: a new sensor adds a class or an entry of a table, and no branch elsewhere."""

from __future__ import annotations

import ast
from collections import Counter
from functools import cache
from pathlib import Path

import pytest

from tests.sources import walk

PACKAGE = Path(__file__).parents[1] / "torchweather"

KINDS = frozenset({"camera", "lidar", "radar", "link"})
SENSORS = frozenset({"Camera", "Lidar", "Radar"})
CLASSES = SENSORS | {
    *("BayerWeather", "LidarWeather", "RadarAttenuation", "RadarMapWeather", "RangeDopplerMap"),
    *("CameraResult", "RgbResult", "LidarResult", "RadarResult", "RadarMapResult"),
    *("CameraSubject", "LidarSubject", "RadarSubject", "RadarSceneSubject"),
    *("CameraFile", "LidarFile", "RadarFile"),
}

# Files that check the type of an argument which a user hands over, or whose word only reads as a kind; how often.
BORDERS = {
    "camera/depth/scene_prior.py": 1,
    "camera/rgb.py": 1,
    "datasets/depth_sources.py": 1,
}
LIMITS = {"report": 1}


def is_branch(node: ast.AST) -> bool:
    """True for a comparison with the name of a kind, and for a question for the class of one sensor."""
    if isinstance(node, ast.Compare):
        inner = [one for value in (node.left, *node.comparators) for one in _elements(value)]
        return any(_names_a_kind(one) for one in inner)
    if isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and node.func.id in ("isinstance", "issubclass"):
        return any(isinstance(one, ast.Name) and one.id in CLASSES for one in ast.walk(node.args[1]))
    return isinstance(node, ast.MatchValue | ast.MatchClass) and any(
        _names_a_kind(one) or (isinstance(one, ast.Name) and one.id in CLASSES) for one in ast.iter_child_nodes(node)
    )


def _elements(value: ast.expr) -> list[ast.expr]:
    return list(value.elts) if isinstance(value, ast.Tuple | ast.Set | ast.List) else [value]


def _names_a_kind(node: ast.AST) -> bool:
    if isinstance(node, ast.Constant):
        return isinstance(node.value, str) and node.value in KINDS
    return isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name) and node.value.id in SENSORS


@cache
def branches() -> Counter[str]:
    """Number of branches of each file that has some."""
    return Counter(
        path.relative_to(PACKAGE).as_posix()
        for path in sorted(PACKAGE.rglob("*.py"))
        for node in walk(ast.parse(path.read_text(encoding="utf-8")))
        if is_branch(node)
    )


def test_no_branch_on_a_kind_of_sensor_outside_the_known_places() -> None:
    other = {name: number for name, number in branches().items() if name.split("/")[0] not in LIMITS}
    new = {name: number for name, number in other.items() if number > BORDERS.get(name, 0)}
    assert not new, f"{new}: let the sensor's class or a table answer, or name a check of an argument in BORDERS"


@pytest.mark.parametrize("folder", list(LIMITS))
def test_the_branches_of_a_folder_become_no_more(folder: str) -> None:
    found = {name: number for name, number in branches().items() if name.split("/")[0] == folder}
    assert sum(found.values()) <= LIMITS[folder], f"{sum(found.values())}: {found}"


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ('kind == "lidar"', True),
        ('kind in ("camera", "radar")', True),
        ('"lidar" in keys', True),
        ("kind == Lidar.kind", True),
        ("isinstance(sensor, Lidar)", True),
        ("issubclass(kind, (BayerWeather, LidarWeather))", True),
        ("FILES[file.kind]", False),
        ('weather.kind == "fog"', False),
        ("isinstance(sensor, Sensor)", False),
    ],
)
def test_a_branch_is_seen(text: str, expected: bool) -> None:
    assert any(is_branch(node) for node in ast.walk(ast.parse(text))) == expected
