"""Plans of the bench: which studies a set holds, and how each is made from its seed."""

from __future__ import annotations

import zlib
from collections.abc import Iterator
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from torchweather.gap.study import Study

from .design import Size, study_of, with_record
from .effects import CATALOGUE, make_effect
from .lidar_sensor import Effect
from .streets import LEVELS, Street, street

__all__ = ["Case", "GROUPS", "build", "plan"]

WEATHERS = ("rain", "fog", "snow")
# Streets of each weather that the cases of a set share; scenes differ between them, records and noise between cases.
STREETS = 2


@dataclass(frozen=True)
class Case:
    """One study to be made.

    Args:
        id: of its folder; says nothing about what is hidden.
        family: ``single``, ``pair``, ``triple``, ``null``, ``outside`` or ``decoy``.
        weather: ``rain``, ``fog`` or ``snow``.
        names: hidden effects of the catalogue, or of `outside` and `decoys`.
        levels: d' of each.
        size: amount of data.
        seed: from which all draws follow.
        options: what else is special.
    """

    id: str
    family: str
    weather: str
    names: tuple[str, ...]
    levels: tuple[float, ...]
    size: Size
    seed: tuple[int, ...]
    options: dict[str, Any] = field(default_factory=dict)


def _key(label: str) -> int:
    return zlib.crc32(label.encode())


class Streets:
    """The streets of a set, made when they are first asked for."""

    def __init__(self, set_name: str, seed: int, cache: Path | None, names: tuple[str, ...] | None = None) -> None:
        self.set_name, self.seed, self.cache, self.names = set_name, seed, cache, names
        self._made: dict[tuple[str, int, Size], Street] = {}

    def __call__(self, weather: str, number: int, size: Size) -> Street:
        """One of a weather's streets."""
        grid = Size(rings=size.rings, columns=size.columns)  # less data, same places
        which = (weather, number % STREETS, grid)
        if which not in self._made:
            key = [_key(self.set_name), self.seed, which[1], grid.columns, WEATHERS.index(weather)]
            self._made[which] = street(key, weather, grid, self.cache, self.names)
        return self._made[which]


def plan(set_name: str, seed: int, groups: list[str], size: Size) -> Iterator[Case]:
    """The cases of some groups, in an order that does not depend on which groups there are.

    Args:
        set_name: ``dev...`` or ``blind...``; with the seed it fixes all draws.
        seed: of the set.
        groups: of `GROUPS`.
        size: amount of data of a full study.
    """
    for group in groups:
        for number, (weather, names, levels, given, options) in enumerate(GROUPS[group](seed)):
            label = f"{set_name}-{seed}-{group}-{number}"
            name = f"{set_name}-{seed}-{_key(label):08x}"
            yield Case(name, FAMILY[group], weather, names, levels, given or size, (_key(label), seed, number), options)


Row = tuple[str, tuple[str, ...], tuple[float, ...], Size | None, dict[str, Any]]
FAMILY = {"singles": "single", "nulls": "null"}


def _singles(seed: int) -> Iterator[Row]:
    """Every effect at every level, the weathers in turn."""
    for level_number, level in enumerate(LEVELS):
        for number, name in enumerate(CATALOGUE):
            yield WEATHERS[(number + level_number + seed) % 3], (name,), (level,), None, {}


def _nulls(seed: int) -> Iterator[Row]:
    """Nothing hidden: 40 as all others, 10 with the record off by two standard deviations, 10 with the least data."""
    for number in range(60):
        weather = WEATHERS[number % 3]
        if number % 6 == 4:
            yield weather, (), (), None, {"record_sd": 2.0}
        elif number % 6 == 5:
            yield weather, (), (), Size(clear_frames=2, rates=3, frames=2), {}
        else:
            yield weather, (), (), None, {}


GROUPS = {"singles": _singles, "nulls": _nulls}


def build(case: Case, streets: Streets) -> tuple[Study, dict[str, Any]]:
    """The study of a case, and its truth."""
    rng = np.random.default_rng(list(case.seed))
    number = int(rng.integers(STREETS))
    place, levels = _where_it_shows(case, streets, number)
    design = with_record(place.design, rng, record_sd=case.options.get("record_sd"))
    if (design.size.clear_frames, design.size.rates, design.size.frames) != _data(case.size):
        design = with_record(_resized(design, case.size), rng, record_sd=case.options.get("record_sd"))
    truth: dict[str, Any] = {
        **asdict(case),
        "weather": design.kind,
        "record": design.record,
        "effects": [],
        "conditions": [],
    }
    effects: list[Effect] = []
    for name, level in zip(case.names, levels, strict=True):
        parameters = place.parameters(name, level)
        effect = make_effect(name, parameters)
        effects.append(effect)
        confusable = place.confusable(name, level)
        truth["effects"].append(
            {
                "name": name,
                "parameters": parameters,
                "same_form": effect.same_form,
                "level": level,
                "confusable_with": confusable,
                "identifiable": None if confusable is None else not confusable,
            }
        )
    study = study_of(design, tuple(effects), rng)
    for one in design.conditions:
        truth["conditions"].append(
            {"id": one.id, "recorded": one.recorded, "true": one.weather.amount, "split": one.split}
        )
    return study, truth


def _where_it_shows(case: Case, streets: Streets, number: int) -> tuple[Street, tuple[float, ...]]:
    """A street in which the effects reach their levels: this weather's, else another one's, else a weaker level."""
    for weaker in (0, 1, 2):
        levels = tuple(LEVELS[max(0, LEVELS.index(level) - weaker)] for level in case.levels)
        for turn in range(3):
            weather = WEATHERS[(WEATHERS.index(case.weather) + turn) % 3]
            for other in range(STREETS):
                place = streets(weather, number + other, case.size)
                if all(place.has(name, level) for name, level in zip(case.names, levels, strict=True)):
                    return place, levels
    raise ValueError(f"{case.id}: no street shows {', '.join(case.names)} at any level.")


def _data(size: Size) -> tuple[int, int, int]:
    return size.clear_frames, size.rates, size.frames


def _resized(design: Any, size: Size) -> Any:
    from dataclasses import replace

    return replace(design, size=size)
