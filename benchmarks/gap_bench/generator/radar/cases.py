"""Plans of the radar bench: which studies a set holds, and how each is made from its seed."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from torchweather.gap.study.study import Study

from ...bars import other_bars
from ...sealed import plain, read_json, write_json
from ..bench_sensor import BenchSensor
from ..planning import Case, Row, cases_of, label_key, null_rows, screen_rows
from .decoys import DECOYS, STRENGTHS_OF
from .design import Design, Size, draw_design, study_of, with_record
from .detectability import IDENTIFIABLE_BELOW, KINDS, Curve, Detector, confusion, refined
from .effects import CATALOGUE
from .outside import OUTSIDE
from .radar_sensor import Effect

__all__ = ["GROUPS", "LEVELS", "SENSOR", "Case", "Place", "build", "needed", "place_of", "plan"]

WEATHERS = ("rain", "snow", "fog")
LEVELS = (5.0, 10.0, 30.0)
NEAR = (0.65, 1.5)  # d' over its level that still counts as that level
PLACES = 2  # designs of each weather that the cases of a set share
SECONDS = 30.0  # a study may take


def _singles(seed: int) -> Iterator[Row]:
    """Every effect five times: at d' of 5 and 30 once, of 10 three times, the weathers in turn, rain twice."""
    turn = (*WEATHERS, "rain")
    for round_, level in enumerate((10.0, 30.0, 5.0, 30.0, 10.0)):
        for number, name in enumerate(CATALOGUE):
            yield turn[(number + round_ + seed) % 4], (name,), (level,), None, {}


PAIRS = (
    *(("wet_radome", "doppler_spread"), ("noise_floor", "range_migration"), ("volume_clutter", "wet_radome")),
    *(("pattern_tilt", "fluctuation"), ("wet_rcs", "interference"), ("multipath", "cfar_shift")),
    *(("detection_limit", "doppler_spread"), ("path_loss_scale", "noise_floor")),
)


MORE_PAIRS = (
    *(("wet_radome", "path_loss_scale"), ("wet_radome", "wet_rcs"), ("cfar_shift", "detection_limit")),
    *(("noise_floor", "interference"), ("multipath", "volume_clutter"), ("doppler_spread", "range_migration")),
    *(("pattern_tilt", "wet_rcs"), ("fluctuation", "doppler_spread"), ("path_loss_scale", "volume_clutter")),
    *(("interference", "range_migration"), ("wet_radome", "multipath"), ("detection_limit", "noise_floor")),
    *(("fluctuation", "wet_rcs"), ("pattern_tilt", "cfar_shift"), ("volume_clutter", "interference")),
    ("path_loss_scale", "fluctuation"),
)
"""The first seven are such as the catalogue calls confusable."""
PAIR_LEVELS = ((30.0, 30.0), (30.0, 10.0), (10.0, 10.0))
TRIPLES = (
    *(("wet_radome", "doppler_spread", "volume_clutter"), ("noise_floor", "range_migration", "wet_rcs")),
    *(("path_loss_scale", "multipath", "fluctuation"), ("interference", "pattern_tilt", "volume_clutter")),
    *(("cfar_shift", "doppler_spread", "wet_radome"), ("detection_limit", "range_migration", "path_loss_scale")),
    *(("multipath", "wet_rcs", "noise_floor"), ("fluctuation", "interference", "range_migration")),
    *(("pattern_tilt", "detection_limit", "doppler_spread"), ("volume_clutter", "wet_rcs", "cfar_shift")),
    *(("wet_radome", "fluctuation", "noise_floor"), ("path_loss_scale", "pattern_tilt", "multipath")),
)


def _pairs(seed: int) -> Iterator[Row]:
    for number, (first, second) in enumerate(PAIRS):
        levels = ((30.0, 30.0), (30.0, 10.0))[number % 2]
        yield ("rain", "snow")[(number + seed) % 2], (f"radar.{first}", f"radar.{second}"), levels, None, {}
    for number, (first, second) in enumerate(MORE_PAIRS):
        weather = ("rain", "snow", "rain", "fog")[(number + seed) % 4]
        yield weather, (f"radar.{first}", f"radar.{second}"), PAIR_LEVELS[number % len(PAIR_LEVELS)], None, {}


def _triples(seed: int) -> Iterator[Row]:
    for number, names in enumerate(TRIPLES):
        weather = ("rain", "snow", "rain", "fog")[(number + seed) % 4]
        yield weather, tuple(f"radar.{name}" for name in names), (30.0, 30.0, 30.0), None, {}


def _outside(seed: int) -> Iterator[Row]:
    """Each kind at d' of 30, 10 and 30 again, in other weathers."""
    for turn, level in enumerate((30.0, 10.0, 30.0)):
        for number, name in enumerate(OUTSIDE):
            yield WEATHERS[(number + turn * len(OUTSIDE) + seed) % 3], (name,), (level,), None, {}


def _decoys(seed: int) -> Iterator[Row]:
    for number, name in enumerate((*DECOYS, *DECOYS)):
        yield WEATHERS[(number + number // len(DECOYS) + seed) % 3], (), (), None, {"decoy": name}


def _reduced(seed: int) -> Iterator[Row]:
    """Eight studies for continuous integration."""
    yield "rain", ("radar.wet_radome",), (30.0,), None, {}
    yield "snow", ("radar.doppler_spread",), (30.0,), None, {}
    yield "rain", ("radar.pattern_tilt",), (30.0,), None, {}
    yield "fog", ("radar.noise_floor",), (30.0,), None, {}
    yield "rain", (), (), None, {}
    yield "snow", (), (), None, {"record_sd": 2.0}
    yield "rain", ("outside.range_gain_step",), (30.0,), None, {}
    yield "rain", (), (), None, {"decoy": "decoy.no_target"}


GROUPS: dict[str, Callable[[int], Iterator[Row]]] = {
    "singles": _singles,
    "nulls": lambda seed: null_rows(WEATHERS, Size(clear_frames=2, rates=3, frames=2)),
    "pairs": _pairs,
    "triples": _triples,
    "outside": _outside,
    "decoys": _decoys,
    "screen": lambda seed: screen_rows(WEATHERS, Size().fewer_targets()),
    "reduced": _reduced,
}


def plan(set_name: str, seed: int, groups: Sequence[str], small: bool = False) -> list[Case]:
    """The cases of some groups, in an order that does not depend on which groups there are.

    Args:
        set_name: ``dev...`` or ``blind...``; with the seed it fixes all draws.
        seed: of the set.
        groups: of `GROUPS`.
        small: half of the targets.
    """

    def sized(stated: Size | None) -> Size:
        full = stated or Size()
        return full.fewer_targets() if small else full

    return list(cases_of(GROUPS, groups, set_name, seed, sized, "radar-"))


def needed(case: Case) -> set[str]:
    """Effects whose strengths the study needs."""
    return {*case.names, *STRENGTHS_OF.get(case.options.get("decoy", ""), ())}


@dataclass(frozen=True)
class Place:
    """A design and what effects look like in it.

    Args:
        design: scenes.
        table: by effect and level: parameters, and the largest cosine with each other effect.
    """

    design: Design
    table: dict[str, dict[str, Any]]

    def has(self, name: str, level: float) -> bool:
        """Whether the effect can be that strong here."""
        return f"{level:g}" in self.table.get(name, {})

    def parameters(self, name: str, level: float) -> dict[str, float]:
        """At the strength of a level."""
        return {key: float(value) for key, value in self.table[name][f"{level:g}"]["parameters"].items()}


def place_of(
    set_name: str, seed: int, weather: str, number: int, size: Size, names: Sequence[str] | None, cache: Path | None
) -> Place:
    """A design that cases of a set share, with its table from the cache where it is there.

    Args:
        set_name, seed: of the set.
        weather, number: which.
        size: amount of data.
        names: effects that are needed, then without cosines; ``None``: all.
        cache: folder of tables; part of what is sealed.
    """
    key = [label_key(set_name), seed, number, size.targets, WEATHERS.index(weather)]
    design = draw_design(np.random.default_rng(key), weather, Size(targets=size.targets))
    wanted = list(KINDS) if names is None else [name for name in KINDS if name in names]
    if not wanted:
        return Place(design, {})
    path = None if cache is None else cache / f"place-{'-'.join(map(str, key))}.json"
    if path is not None and path.exists():
        held = read_json(path)
        if set(wanted) <= set(held):
            return Place(design, held)
    detector = Detector(design, key[-1] + 1)
    curves: dict[str, Curve] = {}
    for name in wanted:
        own = np.random.default_rng([*key, list(KINDS).index(name)])
        sign = float(own.choice([-1.0, 1.0])) if KINDS[name].two_sided else 1.0
        curves[name] = detector.curve(name, KINDS[name].fixed(own), sign)
    table: dict[str, dict[str, Any]] = {}
    for name, curve in curves.items():
        table[name] = {"lengths": [float(f"{value:.4g}") for value in curve.lengths]}
        for level in LEVELS:
            strength = curve.strength_for(level)
            if strength is not None:
                strength, reached, signature = refined(detector, curve, strength, level)
                if not NEAR[0] * level <= reached <= NEAR[1] * level:
                    continue
                alike = None if names is not None else confusion(curves, name, signature)
                table[name][f"{level:g}"] = {
                    "strength": strength,
                    "reached": round(reached, 2),
                    "parameters": curve.effect(strength).parameters,
                    "cosine": alike if alike is None else {k: round(v, 4) for k, v in alike.items()},
                }
    table = plain(table)
    if path is not None:
        write_json(path, table)
    return Place(design, table)


Places = Callable[[str, int, Size], Place]


def build(case: Case, places: Places) -> tuple[Study, dict[str, Any]]:
    """The study of a case, and its truth."""
    rng = np.random.default_rng(list(case.seed))
    place, levels = _where_it_shows(case, places, int(rng.integers(PLACES)))
    design = with_record(replace(place.design, size=case.size), rng, case.options.get("record_sd"))
    truth: dict[str, Any] = {**asdict(case), "weather": design.kind, "record": design.record, "effects": []}
    effects: list[Effect] = []
    for name, level in zip(case.names, levels, strict=True):
        effects.append(KINDS[name](place.parameters(name, level)))
        truth["effects"].append(_effect_truth(place, name, level))
    if "decoy" in case.options:
        decoy = DECOYS[case.options["decoy"]](design, place.parameters, rng)
        truth["right"] = {"verdicts": decoy.verdicts, "names": decoy.names}
        study = study_of(
            design,
            decoy.effects,
            rng,
            clear_effects=decoy.clear_effects,
            acts=decoy.acts,
            scenes=decoy.scenes,
            repeated=decoy.repeated,
        )
    else:
        study = study_of(design, tuple(effects), rng)
    truth["conditions"] = [
        {"id": one.id, "recorded": one.recorded, "true": one.weather.amount, "split": one.split}
        for one in design.conditions
    ]
    return study, truth


def _effect_truth(place: Place, name: str, level: float) -> dict[str, Any]:
    held = place.table[name][f"{level:g}"]
    alike = held["cosine"]
    confusable = None if alike is None else {k: v for k, v in alike.items() if v >= IDENTIFIABLE_BELOW}
    return {
        "name": name,
        "parameters": place.parameters(name, level),
        "same_form": KINDS[name].same_form,
        "level": level,
        "confusable_with": confusable,
        "identifiable": None if confusable is None else not confusable,
        "axes": OUTSIDE[name].shows_along if name in OUTSIDE else None,
    }


def _where_it_shows(case: Case, places: Places, number: int) -> tuple[Place, tuple[float, ...]]:
    """A design in which the effects reach their levels: this weather's, another's, or at weaker or stronger levels."""
    wanted = needed(case)
    if not wanted:
        return places(case.weather, number, case.size), ()
    last = len(LEVELS) - 1
    for weaker in (0, 1, 2, -1, -2):
        levels = tuple(LEVELS[min(max(0, LEVELS.index(level) - weaker), last)] for level in case.levels)
        asked = list(zip(case.names, levels, strict=True)) + [(name, 30.0) for name in wanted - set(case.names)]
        for turn in range(len(WEATHERS)):
            weather = WEATHERS[(WEATHERS.index(case.weather) + turn) % len(WEATHERS)]
            for other in range(PLACES):
                place = places(weather, (number + other) % PLACES, case.size)
                if all(place.has(name, level) for name, level in asked):
                    return place, levels
    raise ValueError(f"{case.id}: no design shows {', '.join(sorted(wanted))} at any level.")


def _builder(
    set_name: str, seed: int, sealed: Path, cases: Sequence[Case], few: bool
) -> Callable[[Case], tuple[Study, dict[str, Any]]]:
    """What builds the cases, with the tables of their designs in the sealed folder."""
    names = sorted(set().union(*(needed(case) for case in cases))) if few else None
    some = any(needed(case) for case in cases)
    made: dict[tuple[str, int, int], Place] = {}

    def places(weather: str, number: int, size: Size) -> Place:
        key = (weather, number, size.targets)
        if key not in made:
            made[key] = place_of(set_name, seed, weather, number, size, names if some else (), sealed)
        return made[key]

    return lambda case: build(case, places)


SENSOR = BenchSensor(
    groups=tuple(GROUPS),
    usual=("singles", "nulls", "pairs", "triples", "outside", "decoys"),
    plan=plan,
    builder=_builder,
    bars=other_bars(SECONDS),
    floors=1.2,
)
"""What the bench needs of radar."""
