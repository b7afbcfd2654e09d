"""GapReport: the answer of the workflow, as values, as files, and as a transform with the effect added."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from torchweather import __version__
from torchweather.atmosphere.weather import Fog
from torchweather.gap.inference.candidate_fits import Candidate
from torchweather.gap.inference.effect_forms import effect_class
from torchweather.gap.inference.forward_selection import GapResult
from torchweather.gap.inference.held_out import excess_left
from torchweather.gap.inference.likelihood import SimulatorLikelihood
from torchweather.gap.inference.profiled_conditions import Fit
from torchweather.gap.inference.simulated_distribution import Observation, SimulatedDistribution
from torchweather.gap.inference.unknown import unknown
from torchweather.gap.model_file import Additions, read_model, write_model
from torchweather.gap.natural_units import NaturalDeparture, natural_unit
from torchweather.gap.places import Places
from torchweather.gap.statistics.frame_statistics import Group
from torchweather.io import atomic_write
from torchweather.lidar.effects.empirical import Empirical
from torchweather.pipeline.effect import Effect, Parameter
from torchweather.recipes.options import RecipeTransform

__all__ = [
    "BinDeparture",
    "Curve",
    "GapReport",
    "ResidualMap",
    "Response",
    "excess_left",
    "gap_report",
    "read_model",
    "write_model",
]

Floats = NDArray[np.float64]
T = TypeVar("T", bound=RecipeTransform)

FORMAT = "torchweather-gap/1"
CENTRAL_90 = 1.6449  # standard deviations of a normal law
# Least squares knows the noise of the entries, not that of the scatter they are counted in, nor of the clear mean.
WIDENED = 1.5
# Standard deviations of what the form of an effect leaves open: of its strength, and of its parameter's typical size
# where that is a strength and where it says which or where; of a width, a radius or a range also of itself. Set on
# development studies.
FORM, FORM_OF_SCALE = 0.2, (0.01, 0.06)
STANDS_OUT = 4.0  # standard deviations, from which a bin is named
CURVES = 4
RESPONSES = 2  # statistics, of which responses are shown
AXES_OF_ONE = 2  # of one statistic, that are shown
# Share of right names that some tens of development studies were given, rounded: where nothing is left, and where
# something is.
RIGHT = {"named": 0.95, "named_and_rest": 0.8}
AT_BOUND = 1e-3  # of the span of a parameter, within which a value stands at its end
LIKELY = 0.05  # of the best candidate's weight, from which another cannot be excluded
DIGITS = 6  # significant


@dataclass(frozen=True)
class Curve:
    """A statistic along its axis.

    Args:
        statistic, axis: names, with units.
        edges: of the bins.
        condition: of the study.
        before, after: ``(bins,)`` departure of the measurement from the simulation in standard deviations of chance,
            NaN where nothing counts; ``after`` is ``None`` where nothing was added.
        natural: the same in the statistic's own unit; ``None`` where it has none.
    """

    statistic: str
    axis: str
    edges: tuple[float, ...]
    condition: str
    before: Floats
    after: Floats | None
    natural: NaturalDeparture | None = None


@dataclass(frozen=True)
class Response:
    """Response of a statistic to one effect along its axis, beside the measured one.

    Args:
        statistic, axis: names, with units.
        edges: of the bins.
        effect: its id; ``None`` is the measurement.
        values: ``(bins,)`` departure from the simulation as it is, all conditions together, in standard deviations of
            chance; NaN where nothing counts.
        natural: the same in the statistic's own unit, mean over the conditions; ``None`` where it has none.
        unit: of that.
    """

    statistic: str
    axis: str
    edges: tuple[float, ...]
    effect: str | None
    values: Floats
    natural: Floats | None = None
    unit: str = ""


@dataclass(frozen=True)
class BinDeparture:
    """A bin's departure in the statistic's own unit.

    Args:
        value: measured less simulated, the mean over the conditions.
        unit: of it.
        low, high: ends of the bin, in the unit of the axis.
    """

    value: float
    unit: str
    low: float
    high: float


@dataclass(frozen=True)
class ResidualMap:
    """Departure of each statistic in each condition.

    Args:
        groups: (statistic, axis) of each row.
        conditions: ids of the columns.
        before, after: ``(rows, columns)`` root mean square departure over the bins in standard deviations of chance, 1
            in the mean where nothing is missing, NaN where nothing counts; ``after`` is ``None`` where
            nothing was fitted.
        largest: of each row the bin with the largest departure before, all conditions together; ``None`` where nothing
            counts or the statistic has no unit of its own.
    """

    groups: tuple[tuple[str, str], ...]
    conditions: tuple[str, ...]
    before: Floats
    after: Floats | None
    largest: tuple[BinDeparture | None, ...] = ()


@dataclass(frozen=True)
class GapReport:
    """Result of the search.

    Args:
        answer: plain values in the format ``torchweather-gap/1``.
        effects: the stages that were found.
        curves: the statistics that depart most.
        study_sha256: of the study's content.
        empirical: stage that copies what no effect explains, or ``None``.
        responses: of the fitted effects, in the statistics that depart most.
        residuals: of all statistics.
        places: of a frame or a scan that depart.
    """

    answer: Mapping[str, Any]
    effects: tuple[Effect, ...]
    curves: tuple[Curve, ...]
    study_sha256: str
    empirical: Empirical | None = None
    responses: tuple[Response, ...] = ()
    residuals: ResidualMap | None = None
    places: Places | None = None

    @property
    def verdict(self) -> str:
        """``none``, ``named``, ``named_and_rest`` or ``unknown``."""
        return str(self.answer["verdict"])

    def to_dict(self) -> dict[str, Any]:
        """The answer as JSON takes it."""
        found: dict[str, Any] = json.loads(json.dumps(self.answer))
        return found

    def apply(self, model: T, *, empirical: bool = False) -> T:
        """The model with what was found, beside the effects that it has.

        Args:
            model: a transform for the sensor of the study.
            empirical: add the empirical stage as well, which copies what no effect explains; it is valid in the range,
                the weather and the scenes that it was measured in.
        """
        return Additions(self.effects, self.empirical).apply(model, empirical=empirical)

    def write(self, folder: Path) -> None:
        """Write ``gap.json`` and ``model.yaml`` into a folder that exists."""
        with atomic_write(folder / "gap.json") as unfinished:
            unfinished.write_text(json.dumps(self.answer, indent=1, allow_nan=False) + "\n", encoding="utf-8")
        write_model(folder / "model.yaml", self.effects, self.empirical)


def gap_report(result: GapResult, study_sha256: str, seed: int) -> GapReport:
    """The report of a result."""
    found = result.fit if result.verdict in ("named", "named_and_rest") else None
    weights = [_weights(round_, result) for round_ in result.rounds]
    effects = [] if found is None else [_effect(name, found, result, weights) for name in found.point.values]
    _doubt_beside_bounds(effects, result.verdict)
    unexplained = unknown(result) if result.verdict in ("unknown", "named_and_rest") else None
    low = max(0.0, result.after.gap - CENTRAL_90 * result.after.spread)
    answer = {
        "format": FORMAT,
        "verdict": result.verdict,
        "effects": effects,
        "conditions": {
            "fit": [one.id for one in result.search.model.fit],
            "holdout": [one.id for one in result.search.model.holdout],
        },
        "catalogue": list(result.search.model.catalogue),
        "where": _where(result.search, result.search.start),
        "nuisance": _nuisance(result),
        "gap": {
            "before": result.before.gap,
            "after": result.after.gap,
            "floor": result.after.floor,
            "excess_left": excess_left(result.before.gap, result.after.gap, result.after.floor),
            "interval_after": [low, result.after.gap + CENTRAL_90 * result.after.spread],
            "split": "holdout",
        },
        "p_value": result.global_test.p_value,
        "clear_air": [vars(one) for one in result.clear],
        "unknown": None if unexplained is None else unexplained.to_dict(),
        "closest": _closest(result),
        "candidates": _ranked(result.rounds[0], weights[0], result) if result.rounds else [],
        "added": [
            {"beside": _beside(round_), "candidates": _ranked(round_, weight, result)}
            for round_, weight in zip(result.rounds[1:], weights[1:], strict=True)
        ],
        "simulated_frames": result.search.simulated_frames,
        "seconds": result.seconds,
        "seed": seed,
        "version": __version__,
        "study_sha256": study_sha256,
    }
    return GapReport(
        _plain(answer),
        () if found is None else tuple(result.search.catalogue_effects(found.point)),
        tuple(_curves(result)),
        study_sha256,
        None if unexplained is None else unexplained.empirical,
        tuple(_responses(result)),
        _residuals(result),
    )


def _closest(result: GapResult) -> list[dict[str, Any]]:
    """The best that the catalogue has, where that is not what is missing: effects with parameters; none elsewhere."""
    if result.verdict != "unknown" or result.fit is None:
        return []
    return [{"name": name, "parameters": dict(values)} for name, values in result.fit.point.values.items()]


def _ranked(candidates: Sequence[Candidate], weights: Sequence[float], result: GapResult) -> list[dict[str, Any]]:
    """Fitted candidates of a round as plain values, best first."""
    found = []
    for one, weight in zip(candidates, weights, strict=True):
        values = one.fit.point.values.get(one.id, {})
        found.append(
            {
                "name": one.id,
                "gain": one.gain,
                "misfit": one.fit.misfit,
                "weight": weight,
                "parameters": dict(values),
                "at_bound": _at_bound(one.id, one.fit, result, values),
            }
        )
    return found


def _beside(candidates: Sequence[Candidate]) -> list[str]:
    """Effects that all candidates of a round hold beside their own."""
    each = [set(one.fit.point.values) - {one.id} for one in candidates]
    common = set.intersection(*each) if each else set()
    return sorted(common)


def _doubt_beside_bounds(effects: Sequence[dict[str, Any]], verdict: str) -> None:
    """Lower the confidence of effects beside one whose value stands at an end of what is searched.

    What that value would explain beyond the end is left over, as where something else is missing too: the share of
    right names of that verdict counts. ``beside_bound`` has the names.
    """
    for effect in effects:
        beside = [one["name"] for one in effects if one is not effect and one["at_bound"]]
        effect["beside_bound"] = beside
        if beside:
            effect["confidence"] *= RIGHT["named_and_rest"] / RIGHT[verdict]


def _nuisance(result: GapResult) -> dict[str, Any]:
    """Shift of the weather's record.

    ``rate_factor`` is the common factor on the amount of weather: of rates, and of one over the visibility for fog;
    conditions count with the precision of their record. ``by_condition`` has the factor on each recorded rate or
    visibility.
    """
    intensities = result.search.origin.log_intensity if result.fit is None else result.fit.point.log_intensity
    total, weight = 0.0, 0.0
    for target in result.search.measured:
        if target.intensity_sd > 0:
            sign = -1.0 if isinstance(target.condition.weather, Fog) else 1.0
            precision = target.intensity_sd**-2
            total += sign * precision * intensities.get(target.condition.id, 0.0)
            weight += precision
    common = math.exp(total / weight) if weight > 0 else 1.0
    return {"rate_factor": common, "by_condition": {name: math.exp(value) for name, value in intensities.items()}}


def _weights(candidates: Sequence[Candidate], result: GapResult) -> list[float]:
    """Weight of each candidate of a round after its misfit, in units of the noise that is left."""
    misfits = np.array([one.misfit for one in candidates])
    unit = max(1.0, float(misfits.min()) / max(float(result.global_test.misfit_null.mean()), 1.0))
    weight = np.exp(-0.5 * (misfits - misfits.min()) / unit)
    return [float(one) for one in weight / weight.sum()]


def _effect(name: str, fit: Fit, result: GapResult, weights: Sequence[Sequence[float]]) -> dict[str, Any]:
    """An effect of the answer; its confidence is that of the round in which it was found."""
    values = fit.point.values[name]
    interval = {}
    for place, (effect, parameter) in enumerate(fit.names):
        if effect == name:
            declared = next(one for one in effect_class(result.search.model, name).arguments if one.name == parameter)
            value = values[parameter]
            half = CENTRAL_90 * _standard_error(declared, value, float(fit.covariance[place, place]))
            interval[parameter] = [max(declared.low, value - half), min(declared.high, value + half)]
    own = next(number for number, round_ in enumerate(result.rounds) if name in round_[0].fit.point.values)
    confidence = weights[own][0]
    others = [
        rival
        for one, weight in zip(result.rounds[own], weights[own], strict=True)
        for rival in one.fit.point.values
        if rival not in fit.point.values and weight > LIKELY * confidence
    ]
    return {
        "name": name,
        "parameters": dict(values),
        "interval": interval,
        "at_bound": _at_bound(name, fit, result, values),
        "confidence": confidence * RIGHT[result.verdict],
        "confusable_with": list(dict.fromkeys(others)),
    }


def _at_bound(name: str, fit: Fit, result: GapResult, values: Mapping[str, float]) -> dict[str, str]:
    """Fitted parameters that stand at an end of the values that are searched, and at which one: the true value may lie
    beyond it. An end where the effect does nothing is none, nor is one that nothing can exceed: 0, the whole of a
    share, an angle all around."""
    found = {}
    for effect, parameter in fit.names:
        if effect != name:
            continue
        declared = next(one for one in effect_class(result.search.model, name).arguments if one.name == parameter)
        span = declared.high - declared.low
        room = AT_BOUND * (span if math.isfinite(span) else declared.scale)
        ends = {"lowest": declared.low} if declared.low != 0 else {}
        if declared.unit != "1" or declared.high != 1:
            ends["highest"] = declared.high
        for end, bound in ({} if declared.unit == "rad" else ends).items():
            if bound != declared.identity and math.isfinite(bound) and abs(values[parameter] - bound) <= room:
                found[parameter] = end
    return found


def _standard_error(declared: Parameter, value: float, variance: float) -> float:
    """Of a parameter: least squares, widened, and what two implementations of one effect differ by."""
    identity = declared.identity
    if identity is None:
        # The width of a soft edge, or where in a bin of range something stands, is a matter of the form as well.
        other = math.hypot(FORM_OF_SCALE[1] * declared.scale, FORM * value if declared.low >= 0 else 0.0)
    elif math.isinf(identity):
        other = FORM * abs(value)
    else:
        other = math.hypot(FORM * (value - identity), FORM_OF_SCALE[0] * declared.scale)
    return math.hypot(WIDENED * math.sqrt(max(variance, 0.0)), other)


def _departures(search: SimulatorLikelihood, base: SimulatedDistribution) -> dict[str, Floats]:
    found = {}
    for target in search.measured:
        name = target.condition.id
        found[name] = np.where(base.used[name], base.z(target), np.nan)
    return found


def _loudest(search: SimulatorLikelihood, base: SimulatedDistribution) -> list[tuple[float, Group, slice]]:
    """Groups along an axis by their loudest bin over all conditions together, loudest first."""
    each = _departures(search, base)
    layout = search.model.layout
    stacked = np.stack(list(each.values()))
    count = np.maximum(np.isfinite(stacked).sum(0), 1)
    common = np.nansum(stacked, 0) / np.sqrt(count)
    found = [
        (float(np.abs(common[part]).max()), group, part)
        for group, part in zip(layout.groups, layout.slices, strict=True)
    ]
    kept: list[tuple[float, Group, slice]] = []
    for one in sorted(found, key=lambda one: -one[0]):
        if sum(other[1].statistic == one[1].statistic for other in kept) < AXES_OF_ONE:
            kept.append(one)
    return kept


def _where(search: SimulatorLikelihood, base: SimulatedDistribution) -> list[dict[str, Any]]:
    """The bins that stand out, of the loudest groups."""
    each = np.stack(list(_departures(search, base).values()))
    common = np.nansum(each, 0) / np.sqrt(np.maximum(np.isfinite(each).sum(0), 1))
    found = []
    for loudest, group, part in _loudest(search, base)[:CURVES]:
        if loudest < STANDS_OUT:
            break
        place = int(np.abs(common[part]).argmax())
        bin_: dict[str, Any] = {
            "statistic": group.statistic,
            "axis": group.axis,
            "from": group.edges[place],
            "to": group.edges[place + 1],
            "z": float(common[part][place]),
        }
        natural = _averaged_naturally(search, group, part, base)
        if natural is not None:
            bin_ |= {"departure": float(natural[place]), "unit": _unit_text(group)}
        found.append(bin_)
    return found


def _unit_text(group: Group) -> str:
    unit = natural_unit(group)
    return "" if unit is None else unit.text


def _averaged_naturally(
    search: SimulatorLikelihood,
    group: Group,
    part: slice,
    base: SimulatedDistribution,
    other: SimulatedDistribution | None = None,
) -> Floats | None:
    """Mean over the conditions ``(bins,)`` of measured less simulated, or of ``other`` less ``base``, in natural units.

    Conditions count with the precision of their natural values; ``None`` where the statistic has no such unit.
    """
    unit = natural_unit(group)
    if unit is None:
        return None
    total, weight = np.zeros(group.bins), np.zeros(group.bins)
    for target in search.measured:
        name, frames = target.condition.id, target.frames
        mean, scatter = base.mean[name][part], base.total[name][part]
        there = target.vector[part] if other is None else other.mean[name][part]
        sd = 0.5 * np.abs(unit.of(mean + scatter, frames) - unit.of(mean - scatter, frames))
        own = np.where(base.used[name][part] & (sd > 0), np.maximum(sd, 1e-12) ** -2.0, 0.0)
        total += own * np.where(own > 0, unit.of(there, frames) - unit.of(mean, frames), 0.0)
        weight += own
    return np.where(weight > 0, total / np.where(weight > 0, weight, 1.0), np.nan)


def _natural(
    group: Group,
    part: slice,
    target: Observation,
    before: SimulatedDistribution,
    after: SimulatedDistribution | None,
) -> NaturalDeparture | None:
    """A group's departure of one condition in natural units."""
    unit = natural_unit(group)
    if unit is None:
        return None
    name, frames = target.condition.id, target.frames
    used, measured = before.used[name][part], unit.of(target.vector[part], frames)

    def less(base: SimulatedDistribution) -> Floats:
        return np.where(used & base.used[name][part], measured - unit.of(base.mean[name][part], frames), np.nan)

    mean, scatter = before.mean[name][part], before.total[name][part]
    chance = 0.5 * np.abs(unit.of(mean + scatter, frames) - unit.of(mean - scatter, frames))
    return NaturalDeparture(
        unit.text, less(before), None if after is None else less(after), np.where(used, chance, np.nan)
    )


def _curves(result: GapResult) -> list[Curve]:
    search = result.search
    before = _departures(search, search.start)
    after = None if result.fit is None else _departures(search, result.fit.base)
    found = []
    axes = [one for one in _loudest(search, search.start) if one[1].bins > 1]
    for _, group, part in axes[:CURVES]:
        for target in search.measured:
            name = target.condition.id
            later = None if after is None else after[name][part]
            natural = _natural(group, part, target, search.start, None if result.fit is None else result.fit.base)
            found.append(Curve(group.statistic, group.axis, group.edges, name, before[name][part], later, natural))
    return found


def _responses(result: GapResult) -> list[Response]:
    """Responses of the loudest statistics to the effects that were fitted alone, each at its best parameters."""
    search = result.search
    start, names = search.start, [target.condition.id for target in search.measured]
    if not result.rounds:
        return []

    def common(parts: Mapping[str, Floats], part: slice) -> Floats:
        each = np.stack([np.where(start.used[name][part], parts[name][part], np.nan) for name in names])
        count = np.isfinite(each).sum(0)
        return np.where(count > 0, np.nansum(each, 0) / np.sqrt(np.maximum(count, 1)), np.nan)

    found = []
    axes = [one for one in _loudest(search, start) if one[1].bins > 1]
    for _, group, part in axes[:RESPONSES]:
        measured = _averaged_naturally(search, group, part, start)
        seen: list[tuple[str | None, Floats, Floats | None]] = [
            (None, common(_departures(search, start), part), measured)
        ]
        for candidate in result.rounds[0]:
            base = candidate.fit.base
            moved = {name: (base.mean[name] - start.mean[name]) / start.total[name] for name in names}
            seen.append((candidate.id, common(moved, part), _averaged_naturally(search, group, part, start, base)))
        found += [
            Response(group.statistic, group.axis, group.edges, effect, values, natural, _unit_text(group))
            for effect, values, natural in seen
        ]
    return found


def _residuals(result: GapResult) -> ResidualMap:
    """Every statistic in every condition, as the model is and with the best fit."""
    search, layout = result.search, result.search.model.layout

    def of(base: SimulatedDistribution) -> Floats:
        each = _departures(search, base).values()
        found: Floats = np.sqrt([[_mean_square(values[part]) for values in each] for part in layout.slices])
        return found

    groups = tuple((group.statistic, group.axis) for group in layout.groups)
    conditions = tuple(target.condition.id for target in search.measured)
    largest = tuple(_largest(search, group, part) for group, part in zip(layout.groups, layout.slices, strict=True))
    after = None if result.fit is None else of(result.fit.base)
    return ResidualMap(groups, conditions, of(search.start), after, largest)


def _largest(search: SimulatorLikelihood, group: Group, part: slice) -> BinDeparture | None:
    """The bin of a group that departs most, in natural units."""
    natural = _averaged_naturally(search, group, part, search.start)
    if natural is None:
        return None
    each = np.stack([values[part] for values in _departures(search, search.start).values()])
    common = np.where(np.isfinite(natural), np.abs(np.nansum(each, 0)), -1.0)
    place = int(common.argmax())
    if common[place] < 0:
        return None
    return BinDeparture(float(natural[place]), _unit_text(group), group.edges[place], group.edges[place + 1])


def _mean_square(values: Floats) -> float:
    known = values[np.isfinite(values)]
    return float((known**2).mean()) if len(known) else math.nan


def _plain(value: Any) -> Any:
    """Values as JSON has them: six significant digits, infinities as text."""
    if isinstance(value, Mapping):
        return {str(key): _plain(entry) for key, entry in value.items()}
    if isinstance(value, (list, tuple)):
        return [_plain(entry) for entry in value]
    if isinstance(value, float):
        if math.isinf(value) or math.isnan(value):
            return str(value)
        return float(f"{value:.{DIGITS}g}")
    return value
