"""Suites: weathers of five severities each, that a detector of one sensor is tested in, as YAML files.

A suite holds ``format: torchweather-suite/1`` and

- ``title``: what it tests, in words;
- ``sensor``: ``kind`` (``camera``, ``lidar``, ``radar``), and a ``preset`` or fields where the severities belong to one
  sensor; without them the data's own sensor is taken;
- ``weathers``: by name, the weather's fields (``kind`` where the name is none), its rate or visibility a list of five,
  lightest first; of a mixture (``parts``) one part or several have a list;
- ``options``: keyword arguments of the sensor's transform.
"""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import dataclass, field
from itertools import pairwise
from pathlib import Path
from typing import Any

from torchweather.atmosphere.weather import WEATHERS, Weather, weather_from_dict
from torchweather.core.errors import TorchweatherError, nearest_name
from torchweather.recipes.files import SUITE, check_format, files_of, find, name_of, read_yaml, refuse_unknown
from torchweather.recipes.options import OPTIONS
from torchweather.recipes.recipe import sensor_of_values
from torchweather.sensors import SENSOR_CLASSES

__all__ = ["FORMAT", "SEVERITIES", "Condition", "Suite", "list_suites", "read_suite"]

FORMAT = "torchweather-suite/1"
SEVERITIES = 5
REQUIRED = ("format", "title", "sensor", "weathers")
KEYS = (*REQUIRED, "options")
MIXTURE = "mixture"
# Worse is more of the one and less of the other.
RISES = {"rate_mm_per_h": True, "mor_m": False}


@dataclass(frozen=True)
class Condition:
    """One weather in one severity.

    Args:
        name: of the weather in the suite.
        kind: of what gets heavier: ``rain``, ``fog`` or ``snow``; in a mixture of the first part that does.
        knob: ``rate_mm_per_h`` or ``mor_m``.
        value: of the knob, mm/h or m.
        severity: 1 is the lightest, 5 the heaviest.
        weather: the whole.
    """

    name: str
    kind: str
    knob: str
    value: float
    severity: int
    weather: Weather


@dataclass(frozen=True)
class Suite:
    """Weathers of five severities as their file states them.

    Args:
        name: path below the recipes' folder without its ending, such as ``camera/robustness``; for a file of one's
            own, its name.
        title: what it tests.
        sensor: ``kind``, and ``preset`` or fields where it belongs to one sensor.
        weathers: by name, plain values with a list of five in the place of a number.
        options: keyword arguments of the sensor's transform.
        path: the file.
    """

    name: str
    title: str
    sensor: Mapping[str, Any]
    weathers: Mapping[str, Mapping[str, Any]]
    options: Mapping[str, Any] = field(default_factory=dict)
    path: Path | None = None

    @property
    def sensor_kind(self) -> str:
        """``camera``, ``lidar`` or ``radar``."""
        return str(self.sensor["kind"])

    def conditions(self) -> list[Condition]:
        """Every weather in every severity, a weather's five together, lightest first.

        Example:
            >>> [(c.name, c.severity, c.value) for c in read_suite("camera/robustness").conditions()][:2]
            [('rain', 1, 2.5), ('rain', 2, 10.0)]
        """
        return [
            _condition(name, fields, severity)
            for name, fields in self.weathers.items()
            for severity in range(1, SEVERITIES + 1)
        ]


def list_suites() -> list[Suite]:
    """All ready-made suites, by name.

    Example:
        >>> [suite.name for suite in list_suites()]
        ['camera/robustness', 'lidar/robustness', 'radar/robustness']
    """
    return sorted((read_suite(path) for path in files_of(SUITE)), key=lambda suite: suite.name)


def read_suite(name_or_path: str | os.PathLike[str]) -> Suite:
    """A suite by name (``camera/robustness``, or the last part where only one ends so) or from a file.

    Raises:
        ValueError: no suite of this name, or several.
        TorchweatherError: the file is missing, no YAML, of another format, has unknown or missing keys, or a weather
            whose severities are not five that rise.

    Example:
        >>> suite = read_suite("camera/robustness")
        >>> suite.sensor_kind, list(suite.weathers), len(suite.conditions())
        ('camera', ['rain', 'fog', 'snow'], 15)
    """
    path = find(name_or_path, "suite", SUITE)
    return _checked(read_yaml(path, "suite"), path)


# ---- checking ------------------------------------------------------------------------------------------------------


def _checked(values: Any, path: Path) -> Suite:
    check_format(values, path, "suite", FORMAT, required=REQUIRED, known=KEYS)
    options = values.get("options") or {}
    for key, value in (("sensor", values["sensor"]), ("weathers", values["weathers"]), ("options", options)):
        if not isinstance(value, Mapping) or (key == "weathers" and not value):
            raise TorchweatherError(f"{path}: {key} must be keys with values; got {value!r}.")
    sensor = dict(values["sensor"])
    kind = sensor.get("kind")
    if kind not in SENSOR_CLASSES:
        raise TorchweatherError(
            f"{path}: sensor.kind must be one of {', '.join(SENSOR_CLASSES)}; got {kind!r}."
            f"{nearest_name(kind, SENSOR_CLASSES)}"
        )
    refuse_unknown(options, OPTIONS[str(kind)], path, "option")
    weathers = {str(name): _weather(name, fields, path) for name, fields in values["weathers"].items()}
    suite = Suite(name_of(path), str(values["title"]), sensor, weathers, dict(options), path)
    try:
        if len(sensor) > 1:
            sensor_of_values(sensor, str(kind))
        conditions = suite.conditions()
    except (TypeError, ValueError, KeyError) as error:
        raise TorchweatherError(f"{path}: {error}") from error
    _check_order(conditions, path)
    return suite


def _weather(name: object, fields: Any, path: Path) -> dict[str, Any]:
    """The fields of a weather, its kind among them."""
    if not isinstance(fields, Mapping):
        raise TorchweatherError(f"{path}: weathers.{name} must be keys with values; got {fields!r}.")
    found = dict(fields)
    found.setdefault("kind", MIXTURE if "parts" in found else str(name))
    parts = found.get("parts", [found])
    if not isinstance(parts, list) or not all(isinstance(part, Mapping) and part.get("kind") for part in parts):
        raise TorchweatherError(f"{path}: weathers.{name}.parts must be a list of weathers, each with its kind.")
    for part in parts:
        if part["kind"] not in WEATHERS:
            raise TorchweatherError(
                f"{path}: weathers.{name}: kind must be one of {', '.join(WEATHERS)}; got {part['kind']!r}."
                f"{nearest_name(part['kind'], WEATHERS)}"
            )
    varied = [part[_knob(part)] for part in parts if isinstance(part.get(_knob(part)), list)]
    if not varied or any(len(values) != SEVERITIES for values in varied):
        knobs = ", ".join(dict.fromkeys(_knob(part) for part in parts))
        raise TorchweatherError(
            f"{path}: weathers.{name}: wanted {SEVERITIES} severities, a list of {SEVERITIES} values of {knobs}; got "
            f"{[len(values) for values in varied] or 'no list'}."
        )
    return found


def _check_order(conditions: list[Condition], path: Path) -> None:
    for before, after in pairwise(conditions):
        if before.name != after.name:
            continue
        heavier = after.value > before.value if RISES[after.knob] else after.value < before.value
        if not heavier:
            raise TorchweatherError(
                f"{path}: weathers.{after.name}: severities must get heavier, lightest first (rates rise, visibilities "
                f"fall); got {before.value:g} before {after.value:g}."
            )


def _knob(fields: Mapping[str, Any]) -> str:
    return WEATHERS[fields["kind"]].knob_name


def _condition(name: str, fields: Mapping[str, Any], severity: int) -> Condition:
    parts = fields.get("parts", [fields])
    varied = next(part for part in parts if isinstance(part[_knob(part)], list))
    weather = weather_from_dict(_at(fields, severity))
    return Condition(name, varied["kind"], _knob(varied), float(varied[_knob(varied)][severity - 1]), severity, weather)


def _at(fields: Mapping[str, Any], severity: int) -> dict[str, Any]:
    """The fields in one severity."""
    if "parts" in fields:
        return {**fields, "parts": [_at(part, severity) for part in fields["parts"]]}
    knob = fields[_knob(fields)]
    return {**fields, _knob(fields): knob[severity - 1] if isinstance(knob, list) else knob}
