"""Strengths of named effects at which frames are simulated for the power of a validation."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from torchweather.core.errors import InputValueError, check_one_of
from torchweather.gap.inference.effect_forms import searched_effects
from torchweather.pipeline.effect import Effect, Parameter
from torchweather.stages.catalogue import EFFECTS

__all__ = ["ALL", "STRENGTHS", "EffectStrength", "TriedEffect", "named_effects"]

ALL = "all"
# Over the typical size that the catalogue states. Where no score shows the first, the third is simulated too; else the
# second, so that the smallest strength lies between two that were simulated, or below the smallest one.
STRENGTHS = (1.0, 0.25, 4.0)


def named_effects(kind: str, names: Sequence[str], owner: str) -> list[TriedEffect]:
    """Effects of a sensor.

    Args:
        kind: of the study.
        names: ids of the catalogue; ``all`` stands for those that the gap workflow searches for.
        owner: names the caller in an error.

    Raises:
        InputValueError: an effect of another sensor, or none at all.

    Example:
        >>> [each.id for each in named_effects("lidar", ["lidar.window_loss"], "validate")]
        ['lidar.window_loss']
    """
    known = [name for name in EFFECTS if name.startswith(f"{kind}.")]
    found: dict[str, TriedEffect] = {}
    for name in names:
        if name != ALL:
            check_one_of("effect", name, known, owner=owner)
        for one in searched_effects(kind) if name == ALL else [name]:
            found[one] = TriedEffect(EFFECTS[one])
    if names and not known:
        raise InputValueError(f"{owner}: effects belong to frames of a sensor; got a study of {kind}s. Leave them out.")
    return list(found.values())


@dataclass(frozen=True)
class TriedEffect:
    """An effect of the catalogue along its first parameter that has an identity.

    Parameters of the same unit, size and identity move with it, such as the three colours of an airlight. The others
    keep their defaults.

    Args:
        effect: its class.

    Example:
        >>> tried = TriedEffect(EFFECTS["lidar.window_loss"])
        >>> tried.at(0.5), tried.value(0.5), tried.strength(60.0)
        (LidarWindowLoss(loss_db=1.0), 1.0, 15.0)
    """

    effect: type[Effect]

    @property
    def id(self) -> str:
        """Id in the catalogue."""
        return self.effect.id

    @property
    def parameter(self) -> Parameter:
        """The parameter that is moved."""
        return next(each for each in self.effect.arguments if each.identity is not None)

    def value(self, strength: float) -> float:
        """Value of the parameter at a strength in typical sizes, upwards from the identity and within the bounds.

        Where the identity is infinite, the typical value over the strength. A factor is ``exp(size)`` times as large.
        """
        of = self.parameter
        assert of.identity is not None
        if math.isinf(of.identity):
            value = of.scale / strength if strength > 0 else of.identity
        elif of.identity > 0 and of.low >= 0:
            value = of.identity * math.exp(strength * of.scale)
        else:
            value = of.identity + strength * of.scale
        return min(max(value, of.low), of.high)

    def strength(self, most: float) -> float:
        """The largest strength up to ``most`` that the bounds allow."""
        of = self.parameter
        assert of.identity is not None
        if math.isinf(of.identity):
            return min(most, of.scale / of.low) if of.low > 0 else most
        factor = of.identity > 0 and of.low >= 0
        bound = math.log(of.high / of.identity) / of.scale if factor else (of.high - of.identity) / of.scale
        return min(most, bound)

    def at(self, strength: float) -> Effect:
        """The effect at a strength in typical sizes."""
        of, value = self.parameter, self.value(strength)
        alike = (of.unit, of.scale, of.identity)
        moved = [each.name for each in self.effect.arguments if (each.unit, each.scale, each.identity) == alike]
        return self.effect(**dict.fromkeys(moved, value))

    def text(self, strength: float) -> str:
        """Parameter and value at a strength, such as ``loss_db = 1``."""
        return f"{self.parameter.name} = {self.value(strength):.3g}"


@dataclass(frozen=True)
class EffectStrength:
    """The smallest strength of an effect that a score would have shown.

    Args:
        effect: id in the catalogue.
        parameter, unit: that is moved.
        typical: its typical value.
        strength: smallest one, in typical sizes; infinite where none of those simulated would have been shown.
        value: of the parameter there; not a number where none would have been shown.
        most: largest value that was simulated.
        score: that is the most sensitive; empty where none would have shown it.
    """

    effect: str
    parameter: str
    unit: str
    typical: float
    strength: float
    value: float
    most: float
    score: str = ""

    @classmethod
    def of(cls, tried: TriedEffect, strength: float, most: float, score: str = "") -> EffectStrength:
        """The strength of a tried effect.

        Args:
            tried: the effect.
            strength, score: as above.
            most: largest strength that was simulated.
        """
        own = tried.parameter
        return cls(
            effect=tried.id,
            parameter=own.name,
            unit="" if own.unit == "1" else own.unit,
            typical=tried.value(tried.strength(1.0)),
            strength=strength,
            value=tried.value(strength) if math.isfinite(strength) else math.nan,
            most=tried.value(most),
            score=score if math.isfinite(strength) else "",
        )

    def to_dict(self) -> dict[str, Any]:
        """Plain values."""
        return dict(vars(self))
