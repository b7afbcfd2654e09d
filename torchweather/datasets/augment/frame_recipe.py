"""A recipe as what it does to the sensors of a frame."""

from __future__ import annotations

import hashlib
import tempfile
from collections import OrderedDict
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from torchweather.compose import Compose
from torchweather.compose.transform_spec import TransformSpec, spec_of
from torchweather.core.errors import InputValueError, TorchweatherError
from torchweather.recipes import load_recipe

__all__ = ["FrameRecipe", "SensorUse", "text_sha256"]

KEPT = 8  # transforms of different cameras: a data set has few


@dataclass(frozen=True, kw_only=True)
class SensorUse:
    """A sensor of a frame, as its file shows it; uses that look alike share a transform.

    Args:
        kind: of the sensor.
        depth: whether a depth map comes with it.
    """

    kind: str
    depth: bool = False

    def changed(self, spec: TransformSpec[Any]) -> TransformSpec[Any]:
        """The recipe's spec as it is for this sensor."""
        return spec


class FrameRecipe:
    """Work of a recipe for any size of image.

    Args:
        recipe: the text of the file, so that every process and machine has the same.
        name: of the file, for messages.

    Example:
        >>> from torchweather.recipes import read_recipe
        >>> FrameRecipe(read_recipe("lidar/os1-fog-50m").path.read_text()).keys
        {'lidar': 'points'}
    """

    def __init__(self, recipe: str, name: str = "the recipe") -> None:
        with tempfile.TemporaryDirectory() as folder:
            file = Path(folder, "recipe.yaml")
            file.write_text(recipe, encoding="utf-8")
            try:
                built = load_recipe(file, kind=("transform", "multi_sensor"))
            except TorchweatherError as error:
                raise TorchweatherError(str(error).replace(str(file), name)) from error
        if not isinstance(built, Compose):
            built = Compose({spec_of(built).sensor.data_key: built})
        self.compose = built
        self.keys: dict[str, str] = {}
        for key, spec in self.compose.specs.items():
            kind = spec.sensor.kind
            if kind in self.keys:
                raise InputValueError(
                    f"augment: expected a recipe with one sensor of a kind; it has two of a {kind}, "
                    f"{self.keys[kind]!r} and {key!r}. All cameras of a data set take the one camera's transform."
                )
            self.keys[kind] = key
        self._built: OrderedDict[str, Compose] = OrderedDict()

    def spec(self, kind: str) -> TransformSpec[Any]:
        """The transform for a kind of sensor."""
        return self.compose.specs[self.keys[kind]]

    def for_sensors(self, uses: Mapping[str, SensorUse]) -> Compose:
        """The recipe for the sensors of a frame, by key; a depth map is wanted as ``<key> depth``."""
        place = repr(sorted(uses.items()))
        if place not in self._built:
            self._built[place] = self._build(uses)
            if len(self._built) > KEPT:
                self._built.popitem(last=False)
        self._built.move_to_end(place)
        return self._built[place]

    def _build(self, uses: Mapping[str, SensorUse]) -> Compose:
        some = next((one for one in self.compose.weather.values if one is not None), None)
        if some is None:
            raise InputValueError("augment: the recipe has no weather, clear air only.")
        return Compose(
            {key: use.changed(self.spec(use.kind)).build(some) for key, use in uses.items()},
            weather=self.compose.weather,
            p=self.compose.p,
            inputs={key: {"depth": f"{key} depth"} for key, use in uses.items() if use.depth},
            mosaic_clear=self.compose.mosaic_clear,
        )


def text_sha256(text: str) -> str:
    """Of the text in UTF-8."""
    return hashlib.sha256(text.encode("utf-8")).hexdigest()
