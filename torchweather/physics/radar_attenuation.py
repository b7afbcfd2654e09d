"""Attenuation of a radar signal by rain, fog and snow: specific attenuation, dB/km one way, model by model."""

from __future__ import annotations

from torch import Tensor

from torchweather.core.arguments import check_arguments, check_broadcast
from torchweather.core.errors import InputValueError, check_at_least, check_between, check_one_of, check_positive
from torchweather.physics.float64 import Quantity, to_float64
from torchweather.physics.radar_scattering import particle_attenuation_db_per_km
from torchweather.physics.rain_attenuation import rain_attenuation_p838_db_per_km
from torchweather.physics.rain_distributions import marshall_palmer
from torchweather.physics.refractive_index import water_permittivity_microwave
from torchweather.physics.snow_distributions import sekhon_srivastava

__all__ = [
    "RAIN_ATTENUATION_MODELS",
    "SNOW_ATTENUATION_MODELS",
    "fog_attenuation_coefficient_db_per_km_per_g_per_m3",
    "fog_attenuation_db_per_km",
    "rain_attenuation_db_per_km",
    "snow_attenuation_db_per_km",
]

RAIN_ATTENUATION_MODELS = ("p838", "dsd_mie", "d3_4")
SNOW_ATTENUATION_MODELS = ("dsd_mie", "d3_4")

SANDER_1975 = (1.07, 0.69)  # dB/km at R^0.69, measured near 91 GHz, used at 77 GHz by D3.4; PHYSICS.md 6.5
NOROUZIARI_2018 = 0.8205  # dB/km per mm/h, a low-THz measurement used at 77 GHz by D3.4; PHYSICS.md 6.7
# The recommendation states its Rayleigh form up to 200 GHz; below 1 GHz the permittivity of water is not given.
P840_RANGE_GHZ = (1.0, 200.0)
LIEBE_AS_PUBLISHED = 0.182  # D3.4's "0.182 LWC f^2"; PHYSICS.md 6.6


def rain_attenuation_db_per_km(
    rate_mm_per_h: Quantity,
    frequency_ghz: float = 77.0,
    *,
    model: str = "p838",
    temperature_c: float = 10.0,
    polarisation_tilt_rad: float = 0.0,
    elevation_rad: float = 0.0,
) -> Tensor:
    """Attenuation of rain, dB/km one way.

    Args:
        rate_mm_per_h: R, mm/h, 0 or more, any shape; may require grad.
        frequency_ghz: GHz, 1-1000; ``"d3_4"`` does not look at it.
        model: ``"p838"`` (ITU-R P.838-3, default); ``"dsd_mie"`` (Mie over Marshall-Palmer, 23-27 % above P.838 at
            77 GHz); ``"d3_4"`` (Sander's ``1.07 R^0.69`` as D3.4 uses it at 77 GHz, for 77 GHz only).
        temperature_c: of the water (``dsd_mie`` only).
        polarisation_tilt_rad: 0 horizontal, pi/2 vertical (``p838`` only).
        elevation_rad: of the path (``p838`` only).

    References:
        PHYSICS.md 6.5.

    Example:
        >>> [round(float(rain_attenuation_db_per_km(25.0, model=m)), 2) for m in ("p838", "d3_4")]
        [11.41, 9.86]
    """
    check_arguments(
        "rain_attenuation_db_per_km(rate_mm_per_h: Quantity, frequency_ghz: float, model: str, "
        "temperature_c: float, polarisation_tilt_rad: float, elevation_rad: float)",
        rate_mm_per_h,
        frequency_ghz,
        model,
        temperature_c,
        polarisation_tilt_rad,
        elevation_rad,
    )
    check_one_of("model", model, RAIN_ATTENUATION_MODELS, owner="rain_attenuation_db_per_km")
    if model == "p838":
        return rain_attenuation_p838_db_per_km(
            rate_mm_per_h, frequency_ghz, polarisation_tilt_rad=polarisation_tilt_rad, elevation_rad=elevation_rad
        )
    if model == "dsd_mie":
        return particle_attenuation_db_per_km(
            marshall_palmer(rate_mm_per_h), frequency_ghz, temperature_c=temperature_c
        )
    check_at_least("rate_mm_per_h", rate_mm_per_h, 0.0, unit="mm/h", owner="rain_attenuation_db_per_km")
    (rate,) = to_float64(rate_mm_per_h)
    factor, power = SANDER_1975
    return factor * rate**power


def fog_attenuation_coefficient_db_per_km_per_g_per_m3(
    frequency_ghz: Quantity = 77.0, temperature_c: Quantity = 10.0
) -> Tensor:
    """Attenuation per liquid water, ITU-R P.840.

    ``K_l = 0.819 f / (eps'' (1 + eta^2))``, ``eta = (2 + eps') / eps''``.

    Args:
        frequency_ghz: GHz, 1-200, any shape; beyond, ``particle_attenuation_db_per_km`` has the Mie series.
        temperature_c: deg C, -20 to 60.

    Note:
        Rayleigh: droplets of fog, not drizzle or rain. Within 0.3 % of Mie for every fog of PHYSICS.md, 77 GHz.

    References:
        PHYSICS.md 6.6; ITU-R P.840; Liebe 1989.

    Example:
        >>> round(float(fog_attenuation_coefficient_db_per_km_per_g_per_m3(77.0, 10.0)), 2)
        3.15
    """
    check_arguments(
        "fog_attenuation_coefficient_db_per_km_per_g_per_m3(frequency_ghz: Quantity, temperature_c: Quantity)",
        frequency_ghz,
        temperature_c,
    )
    check_broadcast(
        "fog_attenuation_coefficient_db_per_km_per_g_per_m3", frequency_ghz=frequency_ghz, temperature_c=temperature_c
    )
    frequency, celsius = to_float64(frequency_ghz, temperature_c)
    check_between(
        "frequency_ghz",
        frequency,
        *P840_RANGE_GHZ,
        unit="GHz (ITU-R P.840)",
        owner="fog_attenuation_coefficient_db_per_km_per_g_per_m3",
        advice="particle_attenuation_db_per_km sums the Mie series up to 1000 GHz.",
    )
    permittivity = water_permittivity_microwave(frequency, celsius)
    eta = (2.0 + permittivity.real) / permittivity.imag
    return 0.819 * frequency / (permittivity.imag * (1.0 + eta**2))


def fog_attenuation_db_per_km(
    liquid_water_g_per_m3: Quantity,
    frequency_ghz: Quantity = 77.0,
    *,
    temperature_c: Quantity = 10.0,
    variant: str = "default",
) -> Tensor:
    """Attenuation of fog, dB/km one way: ``K_l`` times the liquid water content.

    Args:
        liquid_water_g_per_m3: g/m^3, 0 or more, any shape; may require grad.
        frequency_ghz: GHz, 1-200; any above 0 for ``"d3_4"``, which D3.4 uses at 77 GHz.
        temperature_c: deg C; ``"d3_4"`` does not look at it.
        variant: ``"d3_4"`` is D3.4's ``0.182 LWC f^2``, 340 times too high at 77 GHz.

    References:
        PHYSICS.md 6.6.

    Example:
        >>> round(float(fog_attenuation_db_per_km(0.132, 77.0)), 2)
        0.42
    """
    check_arguments(
        "fog_attenuation_db_per_km(liquid_water_g_per_m3: Quantity, frequency_ghz: Quantity, "
        "temperature_c: Quantity, variant: str)",
        liquid_water_g_per_m3,
        frequency_ghz,
        temperature_c,
        variant,
    )
    check_broadcast(
        "fog_attenuation_db_per_km",
        liquid_water_g_per_m3=liquid_water_g_per_m3,
        frequency_ghz=frequency_ghz,
        temperature_c=temperature_c,
    )
    check_one_of("variant", variant, ("default", "d3_4"), owner="fog_attenuation_db_per_km")
    check_at_least("liquid_water_g_per_m3", liquid_water_g_per_m3, 0.0, unit="g/m^3", owner="fog_attenuation_db_per_km")
    water, frequency = to_float64(liquid_water_g_per_m3, frequency_ghz)
    if variant == "d3_4":
        check_positive("frequency_ghz", frequency, unit="GHz", owner="fog_attenuation_db_per_km")
        return LIEBE_AS_PUBLISHED * water * frequency**2
    return water * fog_attenuation_coefficient_db_per_km_per_g_per_m3(frequency, temperature_c)


def snow_attenuation_db_per_km(
    rate_mm_per_h: Quantity,
    frequency_ghz: float = 77.0,
    *,
    model: str = "dsd_mie",
    temperature_c: float = -5.0,
    melt_fraction: float = 0.0,
) -> Tensor:
    """Attenuation of snow, dB/km one way; dry unless ``melt_fraction`` is set.

    Args:
        rate_mm_per_h: liquid-equivalent rate, mm/h, 0 or more, any shape; may require grad.
        frequency_ghz: GHz, 1-1000; ``"d3_4"`` does not look at it.
        model: ``"dsd_mie"`` (Mie of ice-air spheres of Brandes' density over Sekhon-Srivastava, default); ``"d3_4"``
            (Norouziari's ``0.8205 S`` of the low-THz band, as D3.4 uses it at 77 GHz).
        temperature_c: of the ice, deg C, -40 to 0.
        melt_fraction: share of the flakes' mass that is liquid, 0-1; ``"d3_4"`` knows dry snow only.

    Note:
        The sphere model is uncertain by a factor 3-10. At 77 GHz dry snow up to 2.5 mm/h costs less than 0.25 dB two
        way at 200 m. Melting snow of 1-5 mm/h passes rain of the same rate (P.838) at a melt fraction of 0.07-0.08 and
        reaches six times its attenuation near 0.7: an upper bound, see ``particle_attenuation_db_per_km``.

    References:
        PHYSICS.md 6.7.

    Example:
        >>> round(float(snow_attenuation_db_per_km(1.0)), 2)
        0.19
    """
    check_arguments(
        "snow_attenuation_db_per_km(rate_mm_per_h: Quantity, frequency_ghz: float, model: str, "
        "temperature_c: float, melt_fraction: float)",
        rate_mm_per_h,
        frequency_ghz,
        model,
        temperature_c,
        melt_fraction,
    )
    check_one_of("model", model, SNOW_ATTENUATION_MODELS, owner="snow_attenuation_db_per_km")
    if model == "d3_4":
        check_at_least("rate_mm_per_h", rate_mm_per_h, 0.0, unit="mm/h", owner="snow_attenuation_db_per_km")
        if melt_fraction != 0.0:
            raise InputValueError(
                f"snow_attenuation_db_per_km: model='d3_4' is a fit to dry snow and needs melt_fraction = 0; got "
                f"{melt_fraction!r}. Melting snow is in model='dsd_mie'."
            )
        (rate,) = to_float64(rate_mm_per_h)
        return NOROUZIARI_2018 * rate
    return particle_attenuation_db_per_km(
        sekhon_srivastava(rate_mm_per_h), frequency_ghz, temperature_c=temperature_c, melt_fraction=melt_fraction
    )
