"""Extinction, backscatter and albedo of a cloud of particles: efficiencies integrated over the size distribution."""

from __future__ import annotations

import math
from typing import Literal

import torch
from torch import Tensor

from torchweather.core.arguments import check_arguments
from torchweather.core.errors import check_at_least, check_between, check_one_of, check_positive
from torchweather.physics.efficiency_table import extinction_table, scattering_table
from torchweather.physics.float64 import Quantity, to_float64
from torchweather.physics.size_distribution import SizeDistribution
from torchweather.physics.snow_geometry import (
    ICE_DENSITY_G_PER_CM3,
    SNOW_DENSITY_AT_1MM_G_PER_CM3,
    SNOW_DENSITY_EXPONENT,
    SOLID_ICE_BELOW_MM,
    physical_diameter_mm,
)

__all__ = [
    "FLAKE_ALBEDO",
    "Q_EFF",
    "backscatter_per_m_sr",
    "effective_extinction_per_m",
    "extinction_and_backscatter",
    "extinction_per_m",
    "lidar_ratio_sr",
    "rain_q_back",
    "single_scattering_albedo",
]

Material = Literal["water", "ice"]

PER_M_PER_MM2_M3 = 1e-6  # mm^2 m^-3 to 1/m, PHYSICS.md 0

# Share of the geometric extinction that leaves a sensor's field of view: the forward lobe of drops and flakes stays
# inside a LiDAR beam or a camera's blur, that of fog droplets does not. PHYSICS.md 3.2 and 7.
Q_EFF = {"rain": 1.1, "snow": 1.1, "fog": 2.0}

FLAKE_ALBEDO = 0.9  # Lambertian reflectivity of a snowflake, Hahner et al. 2022, PHYSICS.md 5.9
# A Lambertian disk of reflectivity rho sends rho/pi of the light it stops into a steradian backwards: Q_back = 4 rho.
FLAKE_Q_BACK = 4.0 * FLAKE_ALBEDO

# Backscatter efficiency of real (not perfectly spherical) raindrops over a finite aperture, PHYSICS.md 3.2 and 7
RAIN_Q_BACK_NM = ((905.0, 0.2), (1550.0, 0.06))

_IS_CLOUD_BELOW_MM = 0.1  # effective diameter that separates droplets of fog from drops of rain


def extinction_per_m(
    distribution: SizeDistribution,
    wavelength_nm: float,
    *,
    material: Material | None = None,
    temperature_c: float = 10.0,
    q_ext: float | None = None,
) -> Tensor:
    """Extinction coefficient of the particles, 1/m of power: ``alpha = (pi/4) int D^2 Q_ext N dD``.

    Flakes stop light with their physical cross-section, whatever diameter the distribution counts.

    Args:
        distribution: drops or flakes, parameters of any batch shape; differentiable in them.
        wavelength_nm: vacuum wavelength, nm, 300-2500.
        material: ``"water"`` or ``"ice"``; None takes ice for flakes and water for drops.
        temperature_c: of the water, deg C.
        q_ext: None for Mie; a number for that efficiency at every size (2: geometric optics), then in closed form.

    Returns:
        1/m, of the batch shape of the distribution. The forward lobe counts as lost: see
        ``effective_extinction_per_m``.

    Note:
        Mie up to x = pi D / lambda = 300, the ripple-averaged asymptotic form beyond (5e-4). Integration error below
        5e-4 for the fogs of PHYSICS.md. The efficiencies are cached per wavelength, so a second call costs one product.
        Snowflakes are treated as spheres, for which Q_ext is 2.00-2.02 at these sizes.

    References:
        PHYSICS.md 3.2.

    Example:
        >>> from torchweather.physics import marshall_palmer
        >>> round(float(extinction_per_m(marshall_palmer(25.0), 905.0)), 5)
        0.00278
    """
    check_arguments(
        "extinction_per_m(distribution: SizeDistribution, wavelength_nm: float, "
        "temperature_c: float, q_ext: float | None)",
        distribution,
        wavelength_nm,
        temperature_c,
        q_ext,
    )
    _check_wavelength(wavelength_nm, "extinction_per_m")
    if q_ext is not None:
        check_between("q_ext", q_ext, 0.0, 1e6, owner="extinction_per_m")
        return cross_section_per_m(distribution) * q_ext
    bounds, material = _physical_support(distribution, material)
    diameter, width, efficiency = extinction_table(*bounds, float(wavelength_nm), material, float(temperature_c))
    return _integrated(distribution, diameter, width, efficiency)


def cross_section_per_m(distribution: SizeDistribution) -> Tensor:
    """Sum of the particles' shadow areas per volume, 1/m, in closed form: ``(pi/4) int D^2 N dD``.

    Example:
        >>> from torchweather.physics import marshall_palmer
        >>> bool(cross_section_per_m(marshall_palmer(25.0)) > 0.00138)
        True
    """
    check_arguments("cross_section_per_m(distribution: SizeDistribution)", distribution)
    if distribution.particle != "melted-flake":
        return distribution.moment(2.0) * (0.25 * math.pi * PER_M_PER_MM2_M3)
    # D_phys = (D^3 / 0.178)^(1/2.078), but at least D / 0.917^(1/3): two powers of the melted diameter.
    power = 3.0 / (3.0 + SNOW_DENSITY_EXPONENT)
    solid_below = SOLID_ICE_BELOW_MM * ICE_DENSITY_G_PER_CM3 ** (1.0 / 3.0)
    loose = SNOW_DENSITY_AT_1MM_G_PER_CM3 ** (-2.0 * power / 3.0) * distribution.moment(2.0 * power, solid_below)
    solid = ICE_DENSITY_G_PER_CM3 ** (-2.0 / 3.0) * distribution.moment(2.0, None, solid_below)
    total: Tensor = loose + solid
    return total * (0.25 * math.pi * PER_M_PER_MM2_M3)


def effective_extinction_per_m(extinction_per_m: Quantity, q_eff: float) -> Tensor:
    """Extinction that a sensor sees, 1/m: ``alpha q_eff / 2``, without the part of the forward lobe it still collects.

    Args:
        extinction_per_m: full extinction, 1/m.
        q_eff: 1 (geometric blocking only) to 2 (all of it); ``Q_EFF`` names the defaults.

    References:
        PHYSICS.md 3.2.

    Example:
        >>> float(effective_extinction_per_m(0.002, 1.1))
        0.0011
    """
    check_arguments("effective_extinction_per_m(extinction_per_m: Quantity, q_eff: float)", extinction_per_m, q_eff)
    check_between("q_eff", q_eff, 0.0, 1e3, owner="effective_extinction_per_m")
    (extinction,) = to_float64(extinction_per_m)
    return extinction * (0.5 * q_eff)


def rain_q_back(wavelength_nm: float) -> float:
    """Backscatter efficiency of raindrops as a sensor sees them: 0.2 up to 905 nm, 0.06 at 1550 nm, log-linear between.

    The exact backscatter of a sphere (2-7) is a glory narrower than the aperture of a sensor at metres; averaged over
    it and over slightly flattened drops 0.1-0.6 remain.

    References:
        PHYSICS.md 3.2, 7 (1550 nm not verified).

    Example:
        >>> rain_q_back(905.0)
        0.2
    """
    check_arguments("rain_q_back(wavelength_nm: float)", wavelength_nm)
    check_between("wavelength_nm", wavelength_nm, 100.0, 1e5, unit="nm", owner="rain_q_back")
    (near, q_near), (far, q_far) = RAIN_Q_BACK_NM
    share = min(max((wavelength_nm - near) / (far - near), 0.0), 1.0)
    return float(q_near * (q_far / q_near) ** share)


def backscatter_per_m_sr(
    distribution: SizeDistribution,
    wavelength_nm: float,
    *,
    material: Material | None = None,
    temperature_c: float = 10.0,
    q_back: float | Literal["mie"] | None = None,
) -> Tensor:
    """Backscatter coefficient, 1/(m sr): ``beta = (1/16) int D^2 Q_back N dD``.

    Args:
        distribution: drops or flakes, parameters of any batch shape; differentiable in them.
        wavelength_nm: vacuum wavelength, nm.
        material: as in ``extinction_per_m``.
        temperature_c: of the water, deg C.
        q_back: a number for that efficiency at every size; ``"mie"`` for exact 180 degrees; None for the default of
            the particle: Mie for droplets of fog, ``rain_q_back`` for drops of rain, a Lambertian disk of
            reflectivity 0.9 for flakes.

    Returns:
        1/(m sr), of the batch shape.

    References:
        PHYSICS.md 3.2, 5.8, 5.9.

    Example:
        >>> from torchweather.physics import marshall_palmer
        >>> f"{float(backscatter_per_m_sr(marshall_palmer(25.0), 905.0)):.2e}"
        '2.20e-05'
    """
    check_arguments(
        "backscatter_per_m_sr(distribution: SizeDistribution, wavelength_nm: float, temperature_c: float)",
        distribution,
        wavelength_nm,
        temperature_c,
    )
    _check_wavelength(wavelength_nm, "backscatter_per_m_sr")
    _check_wavelength(wavelength_nm, "backscatter_per_m_sr")
    if q_back is None:
        if distribution.particle != "drop":
            q_back = FLAKE_Q_BACK
        else:
            q_back = "mie" if is_cloud(distribution) else rain_q_back(wavelength_nm)
    if isinstance(q_back, str):
        check_one_of("q_back", q_back, ("mie",), owner="backscatter_per_m_sr")
        bounds, material = _physical_support(distribution, material)
        diameter, width, q = scattering_table(*bounds, float(wavelength_nm), material, float(temperature_c), False)
        return _integrated(distribution, diameter, width, q.q_back) / (4.0 * math.pi)
    check_at_least("q_back", q_back, 0.0, owner="backscatter_per_m_sr")
    return q_back / (4.0 * math.pi) * cross_section_per_m(distribution)


def extinction_and_backscatter(
    distribution: SizeDistribution,
    wavelength_nm: float,
    *,
    material: Material | None = None,
    temperature_c: float = 10.0,
) -> tuple[Tensor, Tensor]:
    """Extinction, 1/m, and backscatter, 1/(m sr), of the batch shape: Mie at every size, from one set of series.

    As ``extinction_per_m`` and ``backscatter_per_m_sr(q_back="mie")``, in little more than the time of the latter; for
    droplets of fog.

    References:
        PHYSICS.md 3.2, 5.8.

    Example:
        >>> from torchweather.physics import rehearse_fog
        >>> alpha, beta = extinction_and_backscatter(rehearse_fog(30), 905.0)
        >>> round(float(alpha / beta), 1)
        19.7
    """
    check_arguments(
        "extinction_and_backscatter(distribution: SizeDistribution, wavelength_nm: float, temperature_c: float)",
        distribution,
        wavelength_nm,
        temperature_c,
    )
    _check_wavelength(wavelength_nm, "extinction_and_backscatter")
    bounds, material = _physical_support(distribution, material)
    diameter, width, q = scattering_table(*bounds, float(wavelength_nm), material, float(temperature_c), False)
    extinction = _integrated(distribution, diameter, width, q.q_ext)
    return extinction, _integrated(distribution, diameter, width, q.q_back) / (4.0 * math.pi)


def is_cloud(distribution: SizeDistribution) -> bool:
    """Check whether the drops are droplets of fog (effective diameter below 0.1 mm) and not rain."""
    if distribution.diameter_max_mm <= _IS_CLOUD_BELOW_MM:
        return True
    if distribution.diameter_min_mm >= _IS_CLOUD_BELOW_MM:
        return False
    effective = distribution.effective_diameter_mm.detach()
    return bool((torch.nan_to_num(effective, nan=0.0) < _IS_CLOUD_BELOW_MM).all())


def lidar_ratio_sr(distribution: SizeDistribution, wavelength_nm: float, *, temperature_c: float = 10.0) -> Tensor:
    """Extinction over backscatter, sr, both from Mie (for fog: 18-22 sr up to 905 nm).

    Example:
        >>> from torchweather.physics import rehearse_fog
        >>> round(float(lidar_ratio_sr(rehearse_fog(30), 905.0)), 1)
        19.7
    """
    check_arguments(
        "lidar_ratio_sr(distribution: SizeDistribution, wavelength_nm: float, temperature_c: float)",
        distribution,
        wavelength_nm,
        temperature_c,
    )
    _check_wavelength(wavelength_nm, "lidar_ratio_sr")
    extinction = extinction_per_m(distribution, wavelength_nm, temperature_c=temperature_c)
    return extinction / backscatter_per_m_sr(distribution, wavelength_nm, temperature_c=temperature_c, q_back="mie")


def single_scattering_albedo(
    distribution: SizeDistribution,
    wavelength_nm: float,
    *,
    material: Material | None = None,
    temperature_c: float = 10.0,
) -> Tensor:
    """Share of the extinction that is scattered and not absorbed, 0 to 1, of the batch shape (Mie at every size).

    Note:
        Sums the full Mie series: seconds for rain at the first call of a wavelength.

    References:
        PHYSICS.md 1.

    Example:
        >>> from torchweather.physics import rehearse_fog
        >>> round(float(single_scattering_albedo(rehearse_fog(30), 905.0)), 4)
        1.0
    """
    check_arguments(
        "single_scattering_albedo(distribution: SizeDistribution, wavelength_nm: float, temperature_c: float)",
        distribution,
        wavelength_nm,
        temperature_c,
    )
    _check_wavelength(wavelength_nm, "single_scattering_albedo")
    bounds, material = _physical_support(distribution, material)
    diameter, width, q = scattering_table(*bounds, float(wavelength_nm), material, float(temperature_c), True)
    scattered = _integrated(distribution, diameter, width, q.q_sca)
    return scattered / _integrated(distribution, diameter, width, q.q_ext)


def integrated_per_m(
    distribution: SizeDistribution, counted_mm: Tensor, physical_mm: Tensor, width_mm: Tensor, efficiency: Tensor
) -> Tensor:
    """Cross-section per volume, 1/m: ``(pi/4) int D_phys^2 Q N dD``, of the batch shape.

    Args:
        distribution: what counts the particles.
        counted_mm: diameter by which it counts them, mm, ``(K,)``.
        physical_mm: diameter of their cross-section, mm, ``(K,)``.
        width_mm: width of each node in the counted diameter, mm, ``(K,)``.
        efficiency: Q, ``(K,)``.
    """
    counted, physical, width, q = (v.to(distribution.device) for v in (counted_mm, physical_mm, width_mm, efficiency))
    weight = 0.25 * math.pi * PER_M_PER_MM2_M3 * physical**2 * q * width
    return distribution.summed(counted, weight)


def _integrated(distribution: SizeDistribution, physical_mm: Tensor, width_mm: Tensor, efficiency: Tensor) -> Tensor:
    """The same with widths of the physical diameter.

    Integrals over melted diameters with the physical cross-section are run over the physical diameter: then the
    efficiencies of one wavelength serve every distribution.
    """
    counted, slope = _counted(distribution, physical_mm)
    return integrated_per_m(distribution, counted, physical_mm, width_mm * slope, efficiency)


def _counted(distribution: SizeDistribution, physical_mm: Tensor) -> tuple[Tensor, Tensor]:
    """Diameter by which the distribution counts a particle of physical diameter, and its derivative."""
    if distribution.particle != "melted-flake":
        return physical_mm, torch.ones_like(physical_mm)
    loose = physical_mm > SOLID_ICE_BELOW_MM
    power = (3.0 + SNOW_DENSITY_EXPONENT) / 3.0
    solid_factor = ICE_DENSITY_G_PER_CM3 ** (1.0 / 3.0)
    loose_factor = SNOW_DENSITY_AT_1MM_G_PER_CM3 ** (1.0 / 3.0)
    counted = torch.where(loose, loose_factor * physical_mm**power, solid_factor * physical_mm)
    slope = torch.where(
        loose, loose_factor * power * physical_mm ** (power - 1.0), torch.full_like(physical_mm, solid_factor)
    )
    # Rounding must not push the end nodes out of the domain, where the density is 0.
    return counted.clamp(distribution.diameter_min_mm, distribution.diameter_max_mm), slope


def _physical_support(
    distribution: SizeDistribution, material: Material | None
) -> tuple[tuple[float, float], Material]:
    """Physical diameters, mm, that hold all of the cross-section, and the material to take."""
    low, high = support_mm(distribution)
    if distribution.particle == "melted-flake":
        low, high = (float(physical_diameter_mm(d)) for d in (low, high))
    if material is None:
        material = "water" if distribution.particle == "drop" else "ice"
    check_one_of("material", material, ("water", "ice"), owner="extinction_per_m")
    return (low, high), material


def support_mm(distribution: SizeDistribution, order: float = 2.0) -> tuple[float, float]:
    """Diameters that hold all but 1e-5 of the cross-section, mm: the domain's ends, or steps of a fixed ladder.

    ``order`` 6 asks the same of the largest particles' Rayleigh backscatter too.

    The ladder makes distributions of similar size share one table of efficiencies.
    """
    low, high = distribution.diameter_min_mm, distribution.diameter_max_mm
    rungs = 2.0 ** torch.arange(-26.0, 10.0, 0.5, dtype=torch.float64)  # 15 nm to 700 mm
    with torch.no_grad():
        above, below = (
            (whole.unsqueeze(-1) if whole.ndim else whole).clamp_min(1e-300)
            for whole in (distribution.moment(order), distribution.moment(2.0))
        )
        missed_above = (distribution.moment(order, low_mm=rungs) / above).reshape(-1, rungs.numel())
        missed_below = (distribution.moment(2.0, high_mm=rungs) / below).reshape(-1, rungs.numel())
    enough_high = rungs[(missed_above < 1e-5).all(0).cpu()]
    enough_low = rungs[(missed_below < 1e-5).all(0).cpu()]
    if enough_high.numel():
        high = min(high, float(enough_high[0]))
    if enough_low.numel():
        low = max(low, float(enough_low[-1]))
    # A batch of which nothing is left (rate 0, visibility inf) has no size of its own.
    low = low if low > 0 else float(rungs[0])
    return (low, high) if math.isfinite(high) and high > low else (low, max(2.0 * low, distribution.span_mm()[1]))


def _check_wavelength(wavelength_nm: float, owner: str) -> None:
    check_arguments(f"{owner}(wavelength_nm: float)", wavelength_nm)
    check_positive("wavelength_nm", wavelength_nm, unit="nm", owner=owner)
    check_between("wavelength_nm", wavelength_nm, 1.0, 1e9, unit="nm", owner=owner)
