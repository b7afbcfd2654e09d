"""Results of a fit of the weather to recordings."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any

__all__ = ["ConditionFit", "Estimate", "Value", "WeatherFit"]


@dataclass(frozen=True)
class Value:
    """A number with its central 90 % interval; not a number where a single frame gives none."""

    value: float
    low: float
    high: float

    def __str__(self) -> str:
        if math.isnan(self.low):
            return f"{self.value:.3g}"
        return f"{self.value:.3g} ({self.low:.3g} to {self.high:.3g})"


@dataclass(frozen=True)
class Estimate:
    """One estimator's answer for a condition.

    Args:
        name: of the estimator.
        intensity: rate or visibility, in the unit of the condition's parameter.
        loss: of the path one way, in the unit of ``loss_name``; the intensity follows from it.
        loss_name: ``extinction_per_m`` or ``attenuation_db_per_km``.
        others: further parameters, by name with unit.
        cells: statistics that were fitted.
        misfit: chi-square of the residuals for a degree of freedom; about 1 where the model describes the frames.
        fits: False where the chi-square is above its 99 % quantile: the model lacks something, and the intervals are
            widened by the root of the misfit.
    """

    name: str
    intensity: Value
    loss: Value
    loss_name: str
    others: Mapping[str, Value]
    cells: int
    misfit: float
    fits: bool


@dataclass(frozen=True)
class ConditionFit:
    """The estimates of one condition.

    Args:
        id, kind: of the condition and its weather.
        parameter: ``mor_m`` or ``rate_mm_per_h``.
        recorded: its value as recorded.
        frames: how many were measured.
        estimates: side by side.
        left_out: estimator to the reason why these frames cannot have it.
    """

    id: str
    kind: str
    parameter: str
    recorded: float
    frames: int
    estimates: tuple[Estimate, ...]
    left_out: Mapping[str, str]

    @property
    def disagreement(self) -> float:
        """Largest over smallest estimate; 1 for one alone, infinite where one is 0 or without limit."""
        found = [each.intensity.value for each in self.estimates]
        if len(found) < 2 or min(found) == max(found):
            return 1.0
        return max(found) / min(found) if min(found) > 0 else math.inf


@dataclass(frozen=True)
class WeatherFit:
    """Result of ``fit_weather``.

    Args:
        kind: of the study.
        conditions: in the study's order.
        left_out: condition to the reason why it was not fitted.
        changed: scenes of a camera that are another one in weather than in clear air, with the parts of the picture.
    """

    kind: str
    conditions: tuple[ConditionFit, ...]
    left_out: Mapping[str, str]
    changed: tuple[str, ...] = ()

    def to_dict(self) -> dict[str, Any]:
        """Plain values that JSON can hold: a number that is not finite is text (``inf``, ``nan``)."""
        plain: dict[str, Any] = _plain(asdict(self))
        return plain

    def text(self) -> str:
        """A line for each estimate."""
        lines = [f"warning: {each}" for each in self.changed]
        for one in self.conditions:
            unit = "m" if one.parameter == "mor_m" else "mm/h"
            name = "visibility" if one.parameter == "mor_m" else f"{one.kind} rate"
            lines.append(f"{one.id}: {name}, recorded {one.recorded:.4g} {unit}, {one.frames} frames")
            for each in one.estimates:
                ratio = each.intensity.value / one.recorded if one.recorded else math.nan
                others = "".join(f", {key} {value.value:.3g}" for key, value in each.others.items())
                lack = "" if each.fits else "; the model does not describe these frames"
                lines.append(
                    f"  {each.name:<18} {each.intensity} {unit}, {ratio:.2f} of the record{others}, "
                    f"misfit {each.misfit:.2g}{lack}"
                )
            lines += [f"  {name:<18} left out: {why}" for name, why in one.left_out.items()]
        lines += [f"{name}: left out: {why}" for name, why in self.left_out.items()]
        return "\n".join(lines)


def _plain(value: Any) -> Any:
    if isinstance(value, Mapping):
        return {str(key): _plain(entry) for key, entry in value.items()}
    if isinstance(value, (list, tuple)):
        return [_plain(entry) for entry in value]
    if isinstance(value, float) and not math.isfinite(value):
        return "nan" if math.isnan(value) else "inf" if value > 0 else "-inf"
    return value
