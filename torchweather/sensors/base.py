"""What the three sensors share: presets, a plain dictionary and back."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import fields
from functools import lru_cache
from importlib import resources
from typing import Any, ClassVar, Self

import yaml
from torch import Tensor

from torchweather.errors import check_one_of, nearest_name

__all__ = ["Sensor"]

SENSOR_KINDS = ("camera", "lidar", "radar")


@lru_cache(maxsize=1)
def _presets() -> dict[str, dict[str, dict[str, Any]]]:
    text = resources.files("torchweather").joinpath("presets", "sensors.yaml").read_text(encoding="utf-8")
    loaded = yaml.safe_load(text)
    return {kind: dict(loaded[kind]) for kind in SENSOR_KINDS}


class Sensor:
    """What the three sensors share: presets, a plain dictionary and back."""

    kind: ClassVar[str] = ""

    @classmethod
    def preset(cls, name: str, **overrides: Any) -> Self:
        """The named sensor of the library, with any field replaced.

        Example:
            >>> from torchweather.sensors import Camera
            >>> Camera.preset("lucid-triton").width
            1936
        """
        known = _presets()[cls.kind]
        check_one_of("preset", name, known, owner=cls)
        values = {key: value for key, value in known[name].items() if key != "source"}
        return cls.from_dict({**values, **overrides})

    @classmethod
    def presets(cls) -> dict[str, str]:
        """Names of the presets and where their numbers come from."""
        return {name: str(values.get("source", "")) for name, values in _presets()[cls.kind].items()}

    @classmethod
    def from_dict(cls, values: Mapping[str, Any]) -> Self:
        """Build the sensor from plain values; unknown keys are refused with the nearest name."""
        known = [field.name for field in fields(cls)]  # type: ignore[arg-type]
        for key in values:
            if key not in known:
                raise ValueError(f"{cls.__name__}: unknown field {key!r}.{nearest_name(key, known)}")
        return cls(**values)

    def to_dict(self) -> dict[str, Any]:
        """Plain values that ``from_dict`` takes and YAML can hold."""
        values = {field.name: getattr(self, field.name) for field in fields(self)}  # type: ignore[arg-type]
        return {key: _plain(value) for key, value in values.items()}


def _plain(value: Any) -> Any:
    """Tuples and tensors as lists."""
    if isinstance(value, Tensor):
        return value.tolist()
    return [_plain(item) for item in value] if isinstance(value, tuple) else value
