"""Common parts of the three sensors: presets, YAML files of one's own, a plain dictionary and back."""

from __future__ import annotations

import itertools
import re
from collections.abc import Collection, Iterator, Mapping
from dataclasses import MISSING, fields, replace
from functools import lru_cache
from importlib import resources
from pathlib import Path
from typing import Any, ClassVar, Self

from torch import Tensor

from torchweather.core.arguments import check_arguments
from torchweather.core.distributions import Distribution, with_distributions
from torchweather.core.errors import InputTypeError, InputValueError, TorchweatherError, check_one_of, nearest_name
from torchweather.core.plugins import Plugin, find_plugin, plugin_names
from torchweather.core.schema import ANY, check_keys, field_keys, one_of
from torchweather.core.yaml_file import parse_yaml, read_yaml

__all__ = ["Sensor"]

SENSOR_KINDS = ("camera", "lidar", "radar")
SENSOR_FILES = (".yaml", ".yml")
# Keys of a sensor file that are no fields of the sensor.
_OTHER_KEYS = ("kind", "preset", "source")


@lru_cache(maxsize=1)
def _preset_texts() -> dict[str, dict[str, str]]:
    """YAML of each preset, by kind and name: to parse all of them for one costs 0.15 s."""
    text = resources.files("torchweather").joinpath("presets", "sensors.yaml").read_text(encoding="utf-8")
    found: dict[str, dict[str, str]] = {}
    for kind, presets in _blocks(text, ""):
        found[kind] = dict(_blocks(presets, "  "))
    return {kind: found[kind] for kind in SENSOR_KINDS}


def _blocks(text: str, indent: str) -> Iterator[tuple[str, str]]:
    """Keys of a YAML mapping whose lines have this indent, and the lines of each."""
    starts = list(re.finditer(rf"^{indent}([\w.-]+):", text, re.MULTILINE))
    for start, end in itertools.pairwise([*(one.start() for one in starts), len(text)]):
        lines = text[start:end]
        yield lines.partition(":")[0].strip(), lines


@lru_cache(maxsize=256)
def _preset(kind: str, name: str) -> dict[str, Any]:
    """Plain values of a preset of the library."""
    values: dict[str, Any] = parse_yaml(_preset_texts()[kind][name], "sensors.yaml", "the presets")[name]
    return values


def _preset_names(kind: str) -> list[str]:
    """Presets of the library and of installed packages."""
    return [*_preset_texts()[kind], *plugin_names("sensors", f"{kind}.")]


class Sensor:
    """Base of the three sensors: presets, a plain dictionary and back."""

    kind: ClassVar[str] = ""
    data_key: ClassVar[str] = "points"
    """Key of its data in a sample where no other is given."""
    data_fields: ClassVar[tuple[str, ...]] = ()
    """Fields that belong to the data and not to a recipe."""
    drawable: ClassVar[tuple[str, ...]] = ()
    """Fields that may be drawn for each sample: what is seldom known of a sensor."""

    @property
    def random(self) -> dict[str, Distribution]:
        """Fields that are drawn for each sample, by name."""
        return {name: value for name, value in vars(self).items() if isinstance(value, Distribution)}

    def with_values(self, values: Mapping[str, Any]) -> Self:
        """The same sensor with other values of fields that ``random`` names."""
        return replace(self, **values) if values else self  # type: ignore[type-var]

    def _ends_are_good(self) -> bool:
        """Check whether anything is drawn for each sample; all corners of what can be drawn have then been checked."""
        random = self.random
        for name, one in random.items():
            if name not in self.drawable:
                raise InputValueError(
                    f"{type(self).__name__}: {name} cannot be drawn for each sample; got {one!r}. Give a number. Drawn "
                    f"can be: {', '.join(self.drawable)}."
                )
        if not random:
            return False
        for corner in itertools.product(*(one.ends() for one in random.values())):
            values = dict(zip(random, corner, strict=True))
            try:
                plain = self.with_values(values)
            except (TypeError, ValueError) as error:
                raise type(error)(f"{error} It is an end of {random!r}.") from error
        for field in fields(self):  # type: ignore[arg-type]
            if field.name not in random:  # what the constructor completes
                object.__setattr__(self, field.name, getattr(plain, field.name))
        return True

    @classmethod
    def of(cls, value: object) -> Self:
        """The sensor from itself, from its plain values, or from the name of a preset or file."""
        if isinstance(value, cls):
            return value
        return cls.from_dict(value) if isinstance(value, Mapping) else cls.preset(str(value))

    @classmethod
    def check(cls, value: object, argument: str, example: str, *, owner: object) -> None:
        """Raise `InputTypeError` unless the value is a sensor of this class; the error names a preset as example."""
        if not isinstance(value, cls):
            raise InputTypeError(
                f"{type(owner).__name__}: {argument} must be a {cls.__name__}, such as "
                f"{cls.__name__}.preset({example!r}); got {value!r}."
            )

    @classmethod
    def preset(cls, name: str, **overrides: Any) -> Self:
        """The named sensor of the library, or of a YAML file, with any field replaced.

        Args:
            name: a preset of the library or of an installed package, or the path of a ``.yaml``/``.yml`` file with
                the sensor's own fields. Such a file may name a ``preset`` to start from; ``kind``, where given, must be
                this sensor's.
            overrides: fields that replace those of the preset or the file.

        Raises:
            ValueError: an unknown preset, field or value.
            TorchweatherError: a file that is missing or broken, or a field in it that is wrong; a package that is.

        Example:
            >>> from torchweather.sensors import Camera
            >>> Camera.preset("lucid-triton").width
            1936
        """
        if str(name).lower().endswith(SENSOR_FILES):
            return cls._from_file(Path(name), overrides)
        known = _preset_texts()[cls.kind]
        check_one_of("preset", name, _preset_names(cls.kind), owner=cls)
        plugin = find_plugin("sensors", f"{cls.kind}.{name}", [f"{cls.kind}.{one}" for one in known])
        if plugin is not None:
            return cls._of_a_package(plugin, overrides)
        values = {key: value for key, value in _preset(cls.kind, name).items() if key != "source"}
        return cls.from_dict({**values, **overrides})

    @classmethod
    def presets(cls) -> dict[str, str]:
        """Names of the library's presets and where their numbers come from."""
        return {name: str(_preset(cls.kind, name).get("source", "")) for name in _preset_texts()[cls.kind]}

    @classmethod
    def from_dict(cls, values: Mapping[str, Any]) -> Self:
        """Build the sensor from plain values; unknown keys are refused with the nearest name."""
        check_arguments(f"{cls.__name__}.from_dict(values: Mapping)", values)
        known = [field.name for field in fields(cls)]  # type: ignore[arg-type]
        needed = [field.name for field in fields(cls) if field.default is field.default_factory is MISSING]  # type: ignore[arg-type]
        if missing := [name for name in needed if name not in values]:
            raise InputTypeError(f"{cls.__name__}: needs {', '.join(needed)}; missing {', '.join(missing)}.")
        for key in values:
            if key not in known:
                raise InputValueError(f"{cls.__name__}: unknown field {key!r}.{nearest_name(key, known)}")
        return cls(**values)

    @classmethod
    def from_values(cls, values: Mapping[str, Any]) -> Self:
        """The sensor of a recipe's plain values: ``kind``, and a ``preset`` with fields replaced, or all fields."""
        given = dict(values)
        kind, preset = given.pop("kind", None), given.pop("preset", None)
        if kind != cls.kind:
            raise InputValueError(f"sensor.kind must be {cls.kind}; got {kind!r}.")
        # A list of YAML stands for a tuple of the dataclass.
        given = {key: tuple(value) if isinstance(value, list) else value for key, value in given.items()}
        given = with_distributions(given, owner=cls.__name__)
        return cls.from_dict(given) if preset is None else cls.preset(str(preset), **given)

    @classmethod
    def _of_a_package(cls, plugin: Plugin, overrides: Mapping[str, Any]) -> Self:
        """The sensor of the plain values that a package holds; errors name the package."""
        values = plugin.load()
        if not isinstance(values, Mapping):
            raise plugin.error(
                f"is no preset: expected a mapping of the fields of a {cls.kind}, of source and perhaps of a preset "
                f"to start from; got {type(values).__name__}."
            )
        given = {"kind": cls.kind, **{key: value for key, value in values.items() if key != "source"}}
        try:
            if "preset" in given:
                check_one_of("preset", given["preset"], _preset_texts()[cls.kind], owner=cls)
            built = cls.from_values(given)
        except (ValueError, TypeError) as error:
            raise plugin.error(f"is no {cls.kind}: {error}") from error
        return cls.from_values({**given, **overrides}) if overrides else built

    @classmethod
    def _from_file(cls, path: Path, overrides: Mapping[str, Any]) -> Self:
        """The sensor of a YAML file; errors carry the path and the field."""
        values = read_yaml(path, f"the fields of a {cls.kind}")
        if isinstance(values, dict) and list(values) == [cls.kind]:  # one section, named by the kind
            values = values[cls.kind]
        keys = {"kind": one_of([cls.kind]), "preset": one_of(_preset_names(cls.kind)), "source": ANY, **field_keys(cls)}
        for key in values if isinstance(values, dict) else ():
            if key not in keys and not nearest_name(key, keys):
                raise TorchweatherError(
                    f"{path}: unknown key {key!r}: no field of a {cls.kind}. A calibration of OpenCV or ROS is read by "
                    "--camera FILE."
                )
        check_keys(values, keys, str(path))
        given = {key: value for key, value in values.items() if key not in _OTHER_KEYS}
        given = with_distributions(given, owner=str(path)) | dict(overrides)
        preset = values.get("preset")
        required = [field.name for field in fields(cls) if field.default is field.default_factory is MISSING]  # type: ignore[arg-type]
        missing = [name for name in required if name not in given]
        if preset is None and missing:
            raise TorchweatherError(
                f"{path}: a {cls.kind} needs {', '.join(required)}; missing {', '.join(missing)}. Add them, or name a "
                "preset to start from."
            )
        try:
            return cls.from_dict(given) if preset is None else cls.preset(preset, **given)
        except (ValueError, TypeError) as error:
            raise TorchweatherError(f"{path}: {error}") from error

    def to_dict(self, *, without: Collection[str] = ()) -> dict[str, Any]:
        """Plain values that ``from_dict`` takes and YAML can hold; the fields in ``without`` are None."""
        names = [field.name for field in fields(self)]  # type: ignore[arg-type]
        return {name: None if name in without else _plain(getattr(self, name)) for name in names}


def _plain(value: Any) -> Any:
    """Tuples and tensors as lists, distributions as mappings."""
    if isinstance(value, tuple):
        return [_plain(item) for item in value] if value and isinstance(value[0], (tuple, Tensor)) else [*value]
    if isinstance(value, Distribution):
        return value.to_dict()
    return value.tolist() if isinstance(value, Tensor) else value
