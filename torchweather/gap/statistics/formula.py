"""The simplest formula that describes a curve of values with known errors over bins.

Each formula is fitted by weighted least squares; what a bin holds is the formula's mean over the bin, not its value in
the middle. The formula with the least

    chi2 + K ln n + 2 ln(choices)

is taken, the simplest of those that are nearly as good: the Bayesian information criterion of K parameters and n bins,
and what it costs to have chosen one formula (one frequency, one place of a step) among so many. Without the last term
one of many flexible formulas fits noise.

References:
    GAP.md 3 (9). Schwarz 1978 (the criterion); Foster & George 1994 (the cost of a choice); Kass & Raftery 1995 (a
    difference below 2 says next to nothing).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.special import chdtrc

from torchweather.gap.inference.config import NUMERICS

__all__ = ["Formula", "bounded", "simplest_formula"]

Floats = NDArray[np.float64]

NOTHING = 1e-12  # a coefficient that is 0 but for rounding
# Lengths over the width of the axis, and exponents that one would write down.
LENGTHS = np.geomspace(0.02, 2.0, 40)
EXPONENTS = tuple(b / 4.0 for b in range(-12, 13) if b not in (0, 4))
# From the simplest on.
SIMPLICITY = ("constant", "linear", "logarithm", "power", "exponential_approach", "quadratic", "step", "sine")


@dataclass(frozen=True)
class Formula:
    """A formula of a curve.

    Args:
        name: ``constant``, ``linear``, ``logarithm``, ``quadratic``, ``exponential_approach``, ``power``, ``step`` or
            ``sine``.
        text: with its numbers, such as ``-0.021 + 0.0043 range_m``.
        parameters: by name.
        chi2_per_dof: about 1 where the formula describes the curve within its errors.
        criterion: by which it was chosen.
        values: ``(bins,)`` its mean over each bin.
    """

    name: str
    text: str
    parameters: Mapping[str, float]
    chi2_per_dof: float
    criterion: float
    values: Floats


@dataclass(frozen=True)
class _Form:
    """One shape, linear in all that is fitted.

    Args:
        name, names: of the formula and of its coefficients.
        terms: ``(bins, points)`` coordinates to the terms ``(bins, points, coefficients)``.
        fixed: other parameters, by name.
        searched: number of fixed parameters that were fitted by trying.
        choices: among which it is one.
        written: coefficients to text.
    """

    name: str
    names: tuple[str, ...]
    terms: Callable[[Floats], Floats]
    written: Callable[[Sequence[float]], str]
    fixed: Mapping[str, float]
    searched: int
    choices: int


def bounded(edges: ArrayLike) -> Floats:
    """Edges of bins, the outermost moved in where an end bin has no end: it then is as wide as its neighbour.

    Args:
        edges: ``(bins + 1,)`` rising.

    Example:
        >>> bounded([0.0, 10.0, 20.0, 1000.0]).tolist()
        [0.0, 10.0, 20.0, 30.0]
    """
    found = np.array(edges, dtype=np.float64)
    width = np.diff(found)
    if len(width) > 2:
        if width[-1] > NUMERICS.formula_open_bin_ratio * width[-2]:
            found[-1] = found[-2] + width[-2]
        if width[0] > NUMERICS.formula_open_bin_ratio * width[1]:
            found[0] = found[1] - width[1]
    return found


def simplest_formula(edges: ArrayLike, value: ArrayLike, sd: ArrayLike, axis: str = "x") -> Formula | None:
    """The simplest formula that describes a curve; ``None`` where none of them does.

    Args:
        edges: ``(bins + 1,)`` of the bins.
        value: ``(bins,)`` mean over each bin; NaN where it is not known.
        sd: ``(bins,)`` its standard deviation, above 0.
        axis: name of the coordinate, as the text shall call it; one with ``azimuth_rad`` in it may follow a sine.

    Example:
        >>> found = simplest_formula([0, 1, 2, 3, 4], [0.5, 1.5, 2.5, 3.5], [0.1] * 4, "range_m")
        >>> found.name, found.text
        ('linear', '0 + 1 range_m')
    """
    ends, y, error = bounded(edges), np.asarray(value, dtype=np.float64), np.asarray(sd, dtype=np.float64)
    known = np.isfinite(y)
    share = (np.arange(NUMERICS.formula_points) + 0.5) / NUMERICS.formula_points
    points = ends[:-1, None] + np.diff(ends)[:, None] * share
    found = []
    for form in _forms(axis, points, ends, known):
        fitted = _fitted(form, points, y, error, known)
        if fitted is not None:
            found.append(fitted)
    good = [
        one
        for one, probability, left in found
        if probability >= NUMERICS.formula_fits_p or left <= NUMERICS.formula_leaves_share
    ]
    least = min((one.criterion for one in good), default=0.0)
    near = [one for one in good if one.criterion <= least + NUMERICS.formula_criterion_gap]
    return min(near, key=lambda one: (SIMPLICITY.index(one.name), one.criterion), default=None)


def _fitted(
    form: _Form, points: Floats, y: Floats, error: Floats, known: NDArray[np.bool_]
) -> tuple[Formula, float, float] | None:
    """A form with its best coefficients, the probability of a chi2 as large, and the share of the square it leaves."""
    design = form.terms(points).mean(1)
    fitted, free = design[known], len(form.names) + form.searched
    n = int(known.sum())
    if n < max(free, 1) or (n == free and n > 1):
        return None
    scaled = fitted / error[known, None]
    norm = np.linalg.norm(scaled, axis=0)
    if not np.all(norm > 0):
        return None
    left, size, right = np.linalg.svd(scaled / norm, full_matrices=False)
    if size[-1] < NUMERICS.formula_singular_share * size[0]:
        return None
    coefficients = right.T @ (left.T @ (y[known] / error[known]) / size) / norm
    chi2 = float((((fitted @ coefficients - y[known]) / error[known]) ** 2).sum())
    dof = n - free
    probability = float(chdtrc(dof, chi2)) if dof > 0 else 1.0
    parameters = {**dict(zip(form.names, map(float, coefficients), strict=True)), **form.fixed}
    return (
        Formula(
            form.name,
            form.written([float(one) for one in coefficients]),
            _polar(parameters) if form.name == "sine" else parameters,
            chi2 / max(dof, 1),
            chi2 + free * math.log(n) + 2.0 * math.log(form.choices),
            design @ coefficients,
        ),
        probability,
        chi2 / max(float(((y[known] / error[known]) ** 2).sum()), 1e-300),
    )


def _forms(axis: str, points: Floats, ends: Floats, known: NDArray[np.bool_]) -> Iterator[_Form]:
    """All shapes that the axis allows."""
    positive, periodic = bool((points > 0).all()), "azimuth_rad" in axis
    kinds = 3 + 3 * positive + 2 * periodic  # beside the constant
    yield _Form("constant", ("value",), lambda x: _stack(np.ones_like(x)), lambda c: _number(c[0]), {}, 0, 1)
    two = ("offset", "slope")
    yield _Form(
        "linear", two, lambda x: _stack(np.ones_like(x), x), lambda c: _sum((c[0], ""), (c[1], axis)), {}, 0, kinds
    )
    yield _Form(
        "quadratic",
        ("offset", "slope", "curvature"),
        lambda x: _stack(np.ones_like(x), x, x * x),
        lambda c: _sum((c[0], ""), (c[1], axis), (c[2], f"{axis}^2")),
        {},
        0,
        kinds,
    )
    if positive:
        yield _Form(
            "logarithm",
            two,
            lambda x: _stack(np.ones_like(x), np.log(x)),
            lambda c: _sum((c[0], ""), (c[1], f"ln {axis}")),
            {},
            0,
            kinds,
        )
        for exponent in EXPONENTS:
            yield _power(axis, exponent, kinds)
        for length in LENGTHS * float(points.max()):
            yield _approach(axis, float(length), kinds)
    inner = np.flatnonzero(known)
    for place in inner[1:]:
        yield _step(axis, float(ends[place]), kinds * max(len(inner) - 1, 1))
    if periodic:
        # More than half as many waves as bins cannot be told from fewer.
        most = min(NUMERICS.formula_max_frequencies, (int(known.sum()) - 1) // 2)
        for times in range(1, most + 1):
            yield _sine(axis, times, kinds * most, offset=False)
            yield _sine(axis, times, kinds * most, offset=True)


def _power(axis: str, exponent: float, kinds: int) -> _Form:
    return _Form(
        "power",
        ("factor",),
        lambda x: _stack(x**exponent),
        lambda c: f"{_number(c[0])} {axis}^{_number(exponent)}",
        {"exponent": exponent},
        1,
        kinds,
    )


def _approach(axis: str, length: float, kinds: int) -> _Form:
    return _Form(
        "exponential_approach",
        ("limit",),
        lambda x: _stack(-np.expm1(-x / length)),
        lambda c: f"{_number(c[0])} (1 - exp(-{axis} / {_number(length)}))",
        {"length": length},
        1,
        kinds,
    )


def _step(axis: str, place: float, choices: int) -> _Form:
    return _Form(
        "step",
        ("below", "above"),
        lambda x: _stack((x < place).astype(float), (x >= place).astype(float)),
        lambda c: f"{_number(c[0])} below {axis} = {_number(place)}, {_number(c[1])} above",
        {"at": place},
        0,
        choices,
    )


def _sine(axis: str, times: int, choices: int, *, offset: bool) -> _Form:
    def terms(x: Floats) -> Floats:
        waves = (np.sin(times * x), np.cos(times * x))
        return _stack(*waves, np.ones_like(x)) if offset else _stack(*waves)

    def written(c: Sequence[float]) -> str:
        size, phase = math.hypot(c[0], c[1]), math.atan2(c[1], c[0])
        angle = axis if times == 1 else f"{times} {axis}"
        sign = "-" if phase < 0 else "+"
        wave = f"{_number(size)} sin({angle} {sign} {_number(abs(phase))})"
        return f"{_number(c[2])} + {wave}" if offset else wave

    names = ("sine", "cosine", "offset") if offset else ("sine", "cosine")
    return _Form("sine", names, terms, written, {"times": float(times)}, 0, choices)


def _polar(parameters: Mapping[str, float]) -> dict[str, float]:
    """Amplitude and phase of a sine instead of its two parts."""
    kept = {name: value for name, value in parameters.items() if name not in ("sine", "cosine")}
    sine, cosine = parameters["sine"], parameters["cosine"]
    return {"amplitude": math.hypot(sine, cosine), "phase_rad": math.atan2(cosine, sine), **kept}


def _stack(*terms: Floats) -> Floats:
    return np.stack(terms, -1)


def _number(value: float) -> str:
    """Three significant digits."""
    return f"{value:.3g}" if abs(value) > NOTHING else "0"


def _sum(*terms: tuple[float, str]) -> str:
    """Coefficients with what they multiply."""
    text = ""
    for coefficient, name in terms:
        negative = coefficient < -NOTHING  # rounding has no sign
        sign = ("- " if negative else "+ ") if text else ("-" if negative else "")
        part = f"{_number(abs(coefficient))} {name}".strip()
        text = f"{text} {sign}{part}" if text else f"{sign}{part}"
    return text
