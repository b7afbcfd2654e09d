"""Plans of the bench: which studies a set holds, and how each is made from its seed."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import numpy as np

from torchweather.gap.study.study import Study

from ...bars import LIDAR_BARS
from ..bench_sensor import BenchSensor
from ..planning import Case, Row, cases_of, label_key, null_rows, screen_rows
from .decoys import DECOYS, STRENGTHS_OF
from .design import Condition, Design, Size, study_of, with_record
from .detectability import KINDS
from .effects import CATALOGUE
from .known import Known
from .lidar_shot import Effect
from .measured_forms import MEASURED, MEASURED_NULLS
from .other_metrics import other_metrics
from .outside import OUTSIDE
from .streets import LEVELS, Street, street

__all__ = ["Case", "GROUPS", "SENSOR", "Streets", "build", "needed_strengths", "plan"]

WEATHERS = ("rain", "fog", "snow")
# Streets of each weather that the cases of a set share; scenes differ between them, records and noise between cases.
STREETS = 2


class Streets:
    """The streets of a set, made when they are first asked for."""

    def __init__(self, set_name: str, seed: int, cache: Path | None, names: tuple[str, ...] | None = None) -> None:
        self.set_name, self.seed, self.cache, self.names = set_name, seed, cache, names
        self._made: dict[tuple[str, int, Size, bool], Street] = {}

    def __call__(self, weather: str, number: int, size: Size) -> Street:
        """One of a weather's streets."""
        return self._street(weather, number, size, self.names)

    def bare(self, weather: str, number: int, size: Size) -> Street:
        """The same street without its table, for studies that need no strength of an effect: made at once."""
        return self._street(weather, number, size, ())

    def _street(self, weather: str, number: int, size: Size, names: tuple[str, ...] | None) -> Street:
        grid = Size(rings=size.rings, columns=size.columns)  # less data, same places
        which = (weather, number % STREETS, grid, names == ())
        if which not in self._made:
            key = [label_key(self.set_name), self.seed, which[1], grid.columns, WEATHERS.index(weather)]
            self._made[which] = street(key, weather, grid, self.cache, names)
        return self._made[which]


def plan(set_name: str, seed: int, groups: Sequence[str], size: Size) -> Iterator[Case]:
    """The cases of some groups, in an order that does not depend on which groups there are.

    Args:
        set_name: ``dev...`` or ``blind...``; with the seed it fixes all draws.
        seed: of the set.
        groups: of `GROUPS`.
        size: amount of data of a full study.
    """
    return cases_of(GROUPS, groups, set_name, seed, lambda stated: stated or size)


def _singles(seed: int) -> Iterator[Row]:
    """Every effect at every level, the weathers in turn."""
    for level_number, level in enumerate(LEVELS):
        for number, name in enumerate(CATALOGUE):
            yield WEATHERS[(number + level_number + seed) % 3], (name,), (level,), None, {}


def _pairs(seed: int) -> Iterator[Row]:
    """Two effects; the last four pairs are nearly degenerate."""
    for number, (first, second) in enumerate(PAIRS):
        levels = ((10.0, 10.0), (30.0, 10.0), (30.0, 30.0))[number % 3]
        yield WEATHERS[(number + seed) % 3], (f"lidar.{first}", f"lidar.{second}"), levels, None, {}


PAIRS = (
    *(("window_loss", "range_noise"), ("extinction_scale", "crosstalk"), ("threshold_shift", "range_bias")),
    *(("sector_loss", "particle_backscatter"), ("ring_gain", "spray"), ("wet_target", "range_stretch")),
    *(("blind_zone", "range_noise"), ("static_structure", "window_loss"), ("intensity_compression", "crosstalk")),
    *(("isolated_return_filter", "extinction_scale"), ("sector_loss", "range_bias"), ("spray", "threshold_shift")),
    *(("beam_divergence", "particle_backscatter"), ("window_loss", "wet_target")),
    *(("extinction_scale", "limited_extent"), ("range_noise", "range_stretch")),
)


def _triples(seed: int) -> Iterator[Row]:
    for number, names in enumerate(TRIPLES):
        named = tuple(f"lidar.{name}" for name in names)
        yield WEATHERS[(number + seed) % 3], named, (30.0, 30.0, 30.0), None, {}


TRIPLES = (
    *(("window_loss", "range_noise", "crosstalk"), ("extinction_scale", "range_bias", "sector_loss")),
    *(("threshold_shift", "spray", "ring_gain"), ("particle_backscatter", "wet_target", "range_noise")),
    *(("isolated_return_filter", "static_structure", "range_bias"), ("blind_zone", "intensity_compression", "spray")),
)


def _outside(seed: int) -> Iterator[Row]:
    for number, name in enumerate(OUTSIDE):
        yield WEATHERS[(number + seed) % 3], (name,), ((30.0,), (10.0,))[(number + seed) % 2], None, {}


def _decoys(seed: int) -> Iterator[Row]:
    for number, name in enumerate((*DECOYS, *DECOYS)):
        yield WEATHERS[(number + number // len(DECOYS) + seed) % 3], (), (), None, {"decoy": name}


def _measured(seed: int) -> Iterator[Row]:
    """Forms that were measured, in snow, each at every level; and twice what clear frames have as well."""
    for level in LEVELS:
        for name in MEASURED:
            yield "snow", (name,), (level,), None, {}
    for number, name in enumerate((*MEASURED_NULLS, *MEASURED_NULLS)):
        yield WEATHERS[(number + seed) % 3], (), (), None, {"decoy": name}


def _moving(seed: int) -> Iterator[Row]:
    """Spray of a vehicle that drives at another speed in each condition."""
    for weather in WEATHERS:
        yield weather, ("lidar.spray",), (30.0,), None, {"moving": True}


def _reduced(seed: int) -> Iterator[Row]:
    """Eight studies for continuous integration."""
    yield "rain", ("lidar.window_loss",), (30.0,), None, {}
    yield "fog", ("lidar.extinction_scale",), (30.0,), None, {}
    yield "snow", ("lidar.range_noise",), (30.0,), None, {}
    yield "snow", ("lidar.particle_backscatter",), (30.0,), None, {}
    yield "rain", (), (), None, {}
    yield "fog", (), (), None, {"record_sd": 2.0}
    yield "rain", ("outside.azimuth_ripple",), (30.0,), None, {}
    yield "snow", (), (), None, {"decoy": "decoy.no_target"}


GROUPS: dict[str, Callable[[int], Iterator[Row]]] = {
    "singles": _singles,
    "nulls": lambda seed: null_rows(WEATHERS, Size(clear_frames=2, rates=3, frames=2)),
    "pairs": _pairs,
    "triples": _triples,
    "outside": _outside,
    "decoys": _decoys,
    "moving": _moving,
    "measured": _measured,
    "screen": lambda seed: screen_rows(WEATHERS, Size().smaller_grid()),
    "reduced": _reduced,
}


def needed_strengths(case: Case) -> set[str]:
    """Effects whose strengths the study needs, from the tables of the streets."""
    return {*case.names, *STRENGTHS_OF.get(case.options.get("decoy", ""), ())}


def build(case: Case, streets: Streets) -> tuple[Study, dict[str, Any]]:
    """The study of a case, and its truth."""
    rng = np.random.default_rng(list(case.seed))
    place, levels = _where_it_shows(case, streets, int(rng.integers(STREETS)))
    design = with_record(replace(place.design, size=case.size), rng, record_sd=case.options.get("record_sd"))
    truth: dict[str, Any] = {**asdict(case), "weather": design.kind, "record": design.record, "effects": []}
    effects: list[Effect] = []
    for name, level in zip(case.names, levels, strict=True):
        effect = KINDS[name](place.parameters(name, level))
        effects.append(effect)
        truth["effects"].append(_effect_truth(place, name, level, effect.parameters))
    if "decoy" in case.options:
        decoy = {**DECOYS, **MEASURED_NULLS}[case.options["decoy"]](design, place.parameters, rng)
        truth["right"] = {"verdicts": decoy.verdicts, "names": decoy.names}
        study = study_of(
            replace(design, views=decoy.clear_views or design.views),
            decoy.effects,
            rng,
            clear_effects=decoy.clear_effects,
            acts=decoy.acts,
            views=decoy.views,
            repeated=decoy.repeated,
        )
    elif case.options.get("moving"):
        design = _driven(design, np.random.default_rng([*case.seed, 1]))
        study = study_of(design, tuple(effects), rng, grown=_with_speed)
        for one in truth["effects"]:  # it has no one strength
            one["parameters"] = {key: value for key, value in one["parameters"].items() if key != "strength"}
    else:
        study = study_of(design, tuple(effects), rng)
    truth["conditions"] = [
        {"id": one.id, "recorded": one.recorded, "true": one.weather.amount, "split": one.split}
        for one in design.conditions
    ]
    return study, truth


# Speeds of a vehicle in rain, m/s, and the one at which spray has its nominal strength (orders of magnitude).
SPEEDS_M_PER_S, NOMINAL_SPEED_M_PER_S = (8.0, 30.0), 20.0


def _driven(design: Design, rng: np.random.Generator) -> Design:
    """The same conditions, at a speed each."""
    speeds = rng.uniform(*SPEEDS_M_PER_S, len(design.conditions))
    driven = [
        replace(one, ego_speed_m_per_s=round(float(speed), 1))
        for one, speed in zip(design.conditions, speeds, strict=True)
    ]
    return replace(design, conditions=tuple(driven))


def _with_speed(effect: Effect, condition: Condition) -> Effect:
    """Spray that grows as the square of the speed, as the energy of the water that the wheels throw."""
    assert isinstance(effect, Known)
    assert condition.ego_speed_m_per_s is not None
    share = (condition.ego_speed_m_per_s / NOMINAL_SPEED_M_PER_S) ** 2
    return replace(effect, parameters={**effect.parameters, effect.swept: effect.value * share})


def _effect_truth(place: Street, name: str, level: float, parameters: dict[str, float]) -> dict[str, Any]:
    confusable = place.confusable(name, level)
    kind = KINDS[name]
    return {
        "name": name,
        "parameters": parameters,
        "same_form": kind.same_form,
        "level": level,
        "reached": place.table[name][f"{level:g}"]["reached"],
        "confusable_with": confusable,
        "identifiable": None if confusable is None else not confusable,
        "axes": kind.shows_along if name in OUTSIDE else None,
    }


def _where_it_shows(case: Case, streets: Streets, number: int) -> tuple[Street, tuple[float, ...]]:
    """A street in which the effects reach their levels: this weather's, another's, or at weaker or stronger levels.

    Some effects come in steps, or their d' rises so steeply that a level cannot be met.
    """
    if not needed_strengths(case):
        return streets.bare(case.weather, number, case.size), ()
    last = len(LEVELS) - 1
    for weaker in (0, 1, 2, -1, -2):
        levels = tuple(LEVELS[min(max(0, LEVELS.index(level) - weaker), last)] for level in case.levels)
        for turn in range(3):
            weather = WEATHERS[(WEATHERS.index(case.weather) + turn) % 3]
            for other in range(STREETS):
                place = streets(weather, number + other, case.size)
                if all(place.has(name, level) for name, level in zip(case.names, levels, strict=True)):
                    return place, levels
    raise ValueError(f"{case.id}: no street shows {', '.join(case.names)} at any level.")


def _cases(set_name: str, seed: int, groups: Sequence[str], small: bool) -> list[Case]:
    return list(plan(set_name, seed, groups, Size().smaller_grid() if small else Size()))


def _builder(
    set_name: str, seed: int, sealed: Path, cases: Sequence[Case], few: bool
) -> Callable[[Case], tuple[Study, dict[str, Any]]]:
    """What builds the cases, with the tables of their streets in the sealed folder."""
    needed = set().union(*(needed_strengths(case) for case in cases))
    streets = Streets(set_name, seed, sealed, tuple(sorted(needed)) if few else None)
    return lambda case: build(case, streets)


SENSOR = BenchSensor(
    groups=tuple(GROUPS),
    usual=("singles", "nulls", "pairs", "triples", "outside", "decoys"),
    plan=_cases,
    builder=_builder,
    bars=LIDAR_BARS,
    floors=1.15,
    other_metrics=other_metrics,
)
