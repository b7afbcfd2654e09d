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
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from torchweather.errors import TorchweatherError, check_one_of
from torchweather.gap.baseline import FrameModel, targets
from torchweather.gap.candidates import lines
from torchweather.gap.clear_air import ClearAir, clear_air
from torchweather.gap.placing import placed, standing_lines
from torchweather.gap.search import Fit, Node, Nuisance, Search, Setting, amplitudes, gains, pair_gains
from torchweather.gap.study import Study
from torchweather.stages.effects import EFFECTS, Effect

__all__ = ["Candidate", "GapResult", "HeldOut", "Screening", "find_gap_with"]

Floats = NDArray[np.float64]

Proposal = tuple[Setting, Node, float]
"""A setting, what to put on top of it, and how much of its response is expected."""

NULLS = 1000
# The numbers below were set on some tens of development studies of the bench; no blind set has tried them.
# Departures of the measurement are not quite Gaussian, and the simulator is not quite the sensor: the thresholds of the
# screening are those of noise so many times larger in square.
OVERDISPERSION = 1.5
ALARM_P = 2e-4
REFITTED, FURTHER_REFITTED, PAIRS_REFITTED = 4, 2, 2  # candidates that are fitted: alone, further ones, pairs
# Of a response, squared, that nuisances leave, below which they are fitted anew beside the effect; and where what is
# left open stands so many standard deviations off.
SHADOWED, FAR = (0.3, 0.7), 2.0
SETTLED_ROUNDS = 3  # of that
QUICK, CLOSE = 2, 40.0  # steps of a first fit; misfit over the best one's, up to which it is refined
REFINED = 0.25  # of the best gain, from which all of a response curve is simulated
WORTH = 0.35  # of the best gain, from which a candidate is refitted
MOST_EFFECTS = 3
FEWEST_ENTRIES = 30  # statistics that count, over all conditions
LEAST_AMPLITUDE = 0.1  # of a node's response, at which a fit starts
# Of what is explained, that a further effect must add; and of the misfit that is left, unless it adds more: what
# another form of the first effect leaves is patched a little by many.
FURTHER, FURTHER_SURE, OF_THE_REST = 0.03, 0.1, 0.6
HELD_GAIN = 4.0  # by which an effect must lower the misfit of held-out conditions: two standard deviations
SURE_GAIN, HELD_LOSS = 50.0, 0.1  # misfit explained from which less is asked of held-out ones, by so much of the rest
SURE_P = 1e-6  # of an alarm that is believed although nothing explains it on held-out conditions
REST_SHARE, UNKNOWN_SHARE = 0.1, 0.2  # of the excess misfit that is left
REST_GAP = 1.5  # held-out gap over its floor, from which something else is missing


@dataclass(frozen=True)
class HeldOut:
    """The held-out conditions' departure, the weather's record refitted.

    Args:
        gap: its root mean square, in units of the simulator's own scatter.
        floor: what a perfect model has: noise alone, the nuisances refitted.
        spread: standard deviation of that floor from draw to draw.
        misfit: its square, summed.
    """

    gap: float
    floor: float
    spread: float
    misfit: float


@dataclass(frozen=True)
class Candidate:
    """An effect, fitted.

    Args:
        id: of the effect.
        fit: with it and what was found before.
        gain: by which it lowers the misfit.
        held: departure of the held-out conditions with it, where it was looked at.
    """

    id: str
    fit: Fit
    gain: float
    held: HeldOut | None = None


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
        clear: how well the clear frames of each scene agree with each other.
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
    clear: tuple[ClearAir, ...] = ()


def azimuths(search: Search) -> list[float]:
    """Where in azimuth the measurement departs most: two places at which effects with a place are tried."""
    layout = search.model.layout
    total: dict[tuple[float, ...], Floats] = {}
    for target in search.measured:
        name = target.condition.id
        apart = (target.vector - search.start.mean[name]) / search.start.sd[name]
        z: Floats = np.where(search.start.used[name], apart, 0.0)
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
        elsewhere = [place for place in best[1:] if abs(middles[place] - middles[best[0]]) > 0.6]
        found += [float(middles[elsewhere[0]])] if elsewhere else []
    return found


def screen(search: Search, effects: Sequence[type[Effect]], base: Fit, seed: int) -> Screening:
    """Response curves of all effects, and whether any of them, or anything at all, stands out."""
    residual, nuisance = base.residual, base.nuisance
    places = azimuths(search)
    found = [line for effect in effects for line in lines(effect, places)]
    found += standing_lines(search, effects)
    left = nuisance.left(residual)
    nodes = search.nodes([(line, place) for line in found for place in line.first], search.origin, search.start)
    gain = gains(nodes, left[None], nuisance)[0]
    near = {id(node.line) for node, one in zip(nodes, gain, strict=True) if one >= REFINED * gain.max()}
    rest = [
        (line, place)
        for line in found
        if id(line) in near
        for place in range(len(line.settings))
        if place not in line.first
    ]
    nodes += search.nodes(rest, search.origin, search.start)
    nulls = search.null_residuals(nuisance, NULLS, seed)
    best_null = gains(nodes, nuisance(nulls), nuisance).max(1) * overdispersion(search)
    misfit_null = np.einsum("rk,rk->r", nulls, nuisance(nulls))
    gain = gains(nodes, left[None], nuisance)[0]
    misfit = nuisance.misfit(residual)
    counted = screening_entries(search)
    p_gain = _tail(best_null, float(gain.max()))
    p_misfit = _tail(misfit_null * (1.0 + (overdispersion(search) - 1.0) * 0.5), misfit)
    return Screening(
        residual, misfit, counted, tuple(nodes), gain, best_null, misfit_null, min(1.0, 2.0 * min(p_gain, p_misfit))
    )


def overdispersion(search: Search) -> float:
    """How much larger in square the noise is taken than stated: the fewer clear frames tell it, the more."""
    clear = {target.condition.scene: target.clear_frames for target in search.measured}
    degrees = max(sum(clear.values()) - len(clear), 1)
    return OVERDISPERSION * (1.0 + 2.0 / degrees)


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
            "find_gap: not enough data to decide: study.yaml: conditions[].split: wanted conditions in weather to fit "
            f"to and others held out; got {len(fit_conditions)} and {len(held_conditions)}. A second rate or a second "
            "scene can be held out."
        )
    kind = f"{study.kind}."
    known = [name for name in EFFECTS if name.startswith(kind)]
    for name in effects or ():
        check_one_of("effect", name, known, owner="find_gap")
    present = {effect.id for effect in model.effects}
    chosen = [EFFECTS[name] for name in (effects or known) if name not in present]
    if not chosen:
        raise TorchweatherError(
            f"find_gap: effects: the model under test has {', '.join(sorted(present))} already; none is left that may "
            "be named. Allow others, or take them out of the model."
        )
    say("clear frames against clear frames")
    clear = tuple(clear_air(model, seed))
    say("simulating the conditions as they are")
    search = Search(model, targets(model, fit_conditions), seed)
    base = search.begin()
    if screening_entries(search) < FEWEST_ENTRIES:
        raise TorchweatherError(
            f"find_gap: not enough data to decide: {screening_entries(search)} statistics hold enough beams to count; "
            f"wanted {FEWEST_ENTRIES} or more. More frames a condition, or more beams that see a surface, would tell."
        )
    say("response curves")
    screening = screen(search, chosen, base, seed)
    held = Search(model, targets(model, held_conditions), seed + 1)
    before = _gap(held, held.begin(), seed)
    if screening.p_value > ALARM_P:
        left = base.nuisance.left(base.residual)
        return GapResult(
            "none", None, (), screening, before, before, left, search, time.perf_counter() - started, clear
        )
    rounds = _rounds(search, held, base, screening, before, say)
    best, after = rounds[-1][0].fit, rounds[-1][0].held or before
    verdict = _verdict(screening, best.misfit, before, after)
    after = before if verdict == "none" else after  # nothing is added
    left = best.nuisance.left(best.residual)
    candidates = tuple(tuple(one) for one in rounds)
    return GapResult(
        verdict, best, candidates, screening, before, after, left, search, time.perf_counter() - started, clear
    )


def _rounds(
    search: Search, held: Search, base: Fit, screening: Screening, before: HeldOut, say: Callable[[str], None]
) -> list[list[Candidate]]:
    """Effects fitted, one more in each round while it earns its place; the best of each round first."""
    nodes, nuisance = screening.nodes, base.nuisance
    threshold = float(np.quantile(screening.best_null, 1.0 - ALARM_P))
    left = nuisance.left(base.residual)
    tried = [(search.origin, node, amplitude) for node, amplitude in _best_nodes(nodes, left, nuisance)[:REFITTED]]
    rounds = [_fitted(search, base, tried, screening.misfit, say)]
    held_gap = before
    pairs = pair_gains(nodes, left, nuisance)
    while True:
        best = rounds[-1][0]
        values = best.fit.setting.values
        # What is left open may be told better by either.
        starts = (replace(held.origin, values=values), Setting(values, open=best.fit.setting.open))
        settled = min((held.settle(start) for start in starts), key=lambda fit: fit.misfit)
        after = _gap(held, settled, search.seed)
        rounds[-1][0] = best = replace(best, held=after)
        explained = screening.misfit - best.fit.misfit
        needed = max(
            threshold, FURTHER * explained, min(FURTHER_SURE * explained, OF_THE_REST * _excess(screening, best))
        )
        if len(rounds) > 1 and held_gap.misfit - after.misfit < HELD_GAIN:
            return rounds[:-1]
        held_gap = after
        if len(best.fit.setting.values) == MOST_EFFECTS:
            return rounds
        # On top of the best, and, while the responses around the base still say something, pairs of any two.
        rest = [node for node in nodes if node.id not in best.fit.setting.values]
        if not rest:
            return rounds
        here = best.fit.nuisance
        rest_left = here.left(best.fit.residual)
        worth = bool(gains(rest, rest_left[None], here).max() >= needed)
        further = _best_nodes(rest, rest_left, here)[:FURTHER_REFITTED]
        proposed = [(best.fit.setting, node, amplitude) for node, amplitude in further]
        if len(rounds) == 1:
            found = _best_pairs(nodes, pairs, search.origin, best.gain + needed)
            proposed += found
            worth = worth or bool(found)
        if not worth:
            return rounds
        more = _fitted(search, base, proposed, best.fit.misfit, say)
        if more[0].gain < needed:
            return rounds
        rounds.append(more)


def _excess(screening: Screening, best: Candidate) -> float:
    """Misfit that is left, over what noise is expected to leave."""
    return max(best.fit.misfit - float(screening.misfit_null.mean()), 0.0)


def _best_nodes(nodes: Sequence[Node], left: Floats, nuisance: Nuisance) -> list[tuple[Node, float]]:
    """The best node of each effect that is worth a fit, with its amplitude, best first."""
    gain = gains(nodes, left[None], nuisance)[0]
    amplitude = amplitudes(nodes, left[None], nuisance)[0][0]
    best: dict[str, int] = {}
    for place in np.argsort(-gain):
        best.setdefault(nodes[place].id, int(place))
    worth = [place for place in best.values() if gain[place] >= WORTH * gain.max()]
    return [(nodes[place], float(amplitude[place])) for place in worth]


def _best_pairs(nodes: Sequence[Node], gain: Floats, origin: Setting, least: float) -> list[Proposal]:
    """Pairs of different effects whose responses explain more than ``least`` together, best first."""
    first, second = np.unravel_index(np.argsort(-gain, axis=None), gain.shape)
    found: dict[frozenset[str], Proposal] = {}
    for one, other in zip(first, second, strict=True):
        if gain[one, other] < least or len(found) == PAIRS_REFITTED:
            break
        names = frozenset((nodes[one].id, nodes[other].id))
        if len(names) == 2 and names not in found:
            found[names] = (replace(origin, values={nodes[one].id: _start(nodes[one], 1.0)}), nodes[other], 1.0)
    return list(found.values())


def _fitted(
    search: Search, base: Fit, proposed: Sequence[Proposal], misfit: float, say: Callable[[str], None]
) -> list[Candidate]:
    """Effects fitted in the simulator, each on top of its setting; best first."""
    found = []
    for setting, node, amplitude in proposed:
        say("fitting " + " and ".join([*setting.values, node.id]))
        values = {**setting.values, node.id: _start(node, amplitude)}
        starts = [(replace(setting, values=values), base.nuisance)]
        response = node.response
        far = any(abs(value) > FAR for value in setting.open.values())
        if response @ base.nuisance(response) < SHADOWED[far] * (response @ response):
            # The nuisances have moved to look like the effect while it was not there: let them settle with it.
            settled = _settled_along(search, setting, node, misfit)
            starts.append((settled.setting, settled.nuisance))
        fits = []
        for start, nuisance in starts:
            fits.append(search.fit(placed(search, start, node.id, base), nuisance, base.base, QUICK))
        fit = min(fits, key=lambda one: one.misfit)
        found.append(Candidate(node.id, fit, misfit - fit.misfit))
    least = min(candidate.fit.misfit for candidate in found)
    for place, one in enumerate(found):
        if one.fit.misfit < least + CLOSE:
            say("refining " + " and ".join(one.fit.setting.values))
            fit = search.fit(one.fit.setting, one.fit.nuisance, base.base)
            if fit.misfit < one.fit.misfit:
                found[place] = Candidate(one.id, fit, misfit - fit.misfit)
    return sorted(found, key=lambda candidate: candidate.fit.misfit)


def _settled_along(search: Search, setting: Setting, node: Node, misfit: float) -> Fit:
    """The nuisances settled beside an effect at the best of its weak strengths (the nuisances do not reach as far as a
    strong one), and where a parabola through the misfits has its least.

    Args:
        search: its simulator.
        setting: effects found before.
        node: of the effect.
        misfit: without the effect.
    """

    def settled(values: Mapping[str, float]) -> Fit:
        values = _start(replace(node, values=values), 1.0)
        return search.settle(Setting({**setting.values, node.id: values}), SETTLED_ROUNDS)

    (name,) = [one.name for one in EFFECTS[node.id].arguments if one.identity is not None and one.name in node.values]
    declared = next(one for one in EFFECTS[node.id].arguments if one.name == name)
    # Of either sign: while the nuisances look like the effect, its own may be the wrong one.
    curves = [one for one in lines(node.line.effect, [node.values.get("azimuth_rad", 0.0)]) if name in one.settings[0]]
    strengths = {values[name] for curve in curves for values in curve.settings[: 2 if len(curves) > 1 else 3]}
    found = {strength: settled({**node.values, name: strength}) for strength in sorted(strengths)}
    if declared.identity is not None and math.isfinite(declared.identity):
        places = [declared.identity, *found]
        least = _least(np.array(places), np.array([misfit, *(fit.misfit for fit in found.values())]))
        found[least] = settled({**node.values, name: least})
    return min(found.values(), key=lambda fit: fit.misfit)


def _least(place: Floats, value: Floats) -> float:
    """Where a parabola through the least of some values and its neighbours has its own, not beyond those."""
    order = np.argsort(place)
    place, value = place[order], value[order]
    middle = min(max(int(value.argmin()), 1), len(place) - 2)
    near = slice(middle - 1, middle + 2)
    curvature, slope, _ = np.polyfit(place[near] - place[middle], value[near], 2)
    if curvature <= 0:
        return float(place[value.argmin()])
    return float(np.clip(place[middle] - 0.5 * slope / curvature, place[near][0], place[near][-1]))


def _start(node: Node, amplitude: float) -> dict[str, float]:
    """All parameters where an effect of so many times a node's response is expected."""
    found = {}
    for one in EFFECTS[node.id].arguments:
        value = node.values.get(one.name, one.value)
        if one.identity is not None and math.isfinite(one.identity) and value != one.identity:
            value = one.identity + max(amplitude, LEAST_AMPLITUDE) * (value - one.identity)
        found[one.name] = min(max(value, one.low), one.high) if math.isfinite(value) else value
    return found


def _gap(held: Search, fitted: Fit, seed: int) -> HeldOut:
    """The held-out departure at a setting of effects."""
    counted = max(screening_entries(held), 1)
    nulls = held.null_residuals(fitted.nuisance, NULLS // 5, seed)
    floor = np.sqrt(np.einsum("rk,rk->r", nulls, fitted.nuisance(nulls)) / counted)
    gap = math.sqrt(max(fitted.misfit, 0.0) / counted)
    return HeldOut(gap, float(floor.mean()), float(floor.std()), fitted.misfit)


def _verdict(screening: Screening, misfit: float, before: HeldOut, after: HeldOut) -> str:
    """What is said of effects that were fitted: also on conditions that they were not fitted to.

    Gates of a name: the alarm itself, held-out conditions that it explains, too, and a share of the excess.
    """
    expected = float(screening.misfit_null.mean())
    # The scatter is stated with a margin: a good fit may leave less than a null is said to have.
    left = max(misfit - expected, 0.0)
    share = left / max(screening.misfit - min(expected, misfit), 1e-9)
    explained = screening.misfit - misfit
    # Held-out conditions that hardly show a strong effect must not speak against it by much.
    least = HELD_GAIN - HELD_LOSS * max(explained - SURE_GAIN, 0.0)
    if before.misfit - after.misfit < least:
        return "unknown" if screening.p_value < SURE_P else "none"
    if share > UNKNOWN_SHARE:
        return "unknown"
    significant = left > 4.0 * float(screening.misfit_null.std()) * OVERDISPERSION
    rest = (significant and share > REST_SHARE) or after.gap > REST_GAP * after.floor
    return "named_and_rest" if rest else "named"
