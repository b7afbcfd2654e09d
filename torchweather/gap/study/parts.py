"""The parts of a study out of plain values, each checked; the same for values of a file and of a call."""

from __future__ import annotations

import itertools
import math
import numbers
import reprlib
from collections.abc import Iterable, Mapping, Sequence
from functools import partial
from typing import Any, NamedTuple

import numpy as np
from torch import Tensor

from torchweather.atmosphere.weather import Fog, Rain, Snow, Weather, parse_weather, weather_from_dict
from torchweather.camera.airlight import airlight_argument
from torchweather.core.errors import TorchweatherError, nearest_name
from torchweather.core.schema import ANY, Key, check_keys, check_value, one_of, refuse_unknown
from torchweather.gap.sensors.all import KINDS
from torchweather.gap.study.checks import FrameRule
from torchweather.gap.study.conditions import Condition, StudyScene, StudySensor
from torchweather.gap.study.frames import Frame, Frames, FrameSource, load
from torchweather.gap.study.kinds import StudyKind
from torchweather.gap.study.splits import SPLITS, resolve_splits

__all__ = ["CLEAR", "WEATHERS", "Parts", "build_parts"]

# The name of a weather's intensity, and the relative standard deviation of its record.
WEATHERS: dict[str, tuple[str, str]] = {
    Rain.kind: (Rain.intensity_name, "rate_rel_sd"),
    Snow.kind: (Snow.intensity_name, "rate_rel_sd"),
    Fog.kind: (Fog.intensity_name, "mor_rel_sd"),
}
CLEAR = "clear"
WEATHER_KIND = one_of((*WEATHERS, CLEAR))
ID = Key("text, such as 's0' (numbers in quotes)", lambda value: isinstance(value, str) and bool(value))
SCENE_KEYS = ("id", "clear", "geometry")
CONDITION_KEYS = (
    *("id", "scene", "weather", "rel_sd", "frames", "time_s", "split"),
    *("ego_speed_m_per_s", "exposure_s", "airlight", "exposure_gain"),
)
# Guards against another unit. A record that is off by its own value says nothing; 10 % is 0.1.
MOST_REL_SD = 1.0
FASTEST_M_PER_S = 150.0  # 540 km/h
MOST_GAIN = 1000.0  # ten stops
LONGEST_EXPOSURE_S = 10.0

Values = Mapping[str, Any]


class Parts(NamedTuple):
    """Parts of a study."""

    beams: Frame
    scenes: dict[str, StudyScene]
    conditions: tuple[Condition, ...]
    links: Frame


def build_parts(
    name: str,
    sensor: StudySensor | None,
    given: Mapping[str, FrameSource | None],
    scenes: Any,
    conditions: Any,
    owner: str,
) -> Parts:
    """Build scenes and conditions and check them.

    Args:
        name: of the kind.
        sensor: of that kind.
        given: ``beams`` and ``links``, ``None`` where there are none.
        scenes, conditions: rows.
        owner: a file or a function, in front of each message.
    """
    kind = KINDS[name]
    held: dict[str, Frame] = {part: {} for part in given}
    frame_rule = FrameRule(kind.arrays["frame"], *kind.sizes(sensor, owner), partial(kind.check_frame, sensor))
    if kind.shared:
        source, arrays = given[kind.shared], kind.arrays[kind.shared]
        if source is None:
            raise TorchweatherError(f"{owner}: {kind.shared} is missing: {kind.shared_wanted}.")
        held[kind.shared] = dict(load(source, f"{owner}: {kind.shared}", FrameRule(arrays)))
        frame_rule = frame_rule.sized_by(arrays, held[kind.shared], f"the {kind.shared}")
    for part in given:
        if given[part] is not None and part != kind.shared:
            belongs = next(one.name for one in KINDS.values() if one.shared == part)
            raise TorchweatherError(f"{owner}: {part} belongs to a study of kind {belongs}; this one is {name}.")
    built = _scenes(scenes, kind, frame_rule, owner)
    return Parts(held["beams"], built, _conditions(conditions, kind, built, frame_rule, owner), held["links"])


# ---- scenes and conditions -------------------------------------------------------------------------------------------


def _scenes(values: Any, kind: StudyKind, frame_rule: FrameRule, owner: str) -> dict[str, StudyScene]:
    rows = _rows(values, "scenes", SCENE_KEYS, owner)
    if not kind.has_scenes:
        if rows:
            raise TorchweatherError(f"{owner}: scenes: links have no clear frames (dry samples are the clear set).")
        return {}
    if not rows:
        raise TorchweatherError(f"{owner}: scenes must hold at least one scene with clear frames; got none.")
    arrays, built = kind.arrays["geometry"], dict[str, StudyScene]()
    needed = [name for name, rule in arrays.items() if rule.required]
    for key, row in rows.items():
        name = _name(row, key, built, owner)
        given = row.get("geometry")
        if given is None and needed:
            raise TorchweatherError(
                f"{owner}: {key}.geometry is missing: a {kind.name} study needs {', '.join(needed)} of each scene."
            )
        geometry: Frame = {}
        if given is not None:
            rule = FrameRule(arrays, frame_rule.sizes, frame_rule.sizes_from)
            geometry = load(given, f"{owner}: {key}.geometry", rule)
        built[name] = StudyScene(
            id=name,
            clear=_frames(row, "clear", key, _scene_rule(kind, frame_rule, name, geometry), owner),
            geometry=geometry,
        )
    return built


def _conditions(
    values: Any, kind: StudyKind, scenes: Mapping[str, StudyScene], frame_rule: FrameRule, owner: str
) -> tuple[Condition, ...]:
    rows = _rows(values, "conditions", CONDITION_KEYS, owner)
    if not rows:
        raise TorchweatherError(f"{owner}: conditions must hold at least one condition with frames; got none.")
    built: dict[str, Condition] = {}
    for key, row in rows.items():
        name = _name(row, key, built, owner)
        rule = frame_rule
        if kind.has_scenes:
            check_value(row.get("scene"), one_of(scenes), owner, f"{key}.scene")
            rule = _scene_rule(kind, frame_rule, row["scene"], scenes[row["scene"]].geometry)
        weather, rel_sd = _weather(row, kind, key, owner)
        frames = _frames(row, "frames", key, rule, owner)
        split = row.get("split")
        if split not in (*SPLITS, None):
            raise TorchweatherError(
                f"{owner}: {key}.split must be fit or holdout; got {_shown(split)}.{nearest_name(split, SPLITS)} Leave "
                "it out to have the conditions split."
            )
        built[name] = Condition(
            id=name,
            scene=row["scene"] if kind.has_scenes else "",
            weather=weather,
            frames=frames,
            rel_sd=rel_sd,
            time_s=_times(row.get("time_s"), len(frames), f"{owner}: {key}.time_s"),
            split=split or "",
            ego_speed_m_per_s=_optional(row, "ego_speed_m_per_s", key, FASTEST_M_PER_S, "m/s", owner),
            exposure_s=_optional(row, "exposure_s", key, LONGEST_EXPOSURE_S, "s", owner),
            airlight=_airlight(row, kind, key, owner),
            exposure_gain=_exposure_gain(row, kind, key, owner),
        )
    return resolve_splits(tuple(built.values()))


def _airlight(row: Values, kind: StudyKind, key: str, owner: str) -> tuple[float, float, float] | None:
    """The measured airlight of a camera's condition, red, green, blue."""
    given = row.get("airlight")
    if given is None:
        return None
    _check_of_camera("airlight", kind, key, owner)
    try:
        found = airlight_argument(given, f"{key}")
    except (TypeError, ValueError) as error:
        raise TorchweatherError(f"{owner}: {key}.airlight: {error}") from error
    if isinstance(found, str):
        raise TorchweatherError(
            f"{owner}: {key}.airlight must be a number or (red, green, blue) in 0..1, linear, as measured; got "
            f"{found!r}."
        )
    return found


def _exposure_gain(row: Values, kind: StudyKind, key: str, owner: str) -> float | None:
    """The measured exposure gain of a camera's condition."""
    found = _optional(row, "exposure_gain", key, MOST_GAIN, "", owner)
    if found is None:
        return None
    _check_of_camera("exposure_gain", kind, key, owner)
    if found <= 0:
        raise TorchweatherError(
            f"{owner}: {key}.exposure_gain must be above 0, the signal of these frames over that of clear ones; got "
            f"{found:g}."
        )
    return found


def _check_of_camera(what: str, kind: StudyKind, key: str, owner: str) -> None:
    if not kind.has_airlight:
        raise TorchweatherError(
            f"{owner}: {key}.{what} belongs to a camera; the study is of a {kind.name}. Leave it out."
        )


def _scene_rule(kind: StudyKind, rule: FrameRule, scene: str, geometry: Frame) -> FrameRule:
    """The rule of a scene's frames: a radar has as many targets as the scene's geometry says."""
    return rule.sized_by(kind.arrays["geometry"], geometry, f"the geometry of scene {scene}")


def _frames(row: Values, what: str, key: str, rule: FrameRule, owner: str) -> Frames:
    given = row.get(what)
    if isinstance(given, (str, bytes, Mapping)) or not isinstance(given, (Sequence, Iterable)):
        raise TorchweatherError(f"{owner}: {key}.{what} must be a list of frames; got {_shown(given)}.")
    frames = Frames(given, rule, f"{owner}: {key}.{what}")
    if not len(frames):
        raise TorchweatherError(f"{owner}: {key}.{what} must hold at least one frame; got none.")
    return frames


def _rows(values: Any, what: str, keys: Sequence[str], owner: str) -> dict[str, Values]:
    """Entries of a list by the name under which messages know them."""
    if not isinstance(values, (list, tuple)):
        raise TorchweatherError(f"{owner}: {what} must be a list of entries with keys; got {_shown(values)}.")
    rows = {f"{what}[{place}]": row for place, row in enumerate(values)}
    for key, row in rows.items():
        check_keys(row, dict.fromkeys(keys, ANY), owner, key)
    return rows


def _name(row: Values, key: str, known: Mapping[str, Any], owner: str) -> str:
    check_value(row.get("id"), ID, owner, f"{key}.id")
    name: str = row["id"]
    if name in known:
        raise TorchweatherError(f"{owner}: {key}.id must differ from the others; {name!r} stands twice.")
    return name


# ---- values ----------------------------------------------------------------------------------------------------------


def _weather(row: Values, kind: StudyKind, key: str, owner: str) -> tuple[Weather | None, float]:
    """The weather of a condition and the relative standard deviation of its record."""
    given, where = row.get("weather"), f"{key}.weather"
    rel_sd = _number(row.get("rel_sd", 0.0), f"{owner}: {key}.rel_sd", 0.0, MOST_REL_SD, "")
    if given == CLEAR or (given is None and (kind.rel_sd_key or "weather" in row)):
        return None, rel_sd if kind.rel_sd_key else 0.0
    if isinstance(given, Mapping):
        given = dict(given)
        name = given.get("kind")
        if name == CLEAR:
            refuse_unknown(given, ("kind",), where, owner)
            return None, 0.0
        check_value(name, WEATHER_KIND, owner, f"{where}.kind")
        key, spread = WEATHERS[str(name)]
        if key not in given:
            raise TorchweatherError(
                f"{owner}: {where}.{key} is missing: {name} needs it.{nearest_name(key, map(str, given))}"
            )
        _number(given[key], f"{owner}: {where}.{key}", 0.0, math.inf, "")
        rel_sd = _number(given.pop(spread, rel_sd), f"{owner}: {where}.{spread}", 0.0, MOST_REL_SD, "")
    if given is None:
        raise TorchweatherError(
            f"{owner}: {where} is missing: expected kind rain, fog or snow with its rate_mm_per_h or mor_m, or clear."
        )
    try:
        if isinstance(given, Mapping):
            weather = weather_from_dict(given)
        else:
            weather = parse_weather(given) if isinstance(given, str) else given
    except (TypeError, ValueError, KeyError) as error:
        raise TorchweatherError(f"{owner}: {where}: {error}") from error
    if not isinstance(weather, Weather):
        raise TorchweatherError(
            f"{owner}: {where} must be a weather such as Rain(25.0), 'rain:rate=25' or 'clear'; got {_shown(weather)}."
        )
    check_value(weather.kind, WEATHER_KIND, owner, f"{where}.kind")
    if isinstance(weather.intensity, Tensor):
        raise TorchweatherError(f"{owner}: {where}: {weather.intensity_name} must be one number; got a tensor.")
    return weather, rel_sd


def _times(values: Any, frames: int, name: str) -> np.ndarray[Any, np.dtype[np.float64]] | None:
    if values is None:
        return None
    if isinstance(values, (str, Mapping)) or not hasattr(values, "__len__"):
        raise TorchweatherError(f"{name} must be a list of seconds, one for each frame; got {_shown(values)}.")
    if len(values) != frames:
        raise TorchweatherError(
            f"{name} must have one value in seconds for each of the {frames} frames; got {len(values)}."
        )
    found = [_number(value, f"{name}[{k}]", -math.inf, math.inf, "s") for k, value in enumerate(values)]
    for place, (before, after) in enumerate(itertools.pairwise(found), 1):
        if after < before:
            raise TorchweatherError(
                f"{name} must not fall from frame to frame, s; got {after:g} at {place} after {before:g}. Sort the "
                "frames by time."
            )
    return np.array(found, dtype=np.float64)


def _optional(row: Values, what: str, key: str, most: float, unit: str, owner: str) -> float | None:
    value = row.get(what)
    if value is None:
        return None
    return _number(value, f"{owner}: {key}.{what}", 0.0, most, unit)


def _number(value: Any, name: str, low: float, high: float, unit: str) -> float:
    if isinstance(value, bool) or not isinstance(value, numbers.Real):
        advice = ""
        if isinstance(value, str):
            advice = " It is text: YAML wants 1.0e-3 for 1e-3, .inf for infinity, and no unit."
        raise TorchweatherError(f"{name} must be a number{' in ' + unit if unit else ''}; got {_shown(value)}.{advice}")
    found = float(value)
    infinite = math.isinf(found) and name.endswith(Fog.intensity_name)  # infinite visibility: no fog
    if not low <= found <= high or (math.isinf(found) and not infinite):
        raise TorchweatherError(f"{name} must lie in {low:g}..{high:g}{' ' + unit if unit else ''}; got {found:g}.")
    return found


def _shown(value: Any) -> str:
    return "nothing" if value is None else reprlib.repr(value)
