"""Error of the form of effects that were found: what their stages leave of what they stand for.

A stage copies an effect to its form: another law of the rain rate, a softer edge, more of it in one statistic than in
another leave a share of its response in a shape that nobody knows. What is added beside an effect must explain more
than that. So the error of its form is a nuisance (model discrepancy, Kennedy & O'Hagan 2001). With the change d of an
entry by the effect, of the statistic along the axis that it belongs to, in a condition c,

    d_form = d (e (a_c + sum_l b_l P_l(t)) + f z),    a_c, b_l, z ~ N(0, 1)

t runs from -1 to 1 over the bins of the axis, the Legendre polynomials P_l are of order 0 to 3 (``form_orders``). Each
statistic along each axis has b of its own, each entry has z of its own; e is ``form_share``, f ``form_entry_share``.

References:
    GAP.md 3 (7).
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import replace

import numpy as np
from numpy.polynomial.legendre import legval
from numpy.typing import NDArray

from torchweather.gap.inference.config import METHOD, NUMERICS
from torchweather.gap.inference.likelihood import SimulatorLikelihood
from torchweather.gap.inference.profiled_conditions import Fit

__all__ = ["beside_form_errors", "fitted_beside_form_errors", "form_columns"]

Floats = NDArray[np.float64]


def beside_form_errors(search: SimulatorLikelihood, fit: Fit, names: Collection[str]) -> Fit:
    """A fit as it is seen where the form of some of its effects is in error.

    Args:
        search: its simulator.
        fit: with effects.
        names: ids of those whose form may be another.

    Returns:
        The same point with a wider scatter, with nuisances for the form behind the others, and the misfit with both.
    """
    changes = [_change(search, fit, name) for name in names]
    wider = {
        target.condition.id: np.sqrt(
            fit.base.sd[target.condition.id] ** 2
            + sum((METHOD.form_entry_share * change[place]) ** 2 for change in changes)
        )
        for place, target in enumerate(search.measured)
    }
    base = replace(fit.base, sd=wider)
    nuisance = search.nuisance_at(fit.nuisance, fit.base, base)
    columns = [
        search.whitened(base, departure)
        for change in changes
        for departure in form_columns(search, METHOD.form_share, change)
    ]
    columns = [one for one in columns if one @ one > NUMERICS.form_least_square]
    residual = search.residual(base)
    with_forms = nuisance.beside(np.stack(columns, 1)) if columns else nuisance
    # What a fit costs beside its residual: a wider scatter, and parameters.
    aside = fit.misfit - search.misfit(fit.residual, fit.nuisance)
    return replace(
        fit, base=base, residual=residual, nuisance=with_forms, misfit=search.misfit(residual, with_forms) + aside
    )


def fitted_beside_form_errors(search: SimulatorLikelihood, wide: Fit, names: Collection[str]) -> Fit:
    """The same with parameters that are fitted where those forms are in error.

    Fitted as if it were exact, a form that is not drags parameters and record to where it departs least.

    Args:
        search: its simulator.
        wide: of ``beside_form_errors``, to begin from.
        names: ids of the effects whose form may be another.
    """
    for _ in range(NUMERICS.reweightings):
        found = search.fit(wide.point, wide.nuisance, wide.base)
        nuisance = found.nuisance.without_behind()
        exact = search.misfit(found.residual, nuisance) - search.misfit(found.residual, found.nuisance)
        seen = beside_form_errors(search, replace(found, nuisance=nuisance, misfit=found.misfit + exact), names)
        gained = wide.misfit - seen.misfit
        wide = min(wide, seen, key=lambda fit: fit.misfit)
        if gained < NUMERICS.converged_chi2:
            break
    return wide


def form_columns(search: SimulatorLikelihood, share: float, change: list[Floats]) -> list[list[Floats]]:
    """Departures by one standard deviation of each way in which a form may be in error.

    Args:
        search: with the layout of the vectors.
        share: e.
        change: of the vector ``(P,)`` by the effect, condition by condition.

    Returns:
        Of each way, the departure ``(P,)`` of each condition.
    """
    layout = search.model.layout
    found = []
    for place in range(len(change)):
        found.append([share * one * (number == place) for number, one in enumerate(change)])
    for group, part in zip(layout.groups, layout.slices, strict=True):
        along = np.linspace(-1.0, 1.0, group.bins) if group.bins > 1 else np.zeros(1)
        for order in range(min(NUMERICS.form_orders, group.bins)):
            modulation = np.zeros(layout.size)
            modulation[part] = share * legval(along, np.eye(NUMERICS.form_orders)[order])
            found.append([one * modulation for one in change])
    return found


def _change(search: SimulatorLikelihood, fit: Fit, name: str) -> list[Floats]:
    """Change of the mean vectors by one effect of a fit where it stands."""
    there, here = (search.mean(point, NUMERICS.screen_frames) for point in (fit.point, fit.point.without(name)))
    return [new - old for new, old in zip(there, here, strict=True)]
