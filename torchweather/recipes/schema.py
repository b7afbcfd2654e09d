"""One schema of recipes: the keys of each kind, and the plain values of a file compared with them.

A recipe holds ``format: torchweather-recipe/2``, ``title`` (in words), ``kind`` and the keys of its kind:

- ``transform``: a weather on one sensor. ``transform``: ``BayerRain``, ``BayerFog``, ``BayerSnow`` or ``BayerWeather``
  for a camera, ``LidarRain``, ``LidarFog``, ``LidarSnow`` or ``LidarWeather`` for a LiDAR, ``RadarAttenuation`` for a
  radar; ``weather``: ``kind`` and the weather's fields (``parts`` for a mixture); ``sensor``: ``kind``, and a
  ``preset`` or the sensor's fields; fields beside a preset replace the preset's; ``options``: keyword arguments of the
  transform, of which a camera's ``depth`` is a number of metres, ``ground``, or ``auto`` (guessed from the picture);
  what is not known may be ``{uniform: [low, high]}`` and the like, among options, effects and fields of the sensor;
  ``rgb``: true for a camera's RGB images, by ``AsBayer``; ``through_mosaic``: true for RGB images by way of the
  camera's mosaic.
- ``multi_sensor``: one weather on several sensors, or one of several weathers. ``weather``: a weather, or ``choice``,
  a list of weathers (``null`` is clear air), with or without ``weights``; a number may be ``{uniform: [low, high]}``,
  ``{log_uniform: [low, high]}`` or ``{choice: [...]}``; ``transforms``: key of the sample to ``transform``,
  ``sensor``, ``options``, ``rgb`` and ``through_mosaic``; ``p``, ``depth``, ``inputs``, ``mosaic_clear``: those of
  ``Compose``.
- ``suite``: weathers of five severities, for the test of a detector of one sensor. ``sensor``: ``kind``, and a
  ``preset`` or fields where the severities belong to one sensor; without them the data's own sensor is taken;
  ``weathers``: by name, the weather's fields (``kind`` where the name is none), its rate or visibility a list of five,
  lightest first; of a mixture (``parts``) one part or several have a list; ``effects``: by name, an ``effect`` of the
  sensor with a list in the place of one parameter, in clear air; ``severities``: how many, where not five;
  ``options``: as above.
"""

from __future__ import annotations

import warnings
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from torchweather.compose.transform_spec import TRANSFORMS
from torchweather.core.schema import FLAG, MAPPING, SHARE, TEXT, Key, check_format, check_keys, check_value, one_of
from torchweather.core.yaml_file import read_yaml
from torchweather.recipes.files import KINDS

__all__ = ["FORMAT", "OF_A_SENSOR", "SCHEMA", "read_values"]

FORMAT = "torchweather-recipe/2"
# Formats of earlier releases, and the kinds that they stand for; they go with the next release.
OLD_FORMATS = {
    "torchweather-recipe/1": "transform",
    "torchweather-pipeline/1": "multi_sensor",
    "torchweather-suite/1": "suite",
}
FILLED = Key("keys with values", lambda value: isinstance(value, Mapping) and bool(value), required=True)
TITLE = Key("text", lambda value: not isinstance(value, (Mapping, list)), required=True)

OF_A_SENSOR: dict[str, Key] = {
    "transform": one_of(TRANSFORMS).needed,
    "sensor": MAPPING.needed,
    "options": MAPPING.or_null,
    "rgb": FLAG,
    "through_mosaic": FLAG,
}
"""Of a transform: its class, sensor and options."""
SCHEMA: dict[str, dict[str, Key]] = {
    "transform": {"weather": MAPPING.needed, **OF_A_SENSOR},
    "multi_sensor": {
        "weather": MAPPING.needed,
        "transforms": FILLED,
        "p": SHARE,
        "depth": Key("a key of the sample", TEXT.fits),
        "inputs": MAPPING,
        "mosaic_clear": FLAG,
    },
    "suite": {
        "sensor": MAPPING.needed,
        "weathers": MAPPING.or_null,
        "effects": MAPPING.or_null,
        "severities": Key("a whole number from 2 to 10", lambda value: type(value) is int and 2 <= value <= 10),
        "options": MAPPING.or_null,
    },
}
"""By kind: the keys beside ``format``, ``kind`` and ``title``."""


def read_values(path: Path) -> dict[str, Any]:
    """Plain values of a recipe's file, of its kind's keys.

    Raises:
        TorchweatherError: the file is missing or no YAML, or has unknown, missing or wrong keys.
    """
    values, file = read_yaml(path, "a recipe"), str(path)
    old = values.get("format") if isinstance(values, Mapping) else None
    if isinstance(old, str) and old in OLD_FORMATS:
        kind = OLD_FORMATS[old]
        text = f"{file}: format: {old} is {FORMAT} with kind: {kind} now; the old format goes with the next release."
        warnings.warn(text, DeprecationWarning, stacklevel=3)
        values = {**values, "format": FORMAT, "kind": values.get("kind", kind)}
    check_format(values, FORMAT, file, "a recipe")
    check_value(values.get("kind"), one_of(KINDS), file, "kind")
    check_keys(values, {"format": TEXT, "kind": TEXT, "title": TITLE, **SCHEMA[values["kind"]]}, file)
    return dict(values)
