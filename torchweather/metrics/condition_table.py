"""Scores and performance of a detector, brought together by the weather in which both were taken."""

from __future__ import annotations

import math
import numbers
from collections import defaultdict
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from torchweather.core.arguments import check_arguments
from torchweather.core.errors import InputTypeError, InputValueError, nearest_name

__all__ = ["CONDITION_COLUMNS", "FEWEST", "Conditions", "join"]

Floats = NDArray[np.float64]
Table = Mapping[str, Sequence[Any]]
Key = tuple[Any, ...]

# Columns of a sweep that say under which condition a row was taken.
CONDITION_COLUMNS = ("subject", "sensor", "weather", "knob", "value", "severity", "seed")
# Of three conditions in random order every third gives rho = 1 or -1; of four every twelfth.
FEWEST = 4


@dataclass(frozen=True, eq=False)
class Conditions:
    """One row a condition: n of them.

    Args:
        by: columns that tell conditions apart; empty where rows are conditions as they stand.
        labels: these columns, ``(n,)`` each.
        performance: ``(n,)``, finite.
        scores: of every metric ``(n,)``; NaN where there is none, infinite where the metric is.
        kind: of the weather (and the sensor, where there are several), ``(n,)``; None where no column says.
        level: rank of the weather's strength within its kind, ``(n,)``, from 1; None likewise.
        scored_only, performed_only: conditions that stand in one of the tables only, and are left out.
    """

    by: tuple[str, ...]
    labels: dict[str, list[Any]]
    performance: Floats
    scores: dict[str, Floats]
    kind: list[str] | None
    level: Floats | None
    scored_only: int = 0
    performed_only: int = 0


def join(
    scores: Table, performance: Table | Sequence[float], by: Sequence[str] | None, performance_column: str
) -> Conditions:
    """Scores and performance by condition; the arguments are those of ``correlate``."""
    if "metric" in scores and "score" in scores:
        if not isinstance(performance, Mapping):
            raise InputValueError(
                "correlate: performance must be a table with condition columns, as the scores are one; got "
                f"{type(performance).__name__}. Give {', '.join(CONDITION_COLUMNS[1:5])} and {performance_column}."
            )
        return _joined(scores, performance, by, performance_column)
    return _side_by_side(scores, performance, by, performance_column)


# ---- rows that belong together by their place ----------------------------------------------------------------------


def _side_by_side(
    scores: Table, performance: Table | Sequence[float], by: Sequence[str] | None, performance_column: str
) -> Conditions:
    if by is not None:
        raise InputValueError(
            "correlate: by needs a table of scores with the columns metric and score; got metrics only."
        )
    table = performance if isinstance(performance, Mapping) else {performance_column: performance}
    _check_performance(table, performance_column)
    labels = {name: list(table[name]) for name in CONDITION_COLUMNS if name in table}
    measured = _numbers(table[performance_column], performance_column)
    found = {metric: _numbers(values, metric) for metric, values in scores.items()}
    lengths = {name: len(values) for name, values in labels.items()} | {
        name: len(values) for name, values in found.items()
    }
    for name, length in lengths.items():
        if length != len(measured):
            raise InputValueError(
                f"correlate: {name} must have one value a condition, {len(measured)} as the performance; got {length}."
            )
    keep = ~np.isnan(measured)
    labels = {
        name: [value for value, kept in zip(values, keep, strict=True) if kept] for name, values in labels.items()
    }
    return _checked(
        by=tuple(labels),
        labels=labels,
        performance=measured[keep],
        scores={metric: values[keep] for metric, values in found.items()},
        strength=labels.get("severity", labels.get("value")),
    )


# ---- rows that belong together by what they say --------------------------------------------------------------------


def _joined(scores: Table, performance: Table, by: Sequence[str] | None, performance_column: str) -> Conditions:
    _check_performance(performance, performance_column)
    _check_lengths("scores", scores)
    _check_lengths("performance", performance)
    shared = [name for name in CONDITION_COLUMNS if name in scores and name in performance]
    if not shared:
        raise InputValueError(
            f"correlate: scores and performance must share condition columns ({', '.join(CONDITION_COLUMNS)}); got "
            f"{', '.join(scores)} and {', '.join(performance)}."
        )
    chosen = [name for name in shared if name != "seed"] if by is None else list(by)
    if not chosen or not {*chosen} <= {*shared}:
        raise InputValueError(
            f"correlate: by must name columns that both tables have, {', '.join(shared)}; got {by!r}."
        )
    measured = _by_key(performance, shared, _numbers(performance[performance_column], performance_column))
    values = _numbers(scores["score"], "score")
    scored: dict[str, dict[Key, list[float]]] = {}
    for metric in dict.fromkeys(scores["metric"]):
        rows = [row for row, name in enumerate(scores["metric"]) if name == metric]
        scored[str(metric)] = _by_key(
            {name: [scores[name][row] for row in rows] for name in shared}, shared, values[rows]
        )
    all_scored = {key for keys in scored.values() for key in keys}
    both = [key for key in measured if key in all_scored]
    if not both:
        first = (dict(zip(shared, next(iter(keys), ()), strict=False)) for keys in (all_scored, measured))
        raise InputValueError(
            f"correlate: no condition stands in both tables; scores have {next(first)}, performance {next(first)}. "
            "Names and numbers must be equal."
        )
    places: dict[Key, list[Key]] = defaultdict(list)
    for key in both:
        places[tuple(key[shared.index(name)] for name in chosen)].append(key)
    labels = {name: [group[k] for group in places] for k, name in enumerate(chosen)}
    return _checked(
        by=tuple(chosen),
        labels=labels,
        performance=_means(measured, places),
        scores={metric: _means(keys, places) for metric, keys in scored.items()},
        strength=labels.get("severity") or _severities(scores, chosen, [*places]) or labels.get("value"),
        scored_only=len(all_scored - {*measured}),
        performed_only=len({*measured} - all_scored),
    )


def _by_key(table: Table, shared: Sequence[str], values: Floats) -> dict[Key, list[float]]:
    """Numbers of the rows with equal condition columns; NaN left out."""
    found: dict[Key, list[float]] = defaultdict(list)
    for row, value in enumerate(values.tolist()):
        if not math.isnan(value):
            found[tuple(table[name][row] for name in shared)].append(value)
    return found


def _means(values: Mapping[Key, list[float]], places: Mapping[Key, list[Key]]) -> Floats:
    """Mean of each group: of its conditions, each the mean of its rows."""
    found = []
    for keys in places.values():
        means = [_mean(values[key]) for key in keys if values.get(key)]
        found.append(_mean(means) if means else math.nan)
    return np.array(found)


def _mean(values: Sequence[float]) -> float:
    # A mean of inf and -inf is no number; a metric has one of them at most.
    return sum(values) / len(values)


def _severities(scores: Table, chosen: Sequence[str], groups: Sequence[Key]) -> list[Any] | None:
    """Severity of each group from the scores' own column, where it has one and each group only one."""
    if "severity" not in scores:
        return None
    found: dict[Key, set[Any]] = defaultdict(set)
    for row, severity in enumerate(scores["severity"]):
        found[tuple(scores[name][row] for name in chosen)].add(severity)
    if any(len(found[group]) != 1 for group in groups):
        return None
    return [next(iter(found[group])) for group in groups]


# ---- checks --------------------------------------------------------------------------------------------------------


def _checked(*, strength: Sequence[Any] | None, **fields: Any) -> Conditions:
    count = len(fields["performance"])
    if count < FEWEST:
        raise InputValueError(
            f"correlate: needs {FEWEST} conditions or more with a performance; got {count}. Sweep more levels of the "
            "weather, or separate conditions by more columns (by)."
        )
    if not np.isfinite(fields["performance"]).all():
        raise InputValueError("correlate: performance must be finite; got infinity.")
    if not fields["scores"]:
        raise InputValueError("correlate: needs the scores of one metric or more; got none.")
    labels = fields["labels"]
    kind = None
    if "weather" in labels:
        sensors = labels.get("sensor", [""] * count)
        several = len({*sensors}) > 1
        kind = [
            f"{sensor} {weather}" if several else str(weather)
            for sensor, weather in zip(sensors, labels["weather"], strict=True)
        ]
    return Conditions(kind=kind, level=_levels(kind, strength), **fields)


def _levels(kind: Sequence[str] | None, strength: Sequence[Any] | None) -> Floats | None:
    """Rank of the strength within each kind of weather."""
    if kind is None or strength is None:
        return None
    numeric = [value if isinstance(value, numbers.Real) else 0.0 for value in strength]  # clear air has no value
    levels = np.zeros(len(kind))
    for name in {*kind}:
        rows = [row for row, each in enumerate(kind) if each == name]
        levels[rows] = np.unique([numeric[row] for row in rows], return_inverse=True)[1] + 1
    return levels


def _check_performance(table: Table, column: str) -> None:
    if column not in table:
        raise InputValueError(
            f"correlate: performance must have a column {column!r}; got {', '.join(table)}."
            f"{nearest_name(column, table)} Name yours by performance_column."
        )


def _check_lengths(which: str, table: Table) -> None:
    lengths = {name: len(column) for name, column in table.items()}
    if len({*lengths.values()}) > 1:
        raise InputValueError(f"correlate: columns of {which} must be of one length; got {lengths}.")


def _numbers(values: Iterable[Any], name: str) -> Floats:
    """A column as float64; None is NaN, and so is the text that CSV and JSON have for it."""
    check_arguments(f"correlate({name.split()[0] if name.split() else 'scores'}: Iterable)", values)
    found = []
    for value in values:
        try:
            if isinstance(value, bool):
                raise InputTypeError("a truth value")
            found.append(math.nan if value is None else float(value))
        except (TypeError, ValueError) as error:
            raise InputValueError(f"correlate: {name} must hold numbers; got {value!r}.") from error
    return np.array(found, dtype=np.float64)
