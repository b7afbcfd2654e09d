"""Complex refractive index ``n + i k`` of water, ice and snow, from 300 nm to the millimetre waves of radar.

All indices have ``k >= 0`` (time factor ``exp(-i w t)``); miepython and some papers write ``n - i k``.
"""

from __future__ import annotations

import warnings
from functools import lru_cache

import numpy as np
import torch
from torch import Tensor

from torchweather.core.arguments import check_arguments, check_broadcast
from torchweather.core.errors import InputValueError, TorchweatherWarning, check_between, check_positive
from torchweather.physics.float64 import Quantity, to_complex128, to_float64
from torchweather.physics.optical_constants import ICE_OPTICAL, ICE_THERMAL, WATER_OPTICAL, WATER_THERMAL
from torchweather.physics.snow_geometry import ICE_DENSITY_G_PER_CM3

__all__ = [
    "ice_permittivity_microwave",
    "ice_refractive_index",
    "ice_refractive_index_microwave",
    "maxwell_garnett",
    "snow_refractive_index_microwave",
    "water_permittivity_microwave",
    "water_refractive_index",
    "water_refractive_index_25c",
    "water_refractive_index_microwave",
    "wet_snow_refractive_index_microwave",
]

KELVIN_AT_0_C = 273.15
MELTING_POINT_C = 0.0  # water that shares a flake with ice is at the melting point until the ice is gone
OPTICAL_MIN_NM, OPTICAL_MAX_NM = 300.0, 2500.0
THERMAL_MIN_NM, THERMAL_MAX_NM = 8000.0, 14000.0

# IAPWS R9-97, coefficients of the Lorentz-Lorenz function of water
IAPWS_A = (
    0.244257733,
    9.74634476e-3,
    -3.73234996e-3,
    2.68678472e-4,
    1.58920570e-3,
    2.45934259e-3,
    0.900704920,
    -1.66626219e-2,
)
IAPWS_LAMBDA_UV = 0.2292020
IAPWS_LAMBDA_IR = 5.432937
IAPWS_REFERENCE_NM = 589.0


def water_density_kg_per_m3(temperature_c: Quantity) -> Tensor:
    """Density of air-free water at 1 atm, kg/m^3 (Kell 1975, 0-150 C; used down to -20 C for supercooled drops).

    Example:
        >>> round(float(water_density_kg_per_m3(20.0)), 2)
        998.2
    """
    (t,) = to_float64(temperature_c)
    series = 999.83952 + t * (
        16.945176 + t * (-7.9870401e-3 + t * (-46.170461e-6 + t * (105.56302e-9 - 280.54253e-12 * t)))
    )
    return series / (1.0 + 16.879850e-3 * t)


def water_refractive_index(wavelength_nm: Quantity, temperature_c: Quantity = 10.0) -> Tensor:
    """Refractive index of liquid water at optical wavelengths, ``n + i k``, complex128.

    n follows IAPWS R9-97 (wavelength and temperature), from 8,000 nm on the table of Hale & Querry at 25 C; k is the
    absorption measured at 25 C, log-interpolated.

    Args:
        wavelength_nm: vacuum wavelength, nm, 300-2500 or 8,000-14,000, any shape.
        temperature_c: water temperature, deg C, -20 to 60.

    Returns:
        complex128, broadcast shape.

    Note:
        IAPWS states n up to 1100 nm; at 1550 nm the formula is 0.002 below Hale & Querry. Published values of k
        differ by 10-30 % at 905 and 1550 nm. A wavelength between or outside the tables warns and takes the
        nearest k.

    References:
        PHYSICS.md 1; IAPWS R9-97; Hale & Querry 1973; Segelstein 1981.

    Example:
        >>> print(f"{complex(water_refractive_index(905.0)):.4f}")
        1.3276+0.0000j
    """
    check_arguments(
        "water_refractive_index(wavelength_nm: Quantity, temperature_c: Quantity)",
        wavelength_nm,
        temperature_c,
    )
    check_broadcast("water_refractive_index", wavelength_nm=wavelength_nm, temperature_c=temperature_c)
    wavelength, t = to_float64(wavelength_nm, temperature_c)
    _check_optical(wavelength, "water_refractive_index")
    check_between("temperature_c", t, -20.0, 60.0, unit="deg C", owner="water_refractive_index")
    density = water_density_kg_per_m3(t) / 1000.0
    temperature = (t + KELVIN_AT_0_C) / KELVIN_AT_0_C
    squared = (wavelength / IAPWS_REFERENCE_NM) ** 2
    a = IAPWS_A
    lorentz_lorenz = density * (
        a[0]
        + a[1] * density
        + a[2] * temperature
        + a[3] * squared * temperature
        + a[4] / squared
        + a[5] / (squared - IAPWS_LAMBDA_UV**2)
        + a[6] / (squared - IAPWS_LAMBDA_IR**2)
        + a[7] * density**2
    )
    tabulated, k = _interpolated(wavelength, "water")
    formula = torch.sqrt((2.0 * lorentz_lorenz + 1.0) / (1.0 - lorentz_lorenz))
    n = torch.where(wavelength < THERMAL_MIN_NM, formula, tabulated)
    if not torch.compiler.is_compiling() and not bool(n.isfinite().all()):
        raise InputValueError(
            "water_refractive_index: wavelength_nm lies where the formula has no value. IAPWS R9-97 holds "
            "from 200 to 1100 nm."
        )
    return torch.complex(*_same_shape(n, k))


def water_refractive_index_25c(wavelength_nm: Quantity) -> Tensor:
    """Refractive index of water at 25 C as Hale & Querry tabulate it, ``n + i k``, complex128: what D3.4 used.

    Args:
        wavelength_nm: vacuum wavelength, nm, 300-2500 or 8,000-14,000, any shape; n linear, k log-linear between the
            rows.

    References:
        PHYSICS.md 1; Hale & Querry 1973 (k beyond 1000 nm: Segelstein 1981).

    Example:
        >>> round(complex(water_refractive_index_25c(865.0)).real, 4)
        1.3284
    """
    check_arguments("water_refractive_index_25c(wavelength_nm: Quantity)", wavelength_nm)
    (wavelength,) = to_float64(wavelength_nm)
    _check_optical(wavelength, "water_refractive_index_25c")
    return torch.complex(*_interpolated(wavelength, "water"))


def ice_refractive_index(wavelength_nm: Quantity) -> Tensor:
    """Refractive index of ice at optical wavelengths, ``n + i k``, complex128 (-7 C; hardly depends on temperature).

    Args:
        wavelength_nm: vacuum wavelength, nm, 300-2500 or 8,000-14,000, any shape.

    References:
        PHYSICS.md 1; Warren & Brandt 2008.

    Example:
        >>> print(f"{complex(ice_refractive_index(1550.0)):.4f}")
        1.2906+0.0004j
    """
    check_arguments("ice_refractive_index(wavelength_nm: Quantity)", wavelength_nm)
    (wavelength,) = to_float64(wavelength_nm)
    _check_optical(wavelength, "ice_refractive_index")
    return torch.complex(*_interpolated(wavelength, "ice"))


def water_permittivity_microwave(frequency_ghz: Quantity, temperature_c: Quantity = 10.0) -> Tensor:
    """Relative permittivity of liquid water, ``eps' + i eps''``: the double Debye model of ITU-R P.840.

    Args:
        frequency_ghz: GHz, 1-1000, any shape.
        temperature_c: deg C, -20 to 60.

    References:
        PHYSICS.md 1; ITU-R P.840; Liebe, Hufford & Manabe 1991.

    Example:
        >>> print(f"{complex(water_permittivity_microwave(77.0, 10.0)):.3f}")
        7.624+12.804j
    """
    check_arguments(
        "water_permittivity_microwave(frequency_ghz: Quantity, temperature_c: Quantity)",
        frequency_ghz,
        temperature_c,
    )
    check_broadcast("water_permittivity_microwave", frequency_ghz=frequency_ghz, temperature_c=temperature_c)
    f, t = to_float64(frequency_ghz, temperature_c)
    check_between("frequency_ghz", f, 1.0, 1000.0, unit="GHz", owner="water_permittivity_microwave")
    check_between("temperature_c", t, -20.0, 60.0, unit="deg C", owner="water_permittivity_microwave")
    theta = 300.0 / (t + KELVIN_AT_0_C)
    e0 = 77.66 + 103.3 * (theta - 1.0)
    e1 = 0.0671 * e0
    e2 = 3.52
    principal = 20.20 - 146.0 * (theta - 1.0) + 316.0 * (theta - 1.0) ** 2  # GHz
    secondary = 39.8 * principal
    first, second = 1.0 + (f / principal) ** 2, 1.0 + (f / secondary) ** 2
    real = (e0 - e1) / first + (e1 - e2) / second + e2
    imaginary = f * (e0 - e1) / (principal * first) + f * (e1 - e2) / (secondary * second)
    return torch.complex(real, imaginary)


def water_refractive_index_microwave(frequency_ghz: Quantity, temperature_c: Quantity = 10.0) -> Tensor:
    """Refractive index of liquid water at millimetre waves, ``n + i k``: the root of the permittivity.

    Args:
        frequency_ghz: GHz, 1-1000, any shape.
        temperature_c: deg C.

    Example:
        >>> print(f"{complex(water_refractive_index_microwave(77.0, 10.0)):.3f}")
        3.356+1.908j
    """
    check_arguments(
        "water_refractive_index_microwave(frequency_ghz: Quantity, temperature_c: Quantity)",
        frequency_ghz,
        temperature_c,
    )
    check_broadcast("water_refractive_index_microwave", frequency_ghz=frequency_ghz, temperature_c=temperature_c)
    return torch.sqrt(water_permittivity_microwave(frequency_ghz, temperature_c))


def ice_permittivity_microwave(frequency_ghz: Quantity, temperature_c: Quantity = -5.0) -> Tensor:
    """Relative permittivity of ice, ``eps' + i eps''``: Maetzler 2006.

    ``eps' = 3.1884 + 9.1e-4 T``, ``eps'' = a / f + b f`` with a (Debye tail) and b (infrared wing) of the temperature.

    Args:
        frequency_ghz: GHz, 1-1000, any shape.
        temperature_c: deg C, -40 to 0.

    References:
        PHYSICS.md 1; Maetzler 2006; Hufford 1991.

    Example:
        >>> print(f"{complex(ice_permittivity_microwave(77.0, -5.0)):.4f}")
        3.1839+0.0064j
    """
    check_arguments(
        "ice_permittivity_microwave(frequency_ghz: Quantity, temperature_c: Quantity)",
        frequency_ghz,
        temperature_c,
    )
    check_broadcast("ice_permittivity_microwave", frequency_ghz=frequency_ghz, temperature_c=temperature_c)
    f, t = to_float64(frequency_ghz, temperature_c)
    check_between("frequency_ghz", f, 1.0, 1000.0, unit="GHz", owner="ice_permittivity_microwave")
    check_between("temperature_c", t, -40.0, 0.0, unit="deg C", owner="ice_permittivity_microwave")
    kelvin = t + KELVIN_AT_0_C
    theta = 300.0 / kelvin - 1.0
    debye = (0.00504 + 0.0062 * theta) * torch.exp(-22.1 * theta)  # GHz, Hufford 1991
    b1, b2, b = 0.0207, 1.16e-11, 335.0  # K/GHz, GHz^-3, K: Maetzler 2006
    activated = torch.exp(-b / kelvin)
    wing = (
        b1 / kelvin * activated / (1.0 - activated) ** 2
        + b2 * f**2
        + torch.exp(-9.963 + 0.0372 * t)  # Maetzler's correction of 1998
    )
    return torch.complex(*_same_shape(3.1884 + 9.1e-4 * t, debye / f + wing * f))


def ice_refractive_index_microwave(frequency_ghz: Quantity, temperature_c: Quantity = -5.0) -> Tensor:
    """Refractive index of ice at millimetre waves, ``n + i k``.

    Args:
        frequency_ghz: GHz, 1-1000, any shape.
        temperature_c: deg C, -40 to 0.

    Example:
        >>> print(f"{complex(ice_refractive_index_microwave(77.0, -5.0)):.4f}")
        1.7843+0.0018j
    """
    check_arguments(
        "ice_refractive_index_microwave(frequency_ghz: Quantity, temperature_c: Quantity)",
        frequency_ghz,
        temperature_c,
    )
    check_broadcast("ice_refractive_index_microwave", frequency_ghz=frequency_ghz, temperature_c=temperature_c)
    return torch.sqrt(ice_permittivity_microwave(frequency_ghz, temperature_c))


def maxwell_garnett(matrix: complex | Tensor, inclusion: complex | Tensor, volume_fraction: Quantity) -> Tensor:
    """Permittivity of spheres (``inclusion``) embedded in a ``matrix``, both permittivities, complex128.

    ``eps = eps_m (1 + 2 f y) / (1 - f y)``, ``y = (eps_i - eps_m) / (eps_i + 2 eps_m)``.

    Args:
        matrix: permittivity around the inclusions (air: 1).
        inclusion: permittivity of the inclusions.
        volume_fraction: share of the volume that the inclusions fill, 0 to 1.

    References:
        PHYSICS.md 1; Bohren & Huffman 1983, section 8.5.

    Example:
        >>> print(f"{complex(maxwell_garnett(1.0, 3.18, 1.0)):.2f}")
        3.18+0.00j
    """
    check_arguments("maxwell_garnett(volume_fraction: Quantity)", volume_fraction)
    (fraction,) = to_float64(volume_fraction)
    check_between("volume_fraction", fraction, 0.0, 1.0, owner="maxwell_garnett")
    around, inside = (v.to(fraction.device) for v in to_complex128(matrix, inclusion))
    check_broadcast("maxwell_garnett", matrix=around, inclusion=inside, volume_fraction=fraction)
    y = fraction * (inside - around) / (inside + 2.0 * around)
    mixed: Tensor = around * (1.0 + 2.0 * y) / (1.0 - y)
    given = bool(around.isfinite().all() and inside.isfinite().all())
    if given and not bool(mixed.isfinite().all()):
        raise InputValueError(
            "maxwell_garnett: matrix and inclusion must be permittivities with a mixture, such as 1 and 3.18; got "
            "inclusion = -2 matrix, or none at all."
        )
    return mixed


def snow_refractive_index_microwave(
    frequency_ghz: Quantity, density_g_per_cm3: Quantity, temperature_c: Quantity = -5.0
) -> Tensor:
    """Refractive index of dry snow at millimetre waves: ice spheres in air, Maxwell-Garnett.

    Args:
        frequency_ghz: GHz.
        density_g_per_cm3: bulk density of the flake, 0 to 0.917.
        temperature_c: deg C, -40 to 0.

    References:
        PHYSICS.md 1, 6.7.

    Example:
        >>> print(f"{complex(snow_refractive_index_microwave(77.0, 0.1)):.4f}")
        1.0698+0.0001j
    """
    check_arguments(
        "snow_refractive_index_microwave(frequency_ghz: Quantity, density_g_per_cm3: Quantity, "
        "temperature_c: Quantity)",
        frequency_ghz,
        density_g_per_cm3,
        temperature_c,
    )
    check_broadcast(
        "snow_refractive_index_microwave",
        frequency_ghz=frequency_ghz,
        density_g_per_cm3=density_g_per_cm3,
        temperature_c=temperature_c,
    )
    (density,) = to_float64(density_g_per_cm3)
    ice = ice_permittivity_microwave(frequency_ghz, temperature_c)
    return torch.sqrt(maxwell_garnett(1.0, ice, density / ICE_DENSITY_G_PER_CM3))


def wet_snow_refractive_index_microwave(
    frequency_ghz: Quantity,
    density_g_per_cm3: Quantity,
    melt_fraction: Quantity,
    temperature_c: Quantity = -5.0,
) -> Tensor:
    """Refractive index of melting snow at millimetre waves: dry snow enclosed by water, Maxwell-Garnett.

    The water matrix fills the share ``w = f rho / (1 - f + f rho)`` of the flake's volume (f the melted share of the
    mass, rho the dry bulk density over that of water); the dry snow in it is the ice-air mixture of
    ``snow_refractive_index_microwave``, which is the result at f = 0. At f = 1 it is water.

    Args:
        frequency_ghz: GHz, 1-1000.
        density_g_per_cm3: bulk density of the flake before it melts, above 0, to 0.917.
        melt_fraction: f, share of the mass that is liquid, 0 to 1.
        temperature_c: of the ice, deg C, -40 to 0. The water is at 0 C.

    Returns:
        complex128, broadcast shape.

    Note:
        Water that wraps the snow is the limit of a coated flake and the upper bound of the mixing rules; water
        collected inside the ice lattice, or in drops on it, couples less. Uncertain for small f most of all.

    References:
        PHYSICS.md 1, 6.7; Bohren & Huffman 1983, section 8.5.

    Example:
        >>> print(f"{complex(wet_snow_refractive_index_microwave(77.0, 0.1, 0.3)):.3f}")
        1.154+0.119j
    """
    check_arguments(
        "wet_snow_refractive_index_microwave(frequency_ghz: Quantity, density_g_per_cm3: Quantity, "
        "melt_fraction: Quantity, temperature_c: Quantity)",
        frequency_ghz,
        density_g_per_cm3,
        melt_fraction,
        temperature_c,
    )
    check_broadcast(
        "wet_snow_refractive_index_microwave",
        frequency_ghz=frequency_ghz,
        density_g_per_cm3=density_g_per_cm3,
        melt_fraction=melt_fraction,
        temperature_c=temperature_c,
    )
    density, fraction = to_float64(density_g_per_cm3, melt_fraction)
    check_between("melt_fraction", fraction, 0.0, 1.0, owner="wet_snow_refractive_index_microwave")
    check_positive("density_g_per_cm3", density, unit="g/cm^3", owner="wet_snow_refractive_index_microwave")
    dry = snow_refractive_index_microwave(frequency_ghz, density, temperature_c)
    water = water_permittivity_microwave(frequency_ghz, MELTING_POINT_C)
    snow_share = (1.0 - fraction) / (1.0 - fraction + fraction * density)
    wet = torch.sqrt(maxwell_garnett(water, dry**2, snow_share))
    return torch.where(fraction > 0, wet, dry)


def _check_optical(wavelength_nm: Tensor, owner: str) -> None:
    check_between("wavelength_nm", wavelength_nm, 1.0, 1e9, unit="nm", owner=owner)
    optical = (wavelength_nm >= OPTICAL_MIN_NM) & (wavelength_nm <= OPTICAL_MAX_NM)
    thermal = (wavelength_nm >= THERMAL_MIN_NM) & (wavelength_nm <= THERMAL_MAX_NM)
    if not bool((optical | thermal).all()):
        warnings.warn(
            f"{owner}: wavelength_nm lies outside the tabulated {OPTICAL_MIN_NM:g}-{OPTICAL_MAX_NM:g} and "
            f"{THERMAL_MIN_NM:g}-{THERMAL_MAX_NM:g} nm; the nearest value is used. Below 1 THz use the *_microwave "
            "function.",
            TorchweatherWarning,
            stacklevel=3,
        )


@lru_cache(maxsize=4)
def _table(rows: tuple[tuple[float, float, float], ...]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    at, n, k = np.array(rows).T
    return at, n, np.log(k)


def _interpolated(wavelength_nm: Tensor, material: str) -> tuple[Tensor, Tensor]:
    """n linear and k log-linear in the wavelength; the wavelength carries no gradient."""
    wanted = wavelength_nm.detach().cpu().numpy()
    optical, thermal = (WATER_OPTICAL, WATER_THERMAL) if material == "water" else (ICE_OPTICAL, ICE_THERMAL)
    halfway = 0.5 * (OPTICAL_MAX_NM + THERMAL_MIN_NM)
    values = []
    for rows in (optical, thermal):
        at, n, log_k = _table(rows)
        values.append((np.interp(wanted, at, n), np.exp(np.interp(wanted, at, log_k))))
    real, imaginary = (np.where(wanted < halfway, near, far) for near, far in zip(*values, strict=True))
    device = wavelength_nm.device
    return torch.as_tensor(real).to(device), torch.as_tensor(imaginary).to(device)


def _same_shape(real: Tensor, imaginary: Tensor) -> tuple[Tensor, Tensor]:
    both = real + imaginary
    return real.expand(both.shape), imaginary.expand(both.shape)
