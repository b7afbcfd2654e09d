"""Statistics that the effects found so far leave as they were: what shows there is something else.

Another form of an effect than the stage's leaves a residual that many others patch a little, but only where the effect
itself acts. A range that is off is no residual of a wet road.

References:
    GAP.md 3 (7): look at the groups of statistics that the effects leave unchanged.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from torchweather.gap.inference.config import METHOD, SCATTER
from torchweather.gap.inference.likelihood import Fit, SimulatorLikelihood
from torchweather.gap.inference.response_templates import ResponseTemplate, delta_chi2
from torchweather.gap.inference.systematics import Systematics

__all__ = ["fresh_delta_chi2", "gained_elsewhere", "insensitive_statistics", "shown_elsewhere"]

Floats = NDArray[np.float64]


def insensitive_statistics(search: SimulatorLikelihood, fit: Fit) -> NDArray[np.bool_]:
    """Entries ``(C P,)`` of statistics that a fit does not change, compared with the model as it was."""
    layout, start = search.model.layout, search.start
    changed: dict[str, list[Floats]] = {}
    for target in search.measured:
        name = target.condition.id
        apart = (fit.base.mean[name] - start.mean[name]) / start.sd[name]
        for group, part in zip(layout.groups, layout.slices, strict=True):
            changed.setdefault(group.statistic, []).append(apart[part][start.used[name][part]])
    still = {}
    for statistic, parts in changed.items():
        values = np.concatenate(parts)
        still[statistic] = len(values) > 0 and float(np.sqrt((values**2).mean())) < SCATTER.sensitive_rms
    entries = layout.each(lambda group: still[group.statistic])
    return np.tile(entries, len(search.measured))


def fresh_delta_chi2(
    templates: Sequence[ResponseTemplate], left: Floats, nuisance: Systematics, entries: NDArray[np.bool_]
) -> dict[str, float]:
    """Largest gain of each effect in some entries of a residual ``(C P,)`` from which nuisances are taken."""
    nothing = Systematics(np.zeros((len(left), 1)), np.zeros(1), 0)
    masked = [ResponseTemplate(one.grid, one.number, one.values, nuisance(one.response) * entries) for one in templates]
    found: dict[str, float] = {}
    for template, gain in zip(templates, delta_chi2(masked, (left * entries)[None], nothing)[0], strict=True):
        found[template.id] = max(found.get(template.id, 0.0), float(gain))
    return found


def shown_elsewhere(
    templates: Sequence[ResponseTemplate], gain: Floats, elsewhere: Mapping[str, float], least: float
) -> list[str]:
    """Effects that show where those found do nothing: by some gain there, and by no small share of what they gain.

    Args:
        templates: responses to effects that were not found yet.
        gain: ``(templates,)`` of each, of all entries.
        elsewhere: of each effect, its gain where those found do nothing.
        least: that this must be.
    """
    total = dict.fromkeys((template.id for template in templates), 0.0)
    for template, value in zip(templates, gain, strict=True):
        total[template.id] = max(total[template.id], float(value))
    return [name for name, value in elsewhere.items() if value > max(least, METHOD.fresh_share * total[name])]


def gained_elsewhere(search: SimulatorLikelihood, fit: Fit, more: Fit) -> float:
    """Decrease of the squares that are left, by a fit with one effect more, in statistics that the first leaves as they
    were."""
    entries = insensitive_statistics(search, fit)
    before, after = (np.square(one.nuisance.left(one.residual)[entries]).sum() for one in (fit, more))
    return float(before - after)
