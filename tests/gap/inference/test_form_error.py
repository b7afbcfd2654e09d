"""Error of the form of effects that were found: what it explains, and what it does not."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from tests.gap.linear_simulator import BINS, DIRECTIONS, LinearSimulator, effect, strength_of
from torchweather.gap.inference import form_error
from torchweather.gap.inference.config import METHOD
from torchweather.gap.inference.form_error import beside_form_errors, fitted_beside_form_errors, form_columns
from torchweather.gap.inference.likelihood import SimulatorLikelihood
from torchweather.gap.inference.profiled_conditions import Fit
from torchweather.gap.inference.simulated_conditions import ParameterPoint
from torchweather.gap.inference.simulated_distribution import observations
from torchweather.gap.statistics.frame_statistics import Group, Layout

WINDOW, EXTINCTION, *_ = DIRECTIONS
STRENGTH = 4.0


def fitted(search: SimulatorLikelihood) -> Fit:
    base = search.begin()
    return search.fit(ParameterPoint({WINDOW: {DIRECTIONS[WINDOW][0]: STRENGTH}}), base.nuisance, base.base)


def search_of(added: Any = 0.0) -> SimulatorLikelihood:
    """A window of strength 4 is hidden; ``added`` (C, P) to the measured vectors."""
    model = LinearSimulator([effect(WINDOW, STRENGTH)])
    measured = observations(model, model.fit)
    added = np.broadcast_to(added, (len(measured), model.layout.size))
    moved = [replace(one, vector=one.vector + own) for one, own in zip(measured, added, strict=True)]
    return SimulatorLikelihood(model, moved, 0)


def change() -> Any:
    """What the window does to the vector."""
    return LinearSimulator().added([effect(WINDOW, STRENGTH)])


def left(search: SimulatorLikelihood) -> tuple[float, float]:
    """Misfit of a window, without and with the errors of its form."""
    fit = fitted(search)
    return fit.misfit, beside_form_errors(search, fit, [WINDOW]).misfit


@pytest.mark.parametrize("entry_share", [0.0, METHOD.form_entry_share])
def test_another_form_of_the_effect_is_explained_and_what_acts_elsewhere_is_not(
    monkeypatch: pytest.MonkeyPatch, entry_share: float
) -> None:
    """A tilt of 30 % along the axis, and the same squares where the window does nothing; a tilt needs no error of each
    entry by itself."""
    monkeypatch.setattr(form_error, "METHOD", replace(METHOD, form_entry_share=entry_share))
    own = change()
    tilt = np.tile(np.linspace(-0.3, 0.3, BINS), len(own) // BINS) * own
    elsewhere = np.zeros_like(own)
    elsewhere[np.flatnonzero(own == 0.0)[:8]] = np.sqrt((tilt**2).sum() / 8.0)
    plain, with_forms = left(search_of())
    assert plain - with_forms < 30.0  # noise: as many columns have next to nothing to explain
    of_tilt, of_elsewhere = left(search_of(tilt)), left(search_of(elsewhere))
    assert min(of_tilt[0], of_elsewhere[0]) > plain + 300.0
    assert of_tilt[1] < with_forms + 0.1 * (of_tilt[0] - plain)
    assert of_elsewhere[1] > with_forms + 0.9 * (of_elsewhere[0] - plain)


def test_a_form_is_not_so_wrong_as_to_stand_for_anything() -> None:
    """Half of the effect with alternating signs from bin to bin: an entry by itself is off by a tenth."""
    own = change()
    rough = 0.5 * own * np.where(np.arange(len(own)) % 2 == 0, 1.0, -1.0)
    assert left(search_of(rough))[1] > left(search_of())[1] + 30.0
    assert METHOD.form_entry_share == 0.1


def test_a_form_that_is_wrong_drags_nothing_where_its_error_is_fitted_beside() -> None:
    """A window tilted by 60 % along its axis, and an extinction that moves a third of its bins as well."""
    model = LinearSimulator([effect(WINDOW, STRENGTH), effect(EXTINCTION, 1.0)])
    own = change()
    tilt = np.tile(np.linspace(-0.6, 0.6, BINS), len(own) // BINS) * own
    moved = [replace(one, vector=one.vector + tilt) for one in observations(model, model.fit)]
    search = SimulatorLikelihood(model, moved, 0)
    base = search.begin()
    start = {WINDOW: {DIRECTIONS[WINDOW][0]: STRENGTH}, EXTINCTION: {DIRECTIONS[EXTINCTION][0]: 2.0}}
    fit = search.fit(ParameterPoint(start), base.nuisance, base.base)
    wide = beside_form_errors(search, fit, [WINDOW])
    again = fitted_beside_form_errors(search, wide, [WINDOW])

    def off(one: Fit) -> float:
        return abs(strength_of(EXTINCTION, one.point.values[EXTINCTION]) - 1.0)

    assert off(fit) > 0.1
    assert off(again) < 0.5 * off(fit)
    assert again.misfit < wide.misfit
    # The errors of the form are those of the new point: as many, and none stands behind others.
    assert again.nuisance.behind == wide.nuisance.behind > 0
    assert again.nuisance.response.shape == wide.nuisance.response.shape


@pytest.mark.parametrize("names", [[], [WINDOW]])
def test_without_effects_nothing_changes(names: list[str]) -> None:
    search = search_of()
    fit = fitted(search)
    seen = beside_form_errors(search, fit, names)
    assert seen.point == fit.point
    assert (seen.misfit == pytest.approx(fit.misfit, rel=1e-9)) == (not names)
    known = fit.nuisance.response.shape[1]
    assert seen.nuisance.response.shape[1] == known or names
    assert seen.nuisance.moving == fit.nuisance.moving


def test_the_ways_of_a_form_are_those_of_the_page() -> None:
    """Each condition; each statistic along each axis, with polynomials as far as it has bins."""
    groups = Group("one", "x", "mean", (0.0, 1.0, 2.0, 3.0, 4.0, 5.0)), Group("other", "y", "share", (0.0, 1.0))
    layout = Layout(groups, (), (), ())
    search: Any = SimpleNamespace(model=SimpleNamespace(layout=layout))
    changes = [np.arange(1.0, 7.0), -np.ones(6)]
    found = form_columns(search, 0.2, changes)
    assert len(found) == 2 + 4 + 1
    np.testing.assert_allclose(found[0], [0.2 * changes[0], np.zeros(6)])
    np.testing.assert_allclose(found[1], [np.zeros(6), 0.2 * changes[1]])
    t = np.array([-1.0, -0.5, 0.0, 0.5, 1.0])
    legendre = [np.ones(5), t, 0.5 * (3.0 * t**2 - 1.0), 0.5 * (5.0 * t**3 - 3.0 * t)]
    for way, polynomial in zip(found[2:6], legendre, strict=True):
        for departure, one in zip(way, changes, strict=True):
            np.testing.assert_allclose(departure, 0.2 * one * np.append(polynomial, 0.0), atol=1e-12)
    np.testing.assert_allclose(found[6], [0.2 * one * np.append(np.zeros(5), 1.0) for one in changes])
