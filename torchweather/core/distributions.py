"""Uniform, LogUniform, Choice: what a parameter may be that is drawn anew for each sample.

Each turns one number u, uniform in [0, 1), into a value (``at``), so that whoever draws u decides the seed.

Options, sensors, effects and weathers hold distributions among their values. `distributions_in` finds them, by dotted
name, and `with_drawn` puts numbers in their places.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NoReturn

from torchweather.core.arguments import check_arguments
from torchweather.core.errors import InputTypeError, InputValueError, check_between, nearest_name

__all__ = [
    "Choice",
    "Distribution",
    "LogUniform",
    "Uniform",
    "distribution_from",
    "distributions_in",
    "refuse_fixed",
    "with_distributions",
    "with_drawn",
]


class Distribution:
    """A value that is drawn for each sample. It is no number: what computes with it is refused."""

    def _refused(self, *others: object) -> NoReturn:
        """Refuse to serve as a number."""
        raise InputTypeError(
            f"{self!r}: it has yet to be drawn for each sample and cannot serve as a number here. Give a number, or "
            "call the transform without noise, or Compose, which draw one."
        )

    __float__ = __int__ = __neg__ = __abs__ = _refused
    __add__ = __radd__ = __sub__ = __rsub__ = __mul__ = __rmul__ = __truediv__ = __rtruediv__ = _refused
    __lt__ = __le__ = __gt__ = __ge__ = _refused

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
            raise InputValueError(f"Choice: expected a list of values, one or more; got {values!r}.")
        if weights is not None:
            weights = weights.tolist() if hasattr(weights, "tolist") else weights
            one_each = len(weights) == len(values) and not any(isinstance(one, list) for one in weights)
            good = one_each and all(math.isfinite(one) and one >= 0 for one in weights)
            if not good or not sum(weights) > 0:
                raise InputValueError(
                    f"Choice: expected a weight of 0 or more for each of {len(values)} values, not all 0; got "
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


def distributions_in(value: Any, name: str = "") -> dict[str, Distribution]:
    """Distributions among nested values, by dotted name.

    Args:
        value: a distribution; a tuple, list or mapping; a sensor, effect or weather; anything else holds none.
        name: of the value. Elements of a sequence are named by their place, effects by their id.

    Example:
        >>> distributions_in({"airlight": Uniform(0.5, 0.9), "wind_m_per_s": (0.0, Uniform(-3, 3), 0.0)})
        {'airlight': Uniform(low=0.5, high=0.9), 'wind_m_per_s.1': Uniform(low=-3, high=3)}
    """
    if value is None or isinstance(value, (bool, int, float, str)):  # most of what there is
        return {}
    if isinstance(value, Distribution):
        return {name: value}
    found: dict[str, Distribution] = {}
    for key, one in _inside(value):
        found |= distributions_in(one, f"{name}.{key}" if name else key)
    return found


def with_drawn(value: Any, drawn: Mapping[str, Any], name: str = "") -> Any:
    """Nested values with numbers in place of distributions; those without a number stay.

    Args:
        value, name: as of `distributions_in`.
        drawn: dotted name to what stands in the distribution's place.

    Example:
        >>> with_drawn({"airlight": Uniform(0.5, 0.9)}, {"airlight": 0.7})
        {'airlight': 0.7}
    """
    if isinstance(value, Distribution):
        return drawn.get(name, value)
    if not distributions_in(value):
        return value
    inside = {key: with_drawn(one, drawn, f"{name}.{key}" if name else key) for key, one in _inside(value)}
    if hasattr(value, "with_values"):
        return value.with_values({key: one for key, one in inside.items() if not isinstance(one, Distribution)})
    return inside if isinstance(value, Mapping) else type(value)(inside.values())


def with_distributions(value: Any, *, owner: str) -> Any:
    """Plain values of a file with the distributions that mappings in them stand for (``{uniform: [low, high]}``).

    Args:
        value: numbers, text, lists and mappings.
        owner: for messages.

    Example:
        >>> with_distributions({"airlight": {"uniform": [0.5, 0.9]}}, owner="options")
        {'airlight': Uniform(low=0.5, high=0.9)}
    """
    if isinstance(value, Mapping):
        if any(kind in value for kind in (*KINDS, "choice")):
            return distribution_from(value, owner=owner)
        return {key: with_distributions(one, owner=f"{owner}.{key}") for key, one in value.items()}
    return [with_distributions(one, owner=owner) for one in value] if isinstance(value, list) else value


def refuse_fixed(values: Mapping[str, Any], fixed: Sequence[str], owner: object) -> None:
    """Raise where a value is a distribution that all samples share.

    Args:
        values: by name.
        fixed: names of those that are not drawn.
        owner: for messages.
    """
    for name in fixed:
        for given in distributions_in(values.get(name), name).values():
            raise InputValueError(
                f"{owner}: {name} cannot be drawn for each sample; got {given!r}. Give one value for all samples."
            )


def _inside(value: Any) -> list[tuple[str, Any]]:
    """Named elements of a container; none of what is no container."""
    if hasattr(value, "random") and hasattr(value, "with_values"):
        return list(value.random.items())
    if isinstance(value, Mapping):
        return [(str(key), one) for key, one in value.items()]
    if not isinstance(value, (tuple, list)):
        return []
    names = [one.get("effect") if isinstance(one, Mapping) else getattr(one, "id", None) for one in value]
    return [
        (str(place) if name is None else name, one) for place, (name, one) in enumerate(zip(names, value, strict=True))
    ]


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
            f"{owner}: expected a number or one of {', '.join(known)} (choice also with weights); got "
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
