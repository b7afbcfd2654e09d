"""Cases of a bench: one study each, with the seed from which all of it follows."""

from __future__ import annotations

import zlib
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

__all__ = ["FAMILIES", "Case", "Row", "cases_of", "label_key", "null_rows", "screen_rows"]

FAMILIES = ("null", "single", "pair", "triple", "outside", "decoy")

Row = tuple[str, tuple[str, ...], tuple[float, ...], Any, dict[str, Any]]
"""Weather, what is hidden, d' of each, size or ``None`` for the usual one, options."""


@dataclass(frozen=True)
class Case:
    """One study to be made.

    Args:
        id: of its folder; says nothing about what is hidden.
        family: one of ``FAMILIES``.
        weather: ``rain``, ``fog`` or ``snow``.
        names: hidden effects, of the catalogue or ``outside.``.
        levels: d' of each.
        size: amount of data, of the sensor's own kind.
        seed: from which all draws follow.
        options: what else is special: ``decoy``, ``screen``, ``record_sd`` and others of a sensor.
    """

    id: str
    family: str
    weather: str
    names: tuple[str, ...]
    levels: tuple[float, ...]
    size: Any
    seed: tuple[int, ...]
    options: dict[str, Any] = field(default_factory=dict)


def label_key(label: str) -> int:
    """A number that belongs to a text."""
    return zlib.crc32(label.encode())


def cases_of(
    groups: Mapping[str, Callable[[int], Iterator[Row]]],
    chosen: Sequence[str],
    set_name: str,
    seed: int,
    sized: Callable[[Any], Any],
    prefix: str = "",
) -> Iterator[Case]:
    """The cases of some groups, in an order that does not depend on which groups there are.

    Args:
        groups: name to the rows that a seed gives.
        chosen: names of groups.
        set_name: ``dev...`` or ``blind...``; with the seed it fixes all draws.
        seed: of the set.
        sized: the size of a case, of what its row states.
        prefix: of the labels, which tells the draws of sensors apart.
    """
    for group in chosen:
        for number, (weather, names, levels, size, options) in enumerate(groups[group](seed)):
            key = label_key(f"{prefix}{set_name}-{seed}-{group}-{number}")
            name = f"{set_name}-{seed}-{key:08x}"
            draws = (key, seed, number)
            yield Case(name, _family(names, options), weather, names, levels, sized(size), draws, options)


def _family(names: tuple[str, ...], options: Mapping[str, Any]) -> str:
    if "decoy" in options:
        return "decoy"
    if names and names[0].startswith("outside."):
        return "outside"
    return FAMILIES[len(names)]


def null_rows(weathers: Sequence[str], least: Any) -> Iterator[Row]:
    """Nothing hidden: 40 as all others, 10 with the record off by two standard deviations, 10 with the least data."""
    for number in range(60):
        weather = weathers[number % 3]
        if number % 6 == 4:
            yield weather, (), (), None, {"record_sd": 2.0}
        elif number % 6 == 5:
            yield weather, (), (), least, {}
        else:
            yield weather, (), (), None, {}


def screen_rows(weathers: Sequence[str], small: Any) -> Iterator[Row]:
    """400 small nulls for the first stage of the search."""
    for number in range(400):
        yield weathers[number % 3], (), (), small, {"screen": True}
