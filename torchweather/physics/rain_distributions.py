"""Named raindrop size distributions as functions of the rain rate."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache, partial

from torch import Tensor

from torchweather.core.arguments import check_arguments
from torchweather.core.errors import check_at_least, check_one_of
from torchweather.physics.float64 import Quantity, to_float64
from torchweather.physics.precipitation_rate import precipitation_rate_mm_per_h
from torchweather.physics.size_distributions import Exponential, ModifiedGamma, SizeDistribution

__all__ = ["DEIRMENDJIAN_RAIN", "JOSS", "RAIN", "deirmendjian_rain", "joss_rain", "marshall_palmer"]

RAIN_DIAMETER_MIN_MM = 0.1  # default domain, PHYSICS.md 2.2
RAIN_DIAMETER_MAX_MM = 8.0

_NEARLY_NO_RAIN_MM_PER_H = 1e-12  # keeps the powers of the rate finite at rate 0, where the number is set to 0


def rate_and_presence(rate_mm_per_h: Quantity, owner: str) -> tuple[Tensor, Tensor]:
    """Rate kept off 0, and 1 where there is precipitation at all, 0 where there is none."""
    check_at_least("rate_mm_per_h", rate_mm_per_h, 0.0, unit="mm/h", owner=owner)
    (rate,) = to_float64(rate_mm_per_h)
    return rate.clamp_min(_NEARLY_NO_RAIN_MM_PER_H), (rate > 0).to(rate.dtype)


def marshall_palmer(
    rate_mm_per_h: Quantity,
    *,
    diameter_min_mm: float = RAIN_DIAMETER_MIN_MM,
    diameter_max_mm: float = RAIN_DIAMETER_MAX_MM,
) -> Exponential:
    """Raindrops of Marshall & Palmer 1948: ``N = 8000 exp(-4.1 R^-0.21 D)`` m^-3 mm^-1, D in mm.

    Args:
        rate_mm_per_h: R, mm/h, ``(...,)``, 0 or more; may require grad. 0 gives no drops.
        diameter_min_mm: smallest drop, mm.
        diameter_max_mm: largest drop, mm.

    Note:
        Measured for 1-25 mm/h. The distribution carries 1.1-1.2 times its nominal rate (``close_rate`` scales that
        away) and has too many small drops at millimetre wavelengths.

    References:
        PHYSICS.md 2.2; Marshall & Palmer 1948. D3.4's domain is 0.5-6 mm.

    Example:
        >>> round(float(marshall_palmer(10.0).total_per_m3))
        2458
    """
    check_arguments(
        "marshall_palmer(rate_mm_per_h: Quantity, diameter_min_mm: float, diameter_max_mm: float)",
        rate_mm_per_h,
        diameter_min_mm,
        diameter_max_mm,
    )
    rate, present = rate_and_presence(rate_mm_per_h, "marshall_palmer")
    return Exponential(
        8000.0 * present,
        4.1 * rate**-0.21,
        diameter_min_mm=diameter_min_mm,
        diameter_max_mm=diameter_max_mm,
    )


# Intercept, m^-3 mm^-1, and slope at 1 mm/h, mm^-1; the slope goes as R^-0.21 as Marshall and Palmer's.
JOSS = {"drizzle": (30000.0, 5.7), "widespread": (7000.0, 4.1), "thunderstorm": (1400.0, 3.0)}
"""Kinds of rain of Joss, Thams & Waldvogel 1968: name to intercept and slope."""


def joss_rain(
    kind: str,
    rate_mm_per_h: Quantity,
    *,
    diameter_min_mm: float = RAIN_DIAMETER_MIN_MM,
    diameter_max_mm: float = RAIN_DIAMETER_MAX_MM,
) -> Exponential:
    """Raindrops of a kind of rain by Joss, Thams & Waldvogel 1968: ``N = N0 exp(-L R^-0.21 D)``.

    Drizzle has many small drops, a thunderstorm few large ones: at one rate its extinction is half of drizzle's.

    Args:
        kind: ``drizzle`` (N0 30,000 m^-3 mm^-1, L 5.7 mm^-1), ``widespread`` (7,000, 4.1) or ``thunderstorm`` (1,400,
            3.0).
        rate_mm_per_h: R, mm/h, ``(...,)``, 0 or more; may require grad. 0 gives no drops.
        diameter_min_mm: smallest drop, mm.
        diameter_max_mm: largest drop, mm.

    References:
        Joss, Thams & Waldvogel 1968, Proc. Int. Conf. on Cloud Physics, 369-373; D3.4 3.1 names the three kinds.

    Example:
        >>> [round(float(joss_rain(kind, 10.0).total_per_m3)) for kind in JOSS]
        [6006, 2150, 629]
    """
    check_one_of("kind", kind, JOSS, owner="joss_rain")
    intercept, slope = JOSS[kind]
    rate, present = rate_and_presence(rate_mm_per_h, "joss_rain")
    return Exponential(
        intercept * present,
        slope * rate**-0.21,
        diameter_min_mm=diameter_min_mm,
        diameter_max_mm=diameter_max_mm,
    )


# Exponent of the radius and mode radius, um, of n(r) ~ r^alpha exp(-b sqrt(r)).
DEIRMENDJIAN_RAIN = {"deirmendjian-rain-l": (2.0, 70.0), "deirmendjian-rain-m": (1.0, 50.0)}
"""Gamma rain of Deirmendjian 1969: name to exponent of the radius and mode radius in um."""


def deirmendjian_rain(
    name: str,
    rate_mm_per_h: Quantity,
    *,
    diameter_min_mm: float = RAIN_DIAMETER_MIN_MM,
    diameter_max_mm: float = RAIN_DIAMETER_MAX_MM,
) -> ModifiedGamma:
    """Raindrops of Deirmendjian's modified gamma, as many as carry the rate.

    The sizes do not change with the rate. Deirmendjian's own 1,000 drops per m^3, of all sizes, carry 2.0 mm/h (rain L)
    and 12 mm/h (rain M).

    Args:
        name: ``deirmendjian-rain-l`` (alpha 2, mode radius 70 um) or ``deirmendjian-rain-m`` (1, 50 um); gamma 1/2.
        rate_mm_per_h: R, mm/h, ``(...,)``, 0 or more; may require grad. 0 gives no drops.
        diameter_min_mm: smallest drop, mm.
        diameter_max_mm: largest drop, mm.

    References:
        Deirmendjian 1969, Electromagnetic Scattering on Spherical Polydispersions, models rain L and rain M. His scale
        (4.98e7, 5.33e5) and b (15.12, 8.944 mm^-1/2) follow from the numbers above. D3.4 names gamma rain after
        Rasshofer et al. 2011, who use this form.

    Example:
        >>> round(float(precipitation_rate_mm_per_h(deirmendjian_rain("deirmendjian-rain-m", 10.0))), 3)
        10.0
    """
    check_arguments(
        "deirmendjian_rain(rate_mm_per_h: Quantity, diameter_min_mm: float, diameter_max_mm: float)",
        rate_mm_per_h,
        diameter_min_mm,
        diameter_max_mm,
    )
    check_one_of("name", name, DEIRMENDJIAN_RAIN, owner="deirmendjian_rain")
    rate, present = rate_and_presence(rate_mm_per_h, "deirmendjian_rain")
    return _deirmendjian_shape(name, diameter_min_mm, diameter_max_mm).scaled(rate * present)


@cache
def _deirmendjian_shape(name: str, diameter_min_mm: float, diameter_max_mm: float) -> ModifiedGamma:
    """The drops of 1 mm/h."""
    alpha, mode_radius_um = DEIRMENDJIAN_RAIN[name]
    shape = ModifiedGamma(
        1.0, alpha, 0.5, mode_radius_um, diameter_min_mm=diameter_min_mm, diameter_max_mm=diameter_max_mm
    )
    return shape.scaled(1.0 / precipitation_rate_mm_per_h(shape))


RAIN: dict[str, Callable[[Quantity], SizeDistribution]] = {
    "marshall-palmer": marshall_palmer,
    **{kind: partial(joss_rain, kind) for kind in JOSS},
    **{name: partial(deirmendjian_rain, name) for name in DEIRMENDJIAN_RAIN},
}
"""Named raindrop size distributions: name to function of the rate in mm/h."""
