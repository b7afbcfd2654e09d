"""Uniform, LogUniform, Choice: what a parameter may be that is drawn anew for each sample.

Each turns one number u, uniform in [0, 1), into a value (``at``), so that whoever draws u decides the seed.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from torchweather.core.arguments import check_arguments
from torchweather.core.errors import InputValueError, check_between, nearest_name

__all__ = ["Choice", "Distribution", "LogUniform", "Uniform", "distribution_from"]


class Distribution:
    """A value that is drawn for each sample."""

    def at(self, u: float) -> Any:
        """The value at a share u of the probability, ``[0, 1)``."""
        raise NotImplementedError

    def ends(self) -> tuple[Any, ...]:
        """Values that all others lie between, or all values of a choice: what has to be allowed."""
        raise NotImplementedError

    def to_dict(self) -> dict[str, Any]:
        """Plain values that ``distribution_from`` takes and YAML can hold."""
        raise NotImplementedError


@dataclass(frozen=True)
class Uniform(Distribution):
    """Every value between two is as likely as another.

    Args:
        low, high: the ends, in the parameter's unit; ``low`` below ``high``.

    Example:
        >>> Uniform(1, 50).at(0.5)
        25.5
    """

    low: float
    high: float

    def __post_init__(self) -> None:
        check_arguments("Uniform(low: float, high: float)", self.low, self.high)
        _check_ends(self, self.low, self.high)

    def at(self, u: float) -> float:
        """``low + u (high - low)``."""
        return float(self.low + u * (self.high - self.low))

    def ends(self) -> tuple[float, float]:
        """Both ends."""
        return float(self.low), float(self.high)

    def to_dict(self) -> dict[str, Any]:
        """``{"uniform": [low, high]}``."""
        return {"uniform": list(self.ends())}


@dataclass(frozen=True)
class LogUniform(Distribution):
    """Every factor is as likely as another: as often between 1 and 5 as between 10 and 50.

    For rates and visibilities, of which equal factors look like equal steps.

    Args:
        low, high: the ends, in the parameter's unit; 0 < ``low`` < ``high``.

    Example:
        >>> round(LogUniform(1, 100).at(0.5), 6)
        10.0
    """

    low: float
    high: float

    def __post_init__(self) -> None:
        check_arguments("LogUniform(low: float, high: float)", self.low, self.high)
        _check_ends(self, self.low, self.high)
        if not self.low > 0:
            raise InputValueError(f"LogUniform: low must be above 0; got {self.low!r}. Uniform takes 0.")

    def at(self, u: float) -> float:
        """``low (high / low)^u``."""
        check_arguments("LogUniform.at(u: float)", u)
        check_between("u", u, 0.0, 1.0, owner=self)
        return float(self.low * (self.high / self.low) ** u)

    def ends(self) -> tuple[float, float]:
        """Both ends."""
        return float(self.low), float(self.high)

    def to_dict(self) -> dict[str, Any]:
        """``{"log_uniform": [low, high]}``."""
        return {"log_uniform": list(self.ends())}


@dataclass(frozen=True)
class Choice(Distribution):
    """One of several values.

    Args:
        values: to choose from; of numbers, or of whole weathers (``None`` among them is clear air).
        weights: how likely each is, in any unit; ``None``: all alike.

    Example:
        >>> [Choice([10, 25, 50], weights=[1, 1, 2]).at(u) for u in (0.1, 0.3, 0.6)]
        [10, 25, 50]
    """

    values: tuple[Any, ...]
    weights: tuple[float, ...] | None = None

    def __init__(self, values: Sequence[Any], weights: Sequence[float] | None = None) -> None:
        check_arguments("Choice(values: Sequence, weights: Sequence[float] | None)", values, weights)
        if isinstance(values, str) or not len(values):
            raise InputValueError(f"Choice: wanted a list of values, one or more; got {values!r}.")
        if weights is not None:
            weights = weights.tolist() if hasattr(weights, "tolist") else weights
            one_each = len(weights) == len(values) and not any(isinstance(one, list) for one in weights)
            good = one_each and all(math.isfinite(one) and one >= 0 for one in weights)
            if not good or not sum(weights) > 0:
                raise InputValueError(
                    f"Choice: wanted a weight of 0 or more for each of {len(values)} values, not all 0; got "
                    f"{list(weights)!r}."
                )
        object.__setattr__(self, "values", tuple(values))
        object.__setattr__(self, "weights", None if weights is None else tuple(float(one) for one in weights))

    def at(self, u: float) -> Any:
        """The value in whose share of the weights u lies."""
        check_arguments("Choice.at(u: float)", u)
        weights = self.weights or (1.0,) * len(self.values)
        left = u * sum(weights)
        for value, weight in zip(self.values, weights, strict=True):
            if left < weight:
                return value
            left -= weight
        return next(value for value, weight in zip(reversed(self.values), reversed(weights), strict=True) if weight)

    def ends(self) -> tuple[Any, ...]:
        """All values."""
        return self.values

    def to_dict(self) -> dict[str, Any]:
        """``{"choice": [...]}``, with ``weights`` where they were given."""
        plain = [value.to_dict() if hasattr(value, "to_dict") else value for value in self.values]
        return {"choice": plain} if self.weights is None else {"choice": plain, "weights": list(self.weights)}


KINDS = {"uniform": Uniform, "log_uniform": LogUniform}


def distribution_from(values: Mapping[str, Any], *, owner: str) -> Distribution:
    """The distribution that ``to_dict`` wrote.

    Example:
        >>> distribution_from({"log_uniform": [1, 50]}, owner="rate_mm_per_h")
        LogUniform(low=1, high=50)
    """
    known = (*KINDS, "choice")
    kind = next((key for key in values if key != "weights"), None)
    if kind not in known or not set(values) <= {kind, "weights"} or ("weights" in values and kind != "choice"):
        raise InputValueError(
            f"{owner}: wanted a number or one of {', '.join(known)} (choice also with weights); got "
            f"{dict(values)!r}.{nearest_name(kind, known)}"
        )
    given = values[kind]
    if kind == "choice":
        return Choice(given, values.get("weights"))
    if not isinstance(given, Sequence) or len(given) != 2:
        raise InputValueError(f"{owner}: {kind} must be [low, high]; got {given!r}.")
    return KINDS[kind](*given)


def _check_ends(owner: Distribution, low: float, high: float) -> None:
    name = type(owner).__name__
    for value in (low, high):
        if isinstance(value, bool) or not isinstance(value, (int, float)) or not math.isfinite(value):
            raise InputValueError(f"{name}: low and high must be finite numbers; got {low!r}, {high!r}.")
    if not low < high:
        raise InputValueError(f"{name}: low must be below high; got {low!r}, {high!r}.")
