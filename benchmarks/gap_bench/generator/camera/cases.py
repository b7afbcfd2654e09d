"""Plans of the camera's bench: which studies a set holds, and how each is made from its seed."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import numpy as np

from torchweather.gap.study.study import Study

from ...bars import other_bars
from ...sealed import read_json, stored
from ..bench_sensor import BenchSensor
from ..planning import Case, Row, cases_of, label_key, null_rows, screen_rows
from .decoys import DECOYS
from .design import Design, Size, draw_design, study_of, with_record
from .detectability import STRENGTHS, Detector, Table, confusable
from .effects import CATALOGUE
from .outside import KINDS, OUTSIDE

__all__ = ["GROUPS", "SENSOR", "Case", "Places", "build", "plan"]

WEATHERS = ("rain", "fog", "snow")
LEVELS = (5.0, 10.0, 30.0)
SECONDS = 120.0
FLOORS = 1.2


class Places:
    """Streets of a set and what effects do there, made when they are first asked for.

    Args:
        seed: of the set.
        few: leaves out what confusions need.
    """

    def __init__(self, seed: tuple[int, ...], few: bool) -> None:
        self.seed, self.few = seed, few
        self._designs: dict[tuple[str, Size], Design] = {}
        self._detectors: dict[tuple[str, Size], Detector] = {}
        self._tables: dict[tuple[str, Size, str], Table] = {}
        self._strengths: dict[tuple[str, Size, str, float], float | None] = {}

    def design(self, weather: str, size: Size) -> Design:
        """The streets of a weather."""
        grid = Size(width=size.width, height=size.height)
        key = (weather, grid)
        if key not in self._designs:
            rng = np.random.default_rng([*self.seed, WEATHERS.index(weather), size.width])
            self._designs[key] = draw_design(rng, weather, grid)
        return self._designs[key]

    def table(self, weather: str, size: Size, name: str) -> tuple[Detector, Table]:
        """What an effect does there, and what tells it."""
        design = self.design(weather, size)
        key = (weather, design.size)
        if key not in self._detectors:
            self._detectors[key] = Detector(design, 7 + WEATHERS.index(weather))
        if (*key, name) not in self._tables:
            self._tables[*key, name] = self._detectors[key].table(name)
        return self._detectors[key], self._tables[*key, name]

    def strength(self, weather: str, size: Size, name: str, level: float) -> float | None:
        """Strength of an effect at a d'; ``None`` where none has it."""
        if weather not in KINDS[name].weathers:
            return None
        if KINDS[name].given is not None:
            return KINDS[name].given
        key = (weather, self.design(weather, size).size, name, level)
        if key not in self._strengths:
            detector, table = self.table(weather, size, name)
            self._strengths[key] = detector.strength_for(table, level)
        return self._strengths[key]

    def confused(self, weather: str, size: Size, name: str, strength: float) -> dict[str, float] | None:
        """With what an effect can be confused there (``None``: not looked at)."""
        if self.few or name not in CATALOGUE:
            return None
        tables = [self.table(weather, size, other)[1] for other in CATALOGUE if weather in KINDS[other].weathers]
        return confusable(tables, name, strength)


def _weather_for(name: str, number: int) -> str:
    shown = KINDS[name].weathers
    return shown[number % len(shown)]


def _singles(seed: int) -> Iterator[Row]:
    """Every effect at every level, and some once more in another weather."""
    for number, level in enumerate(LEVELS):
        for place, name in enumerate(CATALOGUE):
            yield _weather_for(name, place + number + seed), (name,), (level,), None, {}
    for place, name in enumerate(("camera.exposure_gain", "camera.defocus", "camera.streak_contrast")):
        yield _weather_for(name, place + seed + 1), (name,), (30.0,), None, {}


PAIRS = (
    *(("fog", "exposure_gain", "sensor_noise"), ("fog", "extinction_scale", "defocus")),
    *(("rain", "streak_contrast", "vignetting"), ("rain", "wet_surface", "ego_blur")),
    *(("snow", "particle_count", "tone_curve"), ("snow", "wind_slant", "stray_light")),
    *(("fog", "airlight_scale", "exposure_gain"), ("rain", "streak_contrast", "particle_count")),
)
MORE_PAIRS = (
    *(("fog", "height_fog", "vignetting"), ("fog", "airlight_scale", "sensor_noise")),
    *(("fog", "stray_light", "ego_blur"), ("fog", "patchy_fog", "saturation")),
    *(("fog", "extinction_scale", "wet_surface"), ("fog", "tone_curve", "adherent_drops")),
    *(("rain", "exposure_gain", "defocus"), ("rain", "wind_slant", "sensor_noise")),
    *(("rain", "stray_light", "streak_contrast"), ("rain", "saturation", "particle_count")),
    *(("rain", "vignetting", "ego_blur"), ("snow", "airlight_scale", "wind_slant")),
    *(("snow", "wet_surface", "particle_count"), ("snow", "exposure_gain", "sensor_noise")),
    *(("fog", "defocus", "ego_blur"), ("fog", "tone_curve", "stray_light")),
)
PAIR_LEVELS = ((30.0, 30.0), (30.0, 10.0), (10.0, 10.0))


def _pairs(seed: int) -> Iterator[Row]:
    """Two effects; the last two pairs of either list are nearly degenerate."""
    for weather, first, second in PAIRS:
        yield weather, (f"camera.{first}", f"camera.{second}"), (30.0, 30.0), None, {}
    for number, (weather, first, second) in enumerate(MORE_PAIRS):
        yield weather, (f"camera.{first}", f"camera.{second}"), PAIR_LEVELS[number % len(PAIR_LEVELS)], None, {}


TRIPLES = (
    *(("fog", "exposure_gain", "sensor_noise", "height_fog"), ("fog", "extinction_scale", "defocus", "vignetting")),
    *(("fog", "airlight_scale", "wet_surface", "ego_blur"), ("fog", "stray_light", "saturation", "adherent_drops")),
    *(("rain", "streak_contrast", "vignetting", "sensor_noise"), ("rain", "wind_slant", "exposure_gain", "defocus")),
    *(("rain", "wet_surface", "ego_blur", "particle_count"), ("rain", "stray_light", "adherent_drops", "wind_slant")),
    *(("snow", "tone_curve", "wind_slant", "sensor_noise"), ("snow", "particle_count", "exposure_gain", "ego_blur")),
    *(("snow", "streak_contrast", "wet_surface", "defocus"), ("snow", "airlight_scale", "vignetting", "saturation")),
)


def _triples(seed: int) -> Iterator[Row]:
    for weather, *names in TRIPLES:
        yield weather, tuple(f"camera.{name}" for name in names), (30.0, 30.0, 30.0), None, {}


def _outside(seed: int) -> Iterator[Row]:
    """Each kind in two weathers."""
    for turn in range(2):
        for number, name in enumerate(OUTSIDE):
            yield WEATHERS[(number + turn + seed) % 3], (name,), (30.0,), None, {}


def _decoys(seed: int) -> Iterator[Row]:
    for number, name in enumerate((*DECOYS, *DECOYS)):
        yield WEATHERS[(number + number // len(DECOYS) + seed) % 3], (), (), None, {"decoy": name}


def _reduced(seed: int) -> Iterator[Row]:
    """Eight studies for continuous integration."""
    yield "fog", ("camera.exposure_gain",), (30.0,), None, {}
    yield "fog", ("camera.height_fog",), (30.0,), None, {}
    yield "fog", ("camera.sensor_noise",), (30.0,), None, {}
    yield "fog", ("camera.tone_curve",), (30.0,), None, {}
    yield "fog", ("camera.airlight_scale",), (30.0,), None, {}
    yield "fog", (), (), None, {}
    yield "fog", (), (), None, {"record_sd": 2.0}
    yield "fog", ("outside.flicker",), (30.0,), None, {}


GROUPS: dict[str, Callable[[int], Iterator[Row]]] = {
    "singles": _singles,
    "nulls": lambda seed: null_rows(WEATHERS, Size(clear_frames=2, frames=2)),
    "pairs": _pairs,
    "triples": _triples,
    "outside": _outside,
    "decoys": _decoys,
    "screen": lambda seed: screen_rows(WEATHERS, Size().smaller()),
    "reduced": _reduced,
}


def plan(set_name: str, seed: int, groups: Sequence[str], size: Size) -> Iterator[Case]:
    """The cases of some groups, in an order that does not depend on which groups there are."""

    def sized(stated: Size | None) -> Size:
        return size if stated is None else replace(stated, width=size.width, height=size.height)

    return cases_of(GROUPS, groups, set_name, seed, sized, "camera-")


def build(case: Case, places: Places, before: dict[str, Any] | None = None) -> tuple[Study, dict[str, Any]]:
    """The study of a case, and its truth; ``before`` is that truth, where it was made before."""
    rng = np.random.default_rng(list(case.seed))
    weather, hidden = _hidden(case, places) if before is None else (before["weather"], before["effects"])
    streets = replace(places.design(weather, case.size), size=case.size)
    design = with_record(streets, rng, record_sd=case.options.get("record_sd"))
    truth: dict[str, Any] = {**asdict(case), "weather": weather, "record": design.record, "effects": hidden}
    effects = tuple(KINDS[one["name"]]({k: float(v) for k, v in one["parameters"].items()}) for one in hidden)
    if "decoy" in case.options:
        decoy = DECOYS[case.options["decoy"]](design, rng)
        truth["right"] = {"verdicts": decoy.verdicts, "names": decoy.names}
        study = study_of(
            design,
            decoy.effects,
            rng,
            clear_effects=decoy.clear_effects,
            acts=decoy.acts,
            seen=decoy.seen,
            repeated=decoy.repeated,
        )
    else:
        study = study_of(design, effects, rng)
    truth["conditions"] = [
        {"id": one.id, "recorded": one.recorded, "true": one.weather.amount, "split": one.split}
        for one in design.conditions
    ]
    return study, truth


def _hidden(case: Case, places: Places) -> tuple[str, list[dict[str, Any]]]:
    """The weather of a case, and what the truth says of each of its effects."""
    weather, levels, strengths = _where_it_shows(case, places)
    found = []
    for name, level, strength in zip(case.names, levels, strengths, strict=True):
        confused = places.confused(weather, case.size, name, strength)
        found.append(
            {
                "name": name,
                "parameters": KINDS[name].at(strength).parameters,
                "same_form": KINDS[name].same_form,
                "level": level,
                "confusable_with": confused,
                "identifiable": None if confused is None else not confused,
                "axes": KINDS[name].shows_along if name in OUTSIDE else None,
            }
        )
    return weather, found


def _where_it_shows(case: Case, places: Places) -> tuple[str, tuple[float, ...], tuple[float, ...]]:
    """A weather in which the effects reach their levels, or weaker or stronger ones: it, the levels, the strengths.

    A single effect that no street shows at any level is hidden at its strongest, at the d' that it has there.
    """
    last = len(LEVELS) - 1
    turned = [WEATHERS[(WEATHERS.index(case.weather) + turn) % 3] for turn in range(3)]
    for weaker in (0, 1, 2, -1, -2):
        levels = tuple(LEVELS[min(max(0, LEVELS.index(level) - weaker), last)] for level in case.levels)
        for weather in turned:
            found = [
                places.strength(weather, case.size, name, level) for name, level in zip(case.names, levels, strict=True)
            ]
            if None not in found:
                return weather, levels, tuple(one for one in found if one is not None)
    if len(case.names) > 1:
        raise ValueError(f"{case.id}: no street shows {', '.join(case.names)} at any level.")
    weather = next(weather for weather in turned if weather in KINDS[case.names[0]].weathers)
    strongest = float(places.table(weather, case.size, case.names[0])[1].lengths[-1])
    return weather, (round(max(strongest, 0.0), 1),), (STRENGTHS[-1],)


def _cases(set_name: str, seed: int, groups: Sequence[str], small: bool) -> list[Case]:
    return list(plan(set_name, seed, groups, Size().smaller() if small else Size()))


def _builder(
    set_name: str, seed: int, sealed: Path, cases: Sequence[Case], few: bool
) -> Callable[[Case], tuple[Study, dict[str, Any]]]:
    """What builds the cases, those that were made before from the sealed truth."""
    places = Places((label_key(set_name), seed), few)
    path = sealed / "truth.json"
    truths = read_json(path) if stored(path) is not None else {}
    return lambda case: build(case, places, truths.get(case.id))


SENSOR = BenchSensor(
    groups=tuple(GROUPS),
    usual=("singles", "nulls", "pairs", "triples", "outside", "decoys"),
    plan=_cases,
    builder=_builder,
    bars=other_bars(SECONDS),
    floors=FLOORS,
)
