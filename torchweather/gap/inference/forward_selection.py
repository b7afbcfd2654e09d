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
from collections.abc import Callable, Sequence
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
    refined,
    scattering,
    stands_far,
    unscaled_templates,
)
from torchweather.gap.inference.clear_air import ClearAir, clear_air
from torchweather.gap.inference.config import METHOD, NUMERICS
from torchweather.gap.inference.effect_forms import effect_class
from torchweather.gap.inference.form_error import beside_form_errors, fitted_beside_form_errors
from torchweather.gap.inference.global_test import GlobalTest, counted_entries, located_templates, run_global_test
from torchweather.gap.inference.held_out import HeldOut, excess_left, held_out
from torchweather.gap.inference.likelihood import SimulatorLikelihood
from torchweather.gap.inference.profiled_conditions import Fit
from torchweather.gap.inference.residual_tests import ResidualTest
from torchweather.gap.inference.response_templates import ResponseTemplate, delta_chi2
from torchweather.gap.inference.simulated_conditions import ParameterPoint
from torchweather.gap.inference.simulated_distribution import FrameModel, observations

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
    if verdict in ("named", "named_and_rest") and _imitates(held, rounds[-1][0], seed):
        verdict = "unknown"
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
    tried: list[Candidate] = []  # fitted in this round, before its effects were found to explain more
    while True:
        best = rounds[-1][0]
        values = best.fit.point.values
        # What is left open may be told better by either.
        starts = (replace(held.origin, values=values), ParameterPoint(values, open=best.fit.point.open))
        profiled = min((held.profile(start) for start in starts), key=lambda fit: fit.misfit)
        after = held_out(held, profiled, search.seed)
        rounds[-1][0] = best = replace(best, held=after, held_fit=profiled)
        earlier_held = rounds[-2][0].held if len(rounds) > 1 else None
        if earlier_held is not None and earlier_held.misfit - after.misfit < METHOD.held_gain:
            return rounds[:-1]
        if len(values) == NUMERICS.max_effects or search.exhausted:
            return rounds
        remaining = _remaining_templates(search, global_test, best)
        wide = beside_form_errors(search, best.fit, values)
        seen = search.templates_at(remaining, wide.base, best.fit.base)
        pairs: list[Proposal] = []
        if len(rounds) == 1 and not tried and not _leaves_noise(global_test, best.fit):
            # While the responses around the base still say something: pairs of any two.
            templates = _beside(search, global_test)
            if templates:
                # Responses are compared with responses: a single that was fitted may have bent a nuisance to its end.
                pairs = pairs_from_rest(search, base, best.fit, templates, threshold)
        proposed = _best_on_top(best, seen, wide) if _promises(seen, wide, threshold) else []
        if remaining and stands_far(best.fit.point):
            hidden = from_rest(search, best.fit, remaining)[: NUMERICS.rest_refitted]
            pairs += [(best.fit.point, template, size) for template, size, gain in hidden if gain >= threshold]
        if pairs:
            proposed = [*(proposed or _best_on_top(best, seen, wide)), *pairs]
        more = list(tried)
        if proposed:
            more += _fitted_on_top(search, base, best, wide, seen, proposed, threshold, progress)
        kept, alone = _that_earn(search, best, wide, best_of_each_set(more), threshold)
        if best.fit.misfit - alone.misfit > max(threshold, NUMERICS.fitted_better_share * best.fit.misfit):
            # Beside another effect they were led to where they explain more by themselves: the round begins again.
            progress("refining " + " and ".join(values))
            rounds[-1][0] = better = _fitted_better(search, best, alone)
            tried = [replace(one, gain=better.fit.misfit - one.fit.misfit) for one in more]
            continue
        if not kept:
            return rounds
        tried = []
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
    search: SimulatorLikelihood, best: Candidate, wide: Fit, added: Sequence[Candidate], threshold: float
) -> tuple[list[Candidate], Fit]:
    """Fits with one effect more that earn its place, best first; none that lies far behind one that does.

    An effect must gain more than noise does, also where the forms of the others are in error: another form of the first
    effect than its stage's is patched a little by many. And over the others fitted again from where they stand beside
    it: a first effect that was not at its best yet is no merit of the second. Where one earns its place, no other is
    fitted that would lie far behind it if the simulator were linear.

    Args:
        search: its simulator.
        best: what was found so far.
        wide: its fit, with the errors of the form of its effects.
        added: fits.
        threshold: gain that noise seldom reaches.

    Returns:
        Those fits, and the best one of the others alone.
    """
    kept: list[Candidate] = []
    others_alone, wide_is_fitted = best.fit, False
    for one in added:
        if one.gain < threshold:
            continue
        others = [name for name in one.fit.point.values if name != one.id]
        seen = beside_form_errors(search, one.fit, others)
        if kept and search.promised(seen) > min(one.misfit for one in kept) + NUMERICS.rival_chi2:
            continue
        earns = wide.misfit - seen.misfit >= threshold
        if earns:
            if not wide_is_fitted:
                wide, wide_is_fitted = fitted_beside_form_errors(search, wide, best.fit.point.values), True
            seen = fitted_beside_form_errors(search, seen, others)
            earns = wide.misfit - seen.misfit >= threshold
        if not earns and one.gain <= NUMERICS.fitted_better_share * best.fit.misfit:
            continue
        alone = search.fit(one.fit.point.without(one.id), one.fit.nuisance, one.fit.base)
        if set(others) == set(best.fit.point.values):
            others_alone = min(others_alone, alone, key=lambda fit: fit.misfit)
        if earns and alone.misfit - one.fit.misfit >= threshold * min(alone.misfit / best.fit.misfit, 1.0):
            kept.append(replace(one, with_forms=seen.misfit))
    kept.sort(key=lambda one: one.misfit)
    return [one for one in kept if one.misfit <= kept[0].misfit + NUMERICS.rival_chi2], others_alone


def _fitted_better(search: SimulatorLikelihood, best: Candidate, found: Fit) -> Candidate:
    """The same effects where another fit has found them to explain more."""
    fit = refined(search, found)
    others = [name for name in fit.point.values if name != best.id]
    with_forms = beside_form_errors(search, fit, others).misfit if others else None
    return Candidate(best.id, fit, best.gain + best.fit.misfit - fit.misfit, with_forms=with_forms)


def _fitted_on_top(
    search: SimulatorLikelihood,
    base: Fit,
    best: Candidate,
    wide: Fit,
    remaining: Sequence[ResponseTemplate],
    proposed: Sequence[Proposal],
    threshold: float,
    progress: Callable[[str], None],
) -> list[Candidate]:
    """Fits of what is proposed, best first. Where none gains what the responses promised, others that promise half of
    what was gained are fitted as well: a response that no longer holds there must not keep them out."""
    nuisance, left = wide.nuisance, wide.nuisance.left(wide.residual)
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
    and explains no more than noise where it is, or was led to where it does nothing. Where the others could not come
    near without it if the simulator were linear, they are not fitted."""
    fit = added.fit
    for name, values in added.fit.point.values.items():
        if name == added.id:
            continue
        needful = added.fit.misfit + threshold
        nothing = bool(effect_class(search.model, name)(**values).at_identity)
        without = fit.point.without(name)
        if not nothing:
            begun = search.fit(without, fit.nuisance, fit.base, 0)
            if search.promised(begun) > needful + NUMERICS.rival_chi2:
                continue
        found = search.fit(without, fit.nuisance, fit.base)
        if nothing or found.misfit < needful:
            fit = found
    return fit


def _leaves_noise(global_test: GlobalTest, fit: Fit) -> bool:
    """True where a fit leaves what noise may well leave, with nothing that is left open far off."""
    if stands_far(fit.point) or fit.misfit > np.quantile(global_test.misfit_null, 1.0 - METHOD.left_by_noise):
        return False
    return global_test.residual_test.p_value(fit.nuisance.left(fit.residual)) >= METHOD.residual_p


def _promises(templates: Sequence[ResponseTemplate], wide: Fit, threshold: float) -> bool:
    """True where a response explains more than noise does of what is left beside the errors of forms."""
    left = wide.nuisance.left(wide.residual)
    return bool(templates) and float(delta_chi2(templates, left[None], wide.nuisance).max()) >= threshold


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


def _best_on_top(best: Candidate, remaining: Sequence[ResponseTemplate], wide: Fit) -> list[Proposal]:
    """The best templates on top of an effect, as they are seen beside the errors of its form."""
    if not remaining:
        return []
    left = wide.nuisance.left(wide.residual)
    added = best_templates(remaining, left, wide.nuisance)[: NUMERICS.added_refitted]
    return [(best.fit.point, template, amplitude) for template, amplitude in added]


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
    share of what departs. What the effects may do that they do not simulate speaks not against them; it is a rest. Nor
    does a held-out gap that noise may well leave, up to ``unexplained_gap`` floors.
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
    rest = after.gap > METHOD.residual_gap * after.floor and after.p_value < METHOD.left_by_noise
    held = excess_left(before.gap, after.gap, after.floor)
    if before.gap > METHOD.residual_gap * before.floor and held is not None and held <= METHOD.repaired_share:
        share = 0.0  # a rest, of which held-out conditions show next to nothing
    if share > METHOD.unknown_share or far or (rest and over > METHOD.unexplained_share):
        return "unknown"
    return "named_and_rest" if rest or rest_share > METHOD.rest_share else "named"


def _imitates(held: SimulatorLikelihood, best: Candidate, seed: int) -> bool:
    """True where as many effects as are searched for leave held-out conditions that depart even if their forms are in
    error, and not by chance: several effects together imitate what the catalogue does not have."""
    if best.held_fit is None or len(best.fit.point.values) < NUMERICS.max_effects:
        return False
    seen = held_out(held, beside_form_errors(held, best.held_fit, best.fit.point.values), seed)
    return seen.gap > METHOD.residual_gap * seen.floor and seen.p_value < METHOD.left_by_noise


def _share_left(test: ResidualTest, left: Floats, explained: float) -> float:
    """Share of what departs that is left beyond chance; 0 where noise may leave it.

    It may not as an alarm has it: in any one condition, or in what all have in common.
    """
    if min(test.p_value(left), test.common_p_value(left)) >= METHOD.residual_p:
        return 0.0
    beyond = test.beyond_chance(left)
    return beyond / max(beyond + explained, 1e-9)
