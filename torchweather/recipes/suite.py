"""A recipe of kind suite: weathers of five severities each, that a detector of one sensor is tested in."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from itertools import pairwise
from pathlib import Path
from typing import Any, ClassVar

from torchweather.atmosphere.weather import WEATHERS, Weather, weather_from_dict, weather_kind, weather_names
from torchweather.core.errors import TorchweatherError
from torchweather.core.schema import MAPPING, ROWS, check_keys, check_value, one_of, refuse_unknown
from torchweather.recipes.files import name_of
from torchweather.recipes.options import OPTIONS, current_names
from torchweather.recipes.transform import refuse_overrides, sensor_keys
from torchweather.sensors import SENSOR_CLASSES

__all__ = ["SEVERITIES", "Condition", "SuiteRecipe", "checked_suite"]

SEVERITIES = 5
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
        value: of the intensity, mm/h or m.
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
class SuiteRecipe:
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

    kind: ClassVar[str] = "suite"
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

    def build(self, **overrides: Any) -> SuiteRecipe:
        """The suite itself; it has no overrides."""
        refuse_overrides(overrides, (), "load_recipe")
        return self

    def conditions(self) -> list[Condition]:
        """Every weather in every severity, a weather's five together, lightest first.

        Example:
            >>> from torchweather.recipes import load_recipe
            >>> [(c.name, c.severity, c.value) for c in load_recipe("camera/robustness").conditions()][:2]
            [('rain', 1, 2.5), ('rain', 2, 10.0)]
        """
        return [
            _condition(name, fields, severity)
            for name, fields in self.weathers.items()
            for severity in range(1, SEVERITIES + 1)
        ]


def checked_suite(values: Mapping[str, Any], path: Path) -> SuiteRecipe:
    """The suite of a file's values, whose keys are of the schema.

    Raises:
        TorchweatherError: with the file and the key.
    """
    file, sensor = str(path), dict(values["sensor"])
    options = current_names(values.get("options") or {}, f"{file}: options")
    check_value(sensor.get("kind"), one_of(SENSOR_CLASSES), file, "sensor.kind")
    check_keys(sensor, sensor_keys(sensor["kind"]), file, "sensor")
    refuse_unknown(options, OPTIONS[sensor["kind"]], "options", file)
    weathers = {name: _weather(name, fields, file) for name, fields in values["weathers"].items()}
    suite = SuiteRecipe(name_of(path), str(values["title"]), sensor, weathers, options, path)
    try:
        if len(sensor) > 1:
            SENSOR_CLASSES[suite.sensor_kind].from_values(sensor)
    except (TypeError, ValueError, KeyError) as error:
        raise TorchweatherError(f"{path}: sensor: {error}") from error
    for name, fields in weathers.items():
        try:
            conditions = [_condition(name, fields, severity) for severity in range(1, SEVERITIES + 1)]
        except (TypeError, ValueError, KeyError) as error:
            raise TorchweatherError(f"{path}: weathers.{name}: {error}") from error
        for before, after in pairwise(conditions):
            if not (after.value > before.value if RISES[after.knob] else after.value < before.value):
                raise TorchweatherError(
                    f"{path}: weathers.{name}: severities must get heavier, lightest first (rates rise, visibilities "
                    f"fall); got {before.value:g} before {after.value:g}."
                )
    return suite


def _weather(name: str, fields: Any, file: str) -> dict[str, Any]:
    """The fields of a weather, its kind among them."""
    at = f"weathers.{name}"
    check_value(fields, MAPPING, file, at)
    found = dict(fields)
    found.setdefault("kind", MIXTURE if "parts" in found else name)
    parts = found.get("parts", [found])
    check_value(parts, ROWS, file, f"{at}.parts")
    for part in parts:
        check_value(part.get("kind"), one_of(weather_names()), file, f"{at}.kind")
        if part["kind"] in WEATHERS and _intensity(part) not in part:
            raise TorchweatherError(f"{file}: {at}.{_intensity(part)} is missing; expected a number or {SEVERITIES}.")
    varied = [part[_intensity(part)] for part in parts if isinstance(part.get(_intensity(part)), list)]
    if not varied or any(len(values) != SEVERITIES for values in varied):
        intensities = ", ".join(dict.fromkeys(_intensity(part) for part in parts))
        raise TorchweatherError(
            f"{file}: {at}: expected {SEVERITIES} severities, a list of {SEVERITIES} values of {intensities}; got "
            f"{[len(values) for values in varied] or 'no list'}."
        )
    return found


def _intensity(fields: Mapping[str, Any]) -> str:
    return str(weather_kind(fields["kind"]).intensity_name)


def _condition(name: str, fields: Mapping[str, Any], severity: int) -> Condition:
    parts = fields.get("parts", [fields])
    varied = next(part for part in parts if isinstance(part.get(_intensity(part)), list))
    weather = weather_from_dict(_at(fields, severity))
    return Condition(
        name, varied["kind"], _intensity(varied), float(varied[_intensity(varied)][severity - 1]), severity, weather
    )


def _at(fields: Mapping[str, Any], severity: int) -> dict[str, Any]:
    """The fields in one severity."""
    if "parts" in fields:
        return {**fields, "parts": [_at(part, severity) for part in fields["parts"]]}
    intensity = fields.get(_intensity(fields))
    return {**fields, _intensity(fields): intensity[severity - 1]} if isinstance(intensity, list) else dict(fields)
