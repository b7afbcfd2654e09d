"""Named snowflake size distributions as functions of the liquid-equivalent snowfall rate."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

import torch

from torchweather.core.arguments import check_arguments, check_broadcast
from torchweather.core.errors import check_at_least, check_one_of
from torchweather.physics.float64 import Quantity, to_float64
from torchweather.physics.precipitation_rate import close_rate
from torchweather.physics.rain_distributions import rate_and_presence
from torchweather.physics.size_distribution import Per
from torchweather.physics.size_distributions import Exponential, Gamma, SizeDistribution
from torchweather.physics.snow_geometry import (
    MELTED_DIAMETER_MAX_MM,
    MELTED_DIAMETER_MIN_MM,
    PHYSICAL_DIAMETER_MAX_MM,
    physical_diameter_mm,
)

__all__ = ["SNOW", "brandes_snow", "brandes_table4", "gunn_marshall", "sekhon_srivastava"]

# Brandes et al. 2007 as D3.4 Table 4 prints them: N0 m^-3 mm^-(1+mu), mu, Lambda 1/mm; keys are rates in mm/h
BRANDES_TABLE4 = {"2.59": (71.8, -0.78, 0.35), "2.70": (1390.0, -0.90, 1.40), "3.03": (2.33e4, 1.23, 2.25)}


def sekhon_srivastava(
    rate_mm_per_h: Quantity,
    *,
    per_size: Per = "diameter",
    diameter_min_mm: float = MELTED_DIAMETER_MIN_MM,
    diameter_max_mm: float = MELTED_DIAMETER_MAX_MM,
) -> Exponential:
    """Snowflakes of Sekhon & Srivastava 1970: ``N = 2500 R^-0.94 exp(-2.29 R^-0.45 D)``, D the *melted* diameter, mm.

    Args:
        rate_mm_per_h: R, liquid equivalent, mm/h, ``(...,)``, 0 or more; may require grad.
        per_size: ``"radius"`` writes the same snow with Rasshofer's doubled N0 (5000 per mm of radius).
        diameter_min_mm: smallest melted diameter, mm.
        diameter_max_mm: largest melted diameter, mm; the default is that of a 20 mm flake.

    Note:
        Carries 1.206 times its nominal rate with the default fall speed on 0..inf, at every rate.

    References:
        PHYSICS.md 2.4 (default); Sekhon & Srivastava 1970.

    Example:
        >>> round(float(sekhon_srivastava(1.0).total_per_m3))
        868
    """
    check_arguments(
        "sekhon_srivastava(rate_mm_per_h: Quantity, diameter_min_mm: float, diameter_max_mm: float)",
        rate_mm_per_h,
        diameter_min_mm,
        diameter_max_mm,
    )
    check_one_of("per_size", per_size, ("radius", "diameter"), owner="sekhon_srivastava")
    rate, present = rate_and_presence(rate_mm_per_h, "sekhon_srivastava")
    intercept = (5000.0 if per_size == "radius" else 2500.0) * rate**-0.94 * present
    return Exponential(
        intercept,
        2.29 * rate**-0.45,
        per_size,
        diameter_min_mm=diameter_min_mm,
        diameter_max_mm=diameter_max_mm,
        particle="melted-flake",
    )


def gunn_marshall(
    rate_mm_per_h: Quantity,
    *,
    per_size: Per = "diameter",
    diameter_min_mm: float = MELTED_DIAMETER_MIN_MM,
    diameter_max_mm: float = MELTED_DIAMETER_MAX_MM,
) -> Exponential:
    """Snowflakes of Gunn & Marshall 1958: ``N = 3800 R^-0.87 exp(-2.55 R^-0.48 D)``, D the *melted* diameter, mm.

    Args:
        rate_mm_per_h: R, liquid equivalent, mm/h, ``(...,)``, 0 or more; may require grad.
        per_size: ``"radius"`` writes the same snow with Rasshofer's doubled N0 (7600 per mm of radius).
        diameter_min_mm: smallest melted diameter, mm.
        diameter_max_mm: largest melted diameter, mm.

    Note:
        Carries 0.88 R at 0.25 mm/h up to 1.59 R at 5 mm/h with the default fall speed.

    References:
        PHYSICS.md 2.4; Gunn & Marshall 1958 (3800 not checked against the primary text).

    Example:
        >>> float(gunn_marshall(1.0).slope_per_mm)
        2.55
    """
    check_arguments(
        "gunn_marshall(rate_mm_per_h: Quantity, diameter_min_mm: float, diameter_max_mm: float)",
        rate_mm_per_h,
        diameter_min_mm,
        diameter_max_mm,
    )
    check_one_of("per_size", per_size, ("radius", "diameter"), owner="gunn_marshall")
    rate, present = rate_and_presence(rate_mm_per_h, "gunn_marshall")
    intercept = (7600.0 if per_size == "radius" else 3800.0) * rate**-0.87 * present
    return Exponential(
        intercept,
        2.55 * rate**-0.48,
        per_size,
        diameter_min_mm=diameter_min_mm,
        diameter_max_mm=diameter_max_mm,
        particle="melted-flake",
    )


def brandes_snow(
    rate_mm_per_h: Quantity,
    temperature_c: Quantity = -5.0,
    *,
    diameter_min_mm: float | None = None,
    diameter_max_mm: float = PHYSICAL_DIAMETER_MAX_MM,
) -> Gamma:
    """Snowflakes of Brandes et al. 2007: gamma in the *physical* diameter, its shape from the temperature.

    ``Lambda = 2.27 (-T)^0.18``, ``mu = -0.00499 Lambda^2 + 0.798 Lambda - 0.666``; N0 is solved so that the flux of ice
    carries the rate (the printed ``N0 = 5000 R^-1.2`` lets the mass fall as the rate rises).

    Args:
        rate_mm_per_h: R, liquid equivalent, mm/h, ``(...,)``, 0 or more; may require grad.
        temperature_c: air temperature, deg C, below 0 (the freezing point is taken as T0); no gradient.
        diameter_min_mm: smallest flake, mm; None is the flake of 0.1 mm melted diameter.
        diameter_max_mm: largest flake, mm.

    References:
        PHYSICS.md 2.4 (Table 3, not verified against the primary text).

    Example:
        >>> from torchweather.physics import precipitation_rate_mm_per_h
        >>> round(float(precipitation_rate_mm_per_h(brandes_snow(2.0, -5.0))), 6)
        2.0
    """
    check_arguments(
        "brandes_snow(rate_mm_per_h: Quantity, temperature_c: Quantity, diameter_min_mm: float | None, "
        "diameter_max_mm: float)",
        rate_mm_per_h,
        temperature_c,
        diameter_min_mm,
        diameter_max_mm,
    )
    check_broadcast("brandes_snow", rate_mm_per_h=rate_mm_per_h, temperature_c=temperature_c)
    rate, present = rate_and_presence(rate_mm_per_h, "brandes_snow")
    check_at_least("-temperature_c", _negated(temperature_c), 0.01, unit="deg C", owner="brandes_snow")
    (below_freezing,) = to_float64(_negated(temperature_c))
    slope = 2.27 * below_freezing.to(rate.device).detach() ** 0.18
    mu = -0.00499 * slope**2 + 0.798 * slope - 0.666
    smallest = float(physical_diameter_mm(MELTED_DIAMETER_MIN_MM)) if diameter_min_mm is None else diameter_min_mm
    unit = Gamma(
        slope.new_ones(()), mu, slope, diameter_min_mm=smallest, diameter_max_mm=diameter_max_mm, particle="flake"
    )
    return close_rate(unit, rate * present)


def _negated(temperature_c: Quantity) -> Quantity:
    (temperature,) = to_float64(temperature_c)
    return -temperature


def brandes_table4(row: str | float) -> Gamma:
    """One of the three measured snowfalls of D3.4 Table 4, in the *physical* diameter, on all sizes.

    Args:
        row: 2.59, 2.70 or 3.03, as text or number: the rate printed with it, mm/h.

    Note:
        Only row 3.03 is consistent with its rate; rows 2.59 and 2.70 describe 0.2-0.3 mm/h at usual fall speeds.

    References:
        PHYSICS.md 2.4; D3.4 Table 4.

    Example:
        >>> round(float(brandes_table4("2.59").total_per_m3), 1)
        375.4
    """
    check_arguments("brandes_table4(row: str | float)", row)
    check_arguments("brandes_table4(row: str | float)", row)
    name = row if isinstance(row, str) else {float(one): one for one in BRANDES_TABLE4}.get(float(row), str(row))
    check_one_of("row", name, BRANDES_TABLE4, owner="brandes_table4")
    intercept, mu, slope = BRANDES_TABLE4[name]
    return Gamma(intercept, mu, slope, particle="flake")


def _brandes_by_rate(rate_mm_per_h: Quantity) -> Gamma:
    return brandes_snow(rate_mm_per_h)


def _table4_by_rate(row: str, rate_mm_per_h: Quantity) -> Gamma:
    """Sizes of a row of Table 4, as many as carry the rate, on the domain of ``brandes_snow``."""
    rate, present = rate_and_presence(rate_mm_per_h, "brandes_table4")
    _, mu, slope = BRANDES_TABLE4[row]
    smallest = float(physical_diameter_mm(MELTED_DIAMETER_MIN_MM))
    ones = torch.ones_like(rate)
    unit = Gamma(
        ones,
        mu * ones,
        slope * ones,
        diameter_min_mm=smallest,
        diameter_max_mm=PHYSICAL_DIAMETER_MAX_MM,
        particle="flake",
    )
    return close_rate(unit, rate * present)


SNOW: dict[str, Callable[[Quantity], SizeDistribution]] = {
    "sekhon-srivastava": sekhon_srivastava,
    "gunn-marshall": gunn_marshall,
    "brandes": _brandes_by_rate,
    **{f"colorado-{row}": partial(_table4_by_rate, row) for row in BRANDES_TABLE4},
}
"""Named snowflake size distributions: name to function of the liquid-equivalent rate in mm/h."""
