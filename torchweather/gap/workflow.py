"""find_gap: where simulation and measurement disagree, which effect explains it, and how much is left with it added.

The order of things: screen (is anything missing?), single effects from response curves, refitted in the simulator, a
second and a third while each earns its place on conditions that it was not fitted to, a verdict. What the weather
record and the mean of the clear frames can explain is never taken for an effect.

References:
    GAP.md 3, 4.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from torchweather.errors import TorchweatherError, check_one_of
from torchweather.gap.baseline import FrameModel, targets
from torchweather.gap.candidates import lines
from torchweather.gap.search import Fit, Node, Nuisance, Search, Setting, gains
from torchweather.gap.study import Study
from torchweather.stages.effects import EFFECTS, Effect

__all__ = ["Candidate", "GapResult", "HeldOut", "Screening", "find_gap_with"]

Floats = NDArray[np.float64]

NULLS = 1000
# The numbers below were set by judgement on a handful of studies, not calibrated on a bench.
# Departures of the measurement are not quite Gaussian, and the simulator is not quite the sensor: the thresholds of the
# screening are those of noise so many times larger in square.
OVERDISPERSION = 1.5
ALARM_P = 2e-3
REFITTED = 4  # candidates that are refitted in the simulator
WORTH = 0.35  # of the best gain, from which a candidate is refitted
MOST_EFFECTS = 3
FEWEST_ENTRIES = 30  # statistics that count, over all conditions
FURTHER = 0.03  # of what is explained, that a further effect must add
WORSE = 0.5  # spreads of the held-out floor, by which an effect may make the held-out gap worse
FURTHER_HELD = 0.98  # of the held-out gap, to which it must come down
REST_SHARE, UNKNOWN_SHARE = 0.1, 0.4  # of the excess misfit that is left


@dataclass(frozen=True)
class Candidate:
    """An effect, fitted.

    Args:
        id: of the effect.
        fit: with it and what was found before.
        gain: by which it lowers the misfit.
    """

    id: str
    fit: Fit
    gain: float


@dataclass(frozen=True)
class Screening:
    """Whether anything is missing.

    Args:
        residual: ``(C P,)`` whitened departure of the measured conditions.
        misfit: its square, without what the nuisance explains.
        counted: number of entries.
        nodes: responses.
        gains: ``(nodes,)``.
        best_null: ``(R,)`` largest gain of each null.
        misfit_null: ``(R,)``.
        p_value: of the larger of both departures.
    """

    residual: Floats
    misfit: float
    counted: int
    nodes: tuple[Node, ...]
    gains: Floats
    best_null: Floats
    misfit_null: Floats
    p_value: float


@dataclass(frozen=True)
class HeldOut:
    """The held-out conditions' departure, the weather's record refitted.

    Args:
        gap: its root mean square, in units of the simulator's own scatter.
        floor: that of the simulator from itself.
        spread: standard deviation of that floor from draw to draw.
    """

    gap: float
    floor: float
    spread: float


@dataclass(frozen=True)
class GapResult:
    """What was found, before it is put into words.

    Args:
        verdict: ``none``, ``named``, ``named_and_rest`` or ``unknown``.
        fit: the final setting; ``None`` where nothing was fitted.
        rounds: the effects fitted in each round, best first; the first round is of single effects.
        screening: on the base model.
        before, after: of the held-out conditions.
        left: ``(C P,)`` whitened departure of the fitted conditions at the end.
        search: with the model as it was.
        seconds: that it took.
    """

    verdict: str
    fit: Fit | None
    rounds: tuple[tuple[Candidate, ...], ...]
    screening: Screening
    before: HeldOut
    after: HeldOut
    left: Floats
    search: Search
    seconds: float


def azimuths(search: Search) -> list[float]:
    """Where in azimuth the measurement departs most: two places at which effects with a place are tried."""
    layout = search.model.layout
    total: dict[tuple[float, ...], Floats] = {}
    for target in search.measured:
        z = search.start.z(target)
        for group, part in zip(layout.groups, layout.slices, strict=True):
            if group.axis == "azimuth_rad":
                common = float(np.median(z[part]))
                total.setdefault(group.edges, np.zeros(group.bins))
                total[group.edges] += np.abs(z[part] - common)
    found = []
    for edges, values in total.items():
        middles = 0.5 * (np.asarray(edges[1:]) + np.asarray(edges[:-1]))
        best = np.argsort(-values)
        found += [float(middles[best[0]])]
        apart = [place for place in best[1:] if abs(middles[place] - middles[best[0]]) > 0.6]
        found += [float(middles[apart[0]])] if apart else []
    return found


def screen(search: Search, effects: Sequence[type[Effect]], nuisance: Nuisance, seed: int) -> Screening:
    """Response curves of all effects, and whether any of them, or anything at all, stands out."""
    residual = search.residual(search.start)
    places = azimuths(search)
    found = [line for effect in effects for line in lines(effect, places)]
    nodes = search.nodes(found, search.origin, search.start)
    nulls = search.null_residuals(nuisance, NULLS, seed)
    best_null = gains(nodes, nulls, nuisance).max(1) * OVERDISPERSION
    misfit_null = np.einsum("rk,rk->r", nulls, nuisance(nulls))
    gain = gains(nodes, residual[None], nuisance)[0]
    misfit = float(residual @ nuisance(residual))
    counted = screening_entries(search)
    p_gain = _tail(best_null, float(gain.max()))
    p_misfit = _tail(misfit_null * (1.0 + (OVERDISPERSION - 1.0) * 0.5), misfit)
    return Screening(
        residual, misfit, counted, tuple(nodes), gain, best_null, misfit_null, min(1.0, 2.0 * min(p_gain, p_misfit))
    )


def screening_entries(search: Search) -> int:
    """Number of statistics that hold enough to count, over all conditions."""
    return int(sum(search.start.used[target.condition.id].sum() for target in search.measured))


def _tail(null: Floats, value: float) -> float:
    """Probability that a null exceeds a value: counted, and beyond those by a Gumbel law of their moments."""
    counted = float((null >= value).mean())
    if counted * len(null) >= 20:
        return counted
    scale = float(null.std()) * math.sqrt(6.0) / math.pi
    place = float(null.mean()) - 0.5772156649 * scale
    return float(-np.expm1(-np.exp(-min((value - place) / max(scale, 1e-12), 700.0))))


def find_gap_with(
    model: FrameModel,
    study: Study,
    effects: Sequence[str] | None = None,
    seed: int = 0,
    say: Callable[[str], None] = lambda text: None,
) -> GapResult:
    """Run the workflow with a model of a sensor's frames."""
    started = time.perf_counter()
    fit_conditions = [one for one in study.fit if one.weather is not None]
    held_conditions = [one for one in study.holdout if one.weather is not None]
    if not fit_conditions or not held_conditions:
        raise TorchweatherError(
            f"find_gap: wanted conditions in weather to fit to and others held out; got {len(fit_conditions)} and "
            f"{len(held_conditions)}. A second rate or a second scene can be held out."
        )
    kind = f"{study.kind}."
    known = [name for name in EFFECTS if name.startswith(kind)]
    for name in effects or ():
        check_one_of("effect", name, known, owner="find_gap")
    present = {effect.id for effect in model.effects}
    chosen = [EFFECTS[name] for name in (effects or known) if name not in present]
    say("simulating the conditions as they are")
    search = Search(model, targets(model, fit_conditions), seed)
    search.settle()
    nuisance = search.nuisance(search.origin, search.start)
    if screening_entries(search) < FEWEST_ENTRIES:
        raise TorchweatherError(
            f"find_gap: not enough data to decide: {screening_entries(search)} statistics hold enough beams to count; "
            f"wanted {FEWEST_ENTRIES} or more. More frames a condition, or more beams that see a surface, would tell."
        )
    say("response curves")
    screening = screen(search, chosen, nuisance, seed)
    held = Search(model, targets(model, held_conditions), seed + 1)
    before = _gap(held, Setting())
    if screening.p_value > ALARM_P:
        left = nuisance(screening.residual)
        return GapResult("none", None, (), screening, before, before, left, search, time.perf_counter() - started)
    rounds = [_refitted(search, search.origin, screening.nodes, screening.gains, screening.misfit, say)]
    found = rounds[0][0]
    threshold = float(np.quantile(screening.best_null, 1.0 - ALARM_P))
    after = _gap(held, Setting(found.fit.setting.values))
    best, left, misfit = found.fit, *_left(search, found.fit)
    while len(best.setting.values) < MOST_EFFECTS:
        rest = [node for node in screening.nodes if node.id not in best.setting.values]
        nuisance_here = search.nuisance(best.setting, best.base)
        further = gains(rest, left[None], nuisance_here)[0]
        explained = screening.misfit - misfit
        if further.max() < max(threshold, FURTHER * explained):
            break
        fitted = _refitted(search, best.setting, rest, further, misfit, say)
        more = fitted[0]
        held_after = _gap(held, Setting(more.fit.setting.values))
        if more.gain < max(threshold, FURTHER * explained) or held_after.gap > FURTHER_HELD * after.gap:
            break
        rounds.append(fitted)
        best, after = more.fit, held_after
        left, misfit = _left(search, best)
    verdict = _verdict(screening, misfit, before, after)
    return GapResult(
        verdict, best, tuple(map(tuple, rounds)), screening, before, after, left, search, time.perf_counter() - started
    )


def _refitted(
    search: Search,
    start: Setting,
    nodes: Sequence[Node],
    gain: Floats,
    misfit: float,
    say: Callable[[str], None],
) -> list[Candidate]:
    """The most promising effects, each fitted in the simulator on top of a setting; best first."""
    best: dict[str, tuple[float, Node]] = {}
    for node, value in zip(nodes, gain, strict=True):
        if node.id not in best or value > best[node.id][0]:
            best[node.id] = (float(value), node)
    order = sorted(best.values(), key=lambda pair: -pair[0])
    worth = [pair for pair in order if pair[0] >= WORTH * order[0][0]][:REFITTED]
    found = []
    for _, node in worth:
        say(f"fitting {node.id}")
        values = {**start.values, node.id: dict(node.values)}
        full = {name: _complete(name, given) for name, given in values.items()}
        fit = search.fit(Setting(full, start.log_knob))
        found.append(Candidate(node.id, fit, misfit - fit.misfit))
    return sorted(found, key=lambda candidate: candidate.fit.misfit)


def _complete(name: str, values: Mapping[str, float]) -> dict[str, float]:
    """All parameters of an effect, those not given at their defaults."""
    return {parameter.name: values.get(parameter.name, parameter.value) for parameter in EFFECTS[name].arguments}


def _left(search: Search, fit: Fit) -> tuple[Floats, float]:
    """What a fit leaves: the departure ``(C P,)`` and its square without the nuisance."""
    residual = search.residual(fit.base)
    nuisance = search.nuisance(fit.setting, fit.base)
    return residual, float(residual @ nuisance(residual))


def _gap(held: Search, setting: Setting) -> HeldOut:
    """The held-out departure at a setting of effects."""
    fitted = held.knob_fit(setting)
    names = [target.condition.id for target in held.measured]
    counted = max(sum(int(fitted.base.used[name].sum()) for name in names), 1)
    own: Floats = np.zeros(1)
    for name in names:
        apart = fitted.base.whitened(name, fitted.base.draws[name] - fitted.base.mean[name])
        own = own + (apart**2).sum(1)
    floor = np.sqrt(own / counted)
    gap = math.sqrt(max(fitted.misfit, 0.0) / counted)
    return HeldOut(gap, float(floor.mean()), float(floor.std()))


def _verdict(screening: Screening, misfit: float, before: HeldOut, after: HeldOut) -> str:
    expected = float(screening.misfit_null.mean())
    # The scatter is stated with a margin: a good fit may leave less than a null is said to have.
    left = max(misfit - expected, 0.0)
    share = left / max(screening.misfit - min(expected, misfit), 1e-9)
    if after.gap > before.gap + WORSE * after.spread or share > UNKNOWN_SHARE:
        return "unknown"
    significant = left > 4.0 * float(screening.misfit_null.std()) * OVERDISPERSION
    return "named_and_rest" if significant and share > REST_SHARE else "named"
