"""find_gap: where simulation and measurement disagree, which effect explains it, and how much is left with it added.

The order of things: a global test (is anything missing?), single effects from response curves, refitted in the
simulator, a second and a third while each earns its place on conditions that it was not fitted to, a verdict. What the
weather record and the mean of the clear frames can explain is never taken for an effect.

References:
    GAP.md 3, 4.
"""

from __future__ import annotations

import math
import time
import warnings
from collections.abc import Callable, Mapping, Sequence
from collections.abc import Set as AbstractSet
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from torchweather.core.errors import TorchweatherError, check_one_of
from torchweather.gap.inference.candidate_fits import (
    Candidate,
    Proposal,
    best_of_each_set,
    best_templates,
    fitted,
    from_rest,
    hidden_templates,
    pairs_from_rest,
    scattering,
    stands_far,
    unscaled_templates,
)
from torchweather.gap.inference.clear_air import ClearAir, clear_air
from torchweather.gap.inference.config import METHOD, NUMERICS
from torchweather.gap.inference.effect_forms import effect_class
from torchweather.gap.inference.global_test import GlobalTest, counted_entries, located_templates, run_global_test
from torchweather.gap.inference.held_out import HeldOut, excess_left, held_out
from torchweather.gap.inference.insensitive_statistics import (
    fresh_delta_chi2,
    gained_elsewhere,
    insensitive_statistics,
    shown_elsewhere,
)
from torchweather.gap.inference.likelihood import Fit, ParameterPoint, SimulatorLikelihood
from torchweather.gap.inference.model_error import explained_beside, response_of
from torchweather.gap.inference.residual_tests import ResidualTest
from torchweather.gap.inference.response_templates import ResponseTemplate, delta_chi2
from torchweather.gap.inference.simulated_distribution import FrameModel, observations
from torchweather.stages.catalogue import EFFECTS

__all__ = ["GapResult", "find_gap_with"]

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class GapResult:
    """Result of the search, before it is put into words.

    Args:
        verdict: ``none``, ``named``, ``named_and_rest`` or ``unknown``.
        fit: at the final parameter point; ``None`` where nothing was fitted.
        rounds: the effects fitted in each round, best first; the first round is of single effects.
        global_test: on the base model.
        before, after: of the held-out conditions.
        left: ``(C P,)`` whitened departure of the fitted conditions at the end.
        search: with the model as it was.
        seconds: that it took.
        clear: how well the clear frames of each scene agree with each other.
    """

    verdict: str
    fit: Fit | None
    rounds: tuple[tuple[Candidate, ...], ...]
    global_test: GlobalTest
    before: HeldOut
    after: HeldOut
    left: Floats
    search: SimulatorLikelihood
    seconds: float
    clear: tuple[ClearAir, ...] = ()

    @property
    def screening(self) -> GlobalTest:
        """The old name of ``global_test``; goes with the next release."""
        text = "GapResult.screening is GapResult.global_test now; the old name goes with the next release."
        warnings.warn(text, DeprecationWarning, stacklevel=2)
        return self.global_test


def find_gap_with(
    model: FrameModel,
    effects: Sequence[str] | None = None,
    seed: int = 0,
    progress: Callable[[str], None] = lambda text: None,
    max_frames: int | None = None,
) -> GapResult:
    """Run the workflow with a model of a sensor's frames."""
    started = time.perf_counter()
    if not model.fit or not model.holdout:
        raise TorchweatherError(
            "find_gap: not enough data to decide: study.yaml: conditions[].split: expected conditions in weather to "
            f"fit to and others held out; got {len(model.fit)} and {len(model.holdout)}. A second rate or a second "
            "scene can be held out."
        )
    for name in effects or ():
        check_one_of("effect", name, model.catalogue, owner="find_gap")
    present = {effect.id for effect in model.effects}
    chosen = [effect_class(model, name) for name in (effects or model.catalogue) if name not in present]
    if not chosen:
        raise TorchweatherError(
            f"find_gap: effects: the model under test has {', '.join(sorted(present))} already; none is left that may "
            "be named. Allow others, or take them out of the model."
        )
    progress("clear frames against clear frames")
    clear = tuple(clear_air(model, seed))
    progress("simulating the conditions as they are")
    search = SimulatorLikelihood(model, observations(model, model.fit), seed, max_frames=max_frames)
    base = search.begin()
    if counted_entries(search) < METHOD.min_entries:
        raise TorchweatherError(
            f"find_gap: not enough data to decide: {counted_entries(search)} statistics hold enough beams to count; "
            f"expected {METHOD.min_entries} or more. Record more frames a condition, or more beams that see a surface."
        )
    progress("response curves")
    global_test = run_global_test(search, chosen, base, seed)
    held = SimulatorLikelihood(model, observations(model, model.holdout), seed + 1)
    before = held_out(held, held.begin(), seed)
    singles: list[Candidate] = []
    if global_test.p_value <= METHOD.alarm_p or stands_far(base.point):
        # What is left open may have moved as far as to look like an effect: candidates are fitted beside it.
        number = NUMERICS.refitted if global_test.p_value <= METHOD.alarm_p else NUMERICS.profiled_beside
        singles = _singles(search, base, global_test, number, progress)
        if global_test.p_value > METHOD.alarm_p:
            # The effect may only have led the nuisances to where they belong: they are profiled from there without it.
            without = search.profile(replace(singles[0].fit.point, values={}))
            least = min(global_test.misfit, search.misfit(without.residual, without.nuisance))
            global_test = global_test.raised(least - singles[0].fit.misfit, singles[0].fit.point.values)
    if global_test.p_value > METHOD.alarm_p:
        left = base.nuisance.left(base.residual)
        return GapResult(
            "none", None, (), global_test, before, before, left, search, time.perf_counter() - started, clear
        )
    rounds = _rounds(search, held, base, global_test, singles, progress)
    best, after = rounds[-1][0].fit, rounds[-1][0].held or before
    verdict = _verdict(global_test, best, before, after, _not_simulated(search, best))
    after = before if verdict == "none" else after  # nothing is added
    left = best.nuisance.left(best.residual)
    candidates = tuple(tuple(one) for one in rounds)
    return GapResult(
        verdict, best, candidates, global_test, before, after, left, search, time.perf_counter() - started, clear
    )


def _singles(
    search: SimulatorLikelihood, base: Fit, global_test: GlobalTest, number: int, progress: Callable[[str], None]
) -> list[Candidate]:
    """So many single effects fitted in the simulator, best first; and those that something left open may stand for."""
    nuisance = base.nuisance
    best = best_templates(global_test.templates, nuisance.left(base.residual), nuisance)[:number]
    promised = {template.id for template, _ in best}
    if stands_far(base.point):
        hidden = hidden_templates(global_test.templates, nuisance, slice(len(search.measured), nuisance.moving))
        hidden = [one for one in hidden[: NUMERICS.hidden_refitted] if one[0].id not in promised]
        rest = [(template, size) for template, size, _ in from_rest(search, base, global_test.templates)]
        rest = rest[: NUMERICS.rest_refitted]
        others = [one for one in (*hidden, *best) if one[0].id not in {template.id for template, _ in rest}]
        best = [*rest, *others][: max(number, len(rest) + 1)]
        promised |= {template.id for template, _ in rest}
    best += unscaled_templates(global_test.templates, best, nuisance.left(base.residual), nuisance)
    found = fitted(
        search,
        base,
        [(search.origin, template, amplitude) for template, amplitude in best],
        global_test.misfit,
        progress,
        number,
    )
    for own, proposal in scattering(search, base, global_test.templates, global_test.threshold):
        promised.add(proposal[1].id)
        found += fitted(search, own, [proposal], global_test.misfit, progress)
    # The better one of what was fitted twice; best first.
    found = list({one.id: one for one in sorted(found, key=lambda one: one.gain)}.values())[::-1]
    # What promised nothing must be better by more than noise gains: what is open has more numbers than most effects.
    least = max((one.gain for one in found if one.id in promised), default=-math.inf) + global_test.threshold
    return [one for one in found if one.id in promised or one.gain > least]


def _rounds(
    search: SimulatorLikelihood,
    held: SimulatorLikelihood,
    base: Fit,
    global_test: GlobalTest,
    singles: list[Candidate],
    progress: Callable[[str], None],
) -> list[list[Candidate]]:
    """Effects fitted, one more in each round while it earns its place; the best of each round first."""
    threshold = global_test.threshold
    rounds = [list(singles)]
    led: set[str] = set()  # effects that have taken the place of one that stood for them
    while True:
        best = rounds[-1][0]
        values = best.fit.point.values
        # What is left open may be told better by either.
        starts = (replace(held.origin, values=values), ParameterPoint(values, open=best.fit.point.open))
        profiled = min((held.profile(start) for start in starts), key=lambda fit: fit.misfit)
        after = held_out(held, profiled, search.seed)
        rounds[-1][0] = best = replace(best, held=after)
        explained = global_test.misfit - best.fit.misfit
        left = best.fit.nuisance.left(best.fit.residual)
        excess = METHOD.residual_explained_share * global_test.residual_test.excess(left)
        significant = global_test.residual_test.p_value(left) < METHOD.residual_p
        least = max(threshold, min(METHOD.added_share_sure * explained, excess if significant else 0.0))
        earlier_held = rounds[-2][0].held if len(rounds) > 1 else None
        if earlier_held is not None and earlier_held.misfit - after.misfit < METHOD.held_gain:
            return rounds[:-1]
        if len(values) == NUMERICS.max_effects or search.exhausted:
            return rounds
        remaining = _remaining_templates(search, global_test, best)
        sure = max(threshold, excess) if significant else math.inf
        pairs: list[Proposal] = []
        if len(rounds) == 1 and not _leaves_noise(global_test, best.fit):
            # While the responses around the base still say something: pairs of any two.
            templates = _beside(search, global_test)
            if templates:
                # Responses are compared with responses: a single that was fitted may have bent a nuisance to its end.
                pairs = pairs_from_rest(search, base, best.fit, templates, threshold)
        fresh, proposed = _on_top(search, remaining, best, least, threshold, sure)
        if remaining and stands_far(best.fit.point):
            hidden = from_rest(search, best.fit, remaining)[: NUMERICS.rest_refitted]
            pairs += [(best.fit.point, template, size) for template, size, gain in hidden if gain >= threshold]
        if pairs:
            proposed = [*(proposed or _best_on_top(best, remaining)), *pairs]
        if not proposed:
            return rounds
        more = _fitted_on_top(search, base, best, remaining, proposed, threshold, progress)
        kept = _that_earn(search, best, more, fresh, least, sure, max(least, excess) if significant else least)
        if not kept:
            return rounds
        needful = _without_idle(search, kept[0], threshold)
        number = len(needful.point.values)
        if number < len(kept[0].fit.point.values) and kept[0].id not in led:
            led.add(kept[0].id)
            earlier = rounds[number - 2][0].fit.misfit if number > 1 else global_test.misfit
            others = [one for one in rounds[number - 1] if one.id != kept[0].id]
            rounds = [*rounds[: number - 1], [Candidate(kept[0].id, needful, earlier - needful.misfit), *others]]
        else:
            rounds.append(kept)


def _that_earn(
    search: SimulatorLikelihood,
    best: Candidate,
    added: Sequence[Candidate],
    fresh: Mapping[str, float],
    least: float,
    sure: float,
    beside_confused: float,
) -> list[Candidate]:
    """Fits with one effect more that earn its place, best first; none that lies far behind one that does.

    Args:
        search: its simulator.
        best: what was found so far.
        added: fits, best first.
        fresh: what those must gain that need not compare with the first (``_on_top``).
        least: what the others must gain, beside a share of what was explained where they act,
        sure: or this, most of a residual that is no noise.
        beside_confused: what an effect must gain that is confused with one of those found: another form of an effect
            than the stage's looks like that, also beside it.
    """
    kept: list[Candidate] = []
    for one in added:
        # What lies far behind one that earned its place is no rival of it.
        if kept and one.fit.misfit > kept[0].fit.misfit + NUMERICS.rival_chi2:
            break
        own = fresh.get(one.id, math.inf)
        if own < sure and gained_elsewhere(search, best.fit, one.fit) < METHOD.fresh_share * one.gain:
            own = sure  # fitted, it does something else than show where those found do nothing
        confused = any(_confusable(one.id, name) for name in best.fit.point.values)
        if _earns(search, best, one, own, beside_confused if confused else least):
            kept.append(one)
    return kept


def _fitted_on_top(
    search: SimulatorLikelihood,
    base: Fit,
    best: Candidate,
    remaining: Sequence[ResponseTemplate],
    proposed: Sequence[Proposal],
    threshold: float,
    progress: Callable[[str], None],
) -> list[Candidate]:
    """Fits of what is proposed, best first. Where none gains what the responses promised, others that promise half of
    what was gained are fitted as well: a response that no longer holds there must not keep them out."""
    nuisance, left = best.fit.nuisance, best.fit.nuisance.left(best.fit.residual)
    found = fitted(search, base, proposed, best.fit.misfit, progress)
    promised = float(delta_chi2(remaining, left[None], nuisance)[0].max()) if remaining else 0.0
    for _ in range(NUMERICS.added_refitted):
        gained = max((one.gain for one in found), default=0.0)
        others = [template for template in remaining if template.id not in {one.id for one in found}]
        if (
            not others
            or search.exhausted
            or gained >= promised
            or delta_chi2(others, left[None], nuisance).max() < max(NUMERICS.refit_share * gained, threshold)
        ):
            break
        template, amplitude = best_templates(others, left, nuisance)[0]
        found += fitted(search, base, [(best.fit.point, template, amplitude)], best.fit.misfit, progress)
    return best_of_each_set(found)


def _without_idle(search: SimulatorLikelihood, added: Candidate, threshold: float) -> Fit:
    """An added effect with those of the others that are needed beside it: a first effect may only have stood for it,
    and explains no more than noise where it is, or was led to where it does nothing."""
    fit = added.fit
    for name, values in added.fit.point.values.items():
        if name == added.id:
            continue
        without = search.fit(fit.point.without(name), fit.nuisance, fit.base)
        nothing = bool(effect_class(search.model, name)(**values).at_identity)
        if nothing or without.misfit - added.fit.misfit < threshold:
            fit = without
    return fit


def _leaves_noise(global_test: GlobalTest, fit: Fit) -> bool:
    """True where a fit leaves what noise may well leave, with nothing that is left open far off."""
    if stands_far(fit.point) or fit.misfit > np.quantile(global_test.misfit_null, 1.0 - METHOD.left_by_noise):
        return False
    return global_test.residual_test.p_value(fit.nuisance.left(fit.residual)) >= METHOD.residual_p


def _earns(search: SimulatorLikelihood, best: Candidate, added: Candidate, fresh: float, least: float) -> bool:
    """True where an added effect gains what it needs: ``fresh``, or ``least`` and a share of what was explained where
    it acts.

    Also over the others fitted again from where they stand beside it: a first effect that was not at its best yet is no
    merit of the second.
    """
    fit = added.fit
    beside = float(explained_beside(search, best.fit, response_of(search, fit, added.id)[None])[0])
    needed = min(fresh, max(least, METHOD.added_share * beside))
    if added.gain < needed:
        return False
    alone = search.fit(fit.point.without(added.id), fit.nuisance, fit.base)
    # What is needed is a share of what the others leave: of less, where they leave less once they are fitted again.
    return alone.misfit - fit.misfit >= needed * min(alone.misfit / best.fit.misfit, 1.0)


def _on_top(
    search: SimulatorLikelihood,
    remaining: Sequence[ResponseTemplate],
    best: Candidate,
    least: float,
    sure: float,
    most: float,
) -> tuple[dict[str, float], list[Proposal]]:
    """Effects that may be fitted on top of one; nothing where no response promises as much as it needs.

    Args:
        search: its simulator.
        remaining: responses to the effects that were not found yet.
        best: what was found so far.
        least: gain that an added effect must promise, and a share of what was explained where it acts,
        sure: or this, if it shows where those found do nothing,
        most: or this, most of a residual that is no noise.

    Returns:
        The effects that need not compare with the first, with what they need: they show where those found do nothing,
        or explain what is left. And what is to be fitted.
    """
    if not remaining:
        return {}, []
    nuisance, left = best.fit.nuisance, best.fit.nuisance.left(best.fit.residual)
    gain = delta_chi2(remaining, left[None], nuisance)[0]
    elsewhere = fresh_delta_chi2(remaining, left, nuisance, insensitive_statistics(search, best.fit))
    fresh = {template.id: most for template, value in zip(remaining, gain, strict=True) if value > most}
    fresh |= dict.fromkeys(shown_elsewhere(remaining, gain, elsewhere, sure), sure)
    # Another form of an effect than the stage's looks like what it is confused with.
    found = best.fit.point.values
    fresh = {name: value for name, value in fresh.items() if not any(_confusable(name, one) for one in found)}
    beside = explained_beside(search, best.fit, np.stack([template.response for template in remaining]))
    if not fresh and (gain < np.maximum(least, METHOD.added_share * beside)).all():
        return fresh, []
    return fresh, _best_on_top(best, remaining, fresh.keys())


def _beside(search: SimulatorLikelihood, global_test: GlobalTest) -> list[ResponseTemplate]:
    """Responses to the effects that may be named beside another."""
    return [template for template in global_test.templates if template.id not in search.model.as_record]


def _remaining_templates(
    search: SimulatorLikelihood, global_test: GlobalTest, best: Candidate
) -> list[ResponseTemplate]:
    """Responses to the effects that were not found yet, in units of the scatter with those that were; where more is
    left than noise, of effects with a place also where most of it is."""
    remaining = [template for template in _beside(search, global_test) if template.id not in best.fit.point.values]
    if not remaining:
        return []
    found = search.templates_at(remaining, best.fit.base)
    if global_test.residual_test.p_value(best.fit.nuisance.left(best.fit.residual)) < METHOD.residual_p:
        found += located_templates(
            search, list(dict.fromkeys(template.grid.effect for template in remaining)), best.fit
        )
    return found


def _best_on_top(
    best: Candidate, remaining: Sequence[ResponseTemplate], fresh: AbstractSet[str] = frozenset()
) -> list[Proposal]:
    """The best templates on top of an effect, and the best one of some effects."""
    nuisance, left = best.fit.nuisance, best.fit.nuisance.left(best.fit.residual)
    added = best_templates(remaining, left, nuisance)[: NUMERICS.added_refitted] if remaining else []
    own = [template for template in remaining if template.id in fresh]
    added += best_templates(own, left, nuisance)[:1] if own else []
    return list(
        {template.id: (best.fit.point, template, amplitude) for template, amplitude in reversed(added)}.values()
    )


def _not_simulated(search: SimulatorLikelihood, fit: Fit) -> NDArray[np.bool_]:
    """Entries ``(C P,)`` that the effects of a fit change in a way that they do not simulate."""
    names = {name for effect in fit.point.values for name in effect_class(search.model, effect).not_simulated}
    return np.tile(search.model.layout.each(lambda group: group.statistic in names), len(search.measured))


def _verdict(
    global_test: GlobalTest,
    fit: Fit,
    before: HeldOut,
    after: HeldOut,
    not_simulated: NDArray[np.bool_] | bool = False,
) -> str:
    """Verdict on effects that were fitted: also on conditions that they were not fitted to.

    Gates of a name: the alarm itself, more than noise gains, held-out conditions that do not speak against it, and a
    share of what departs. What the effects may do that they do not simulate speaks not against them; it is a rest.
    """
    explained = global_test.misfit - fit.misfit
    unexplained = (
        "unknown"
        if global_test.p_value < METHOD.sure_alarm_p or global_test.common_p_value <= METHOD.alarm_p
        else "none"
    )
    if explained < global_test.threshold:
        return unexplained
    if before.misfit - after.misfit < -METHOD.held_loss_share * max(explained - METHOD.sure_gain, 0.0):
        return unexplained
    left = fit.nuisance.left(fit.residual)
    rest_share, share = (
        _share_left(global_test.residual_test, one, explained) for one in (left, np.where(not_simulated, 0.0, left))
    )
    over = (after.gap**2 - after.floor**2) / max(before.gap**2 - before.floor**2, 1e-9)
    far = after.gap > METHOD.unexplained_gap * after.floor
    rest = after.gap > METHOD.residual_gap * after.floor
    held = excess_left(before.gap, after.gap, after.floor)
    if before.gap > METHOD.residual_gap * before.floor and held is not None and held <= METHOD.repaired_share:
        share = 0.0  # a rest, of which held-out conditions show next to nothing
    if share > METHOD.unknown_share or far or (rest and over > METHOD.unexplained_share):
        return "unknown"
    return "named_and_rest" if rest or rest_share > METHOD.rest_share else "named"


def _share_left(test: ResidualTest, left: Floats, explained: float) -> float:
    """Share of what departs that is left beyond chance; 0 where noise may leave it.

    It may not as an alarm has it: in any one condition, or in what all have in common.
    """
    if min(test.p_value(left), test.common_p_value(left)) >= METHOD.residual_p:
        return 0.0
    beyond = test.beyond_chance(left)
    return beyond / max(beyond + explained, 1e-9)


def _confusable(name: str, other: str) -> bool:
    """Check whether the catalogue calls either of two effects confusable with the other."""
    return other in EFFECTS[name].confusable_with or name in EFFECTS[other].confusable_with
