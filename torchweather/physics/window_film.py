r"""Water on a window or a radome: how much rain meets it, how thick the film is, and what the film and its drops cost.

A plane whose normal is inclined by ``b`` from the vertical, driven at speed v through drops that fall with their own
speeds, meets the rain ``R cos b + 3.6 W v sin b`` (mm/h; W is the water in the air, g/m^3). A film that runs down a
plate of length l under gravity carries at its end the flow ``Gamma = q l`` per width and has there Nusselt's thickness

    h = (3 nu Gamma / (g sin b))^(1/3),

and on average over the plate three quarters of it. The loss of the film is that of plane layers air, cover, water, air.

References:
    Nusselt 1916, as for radomes in Gibble 1964 and Ruze 1965 (primary texts not seen; Blevis 1965, IEEE Trans. Antennas
    Propag. 13, 175, uses it). Layers: Born and Wolf, Principles of Optics, 1.6. Viscosity: Vogel's law, within 1 % of
    the tables from 0 to 60 C. Largest cover by drops that grow and merge: Beysens and Knobler 1986, Phys. Rev. Lett.
    57, 1433 (0.55).
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import torch
from torch import Tensor

from torchweather.core.arguments import check_arguments, check_broadcast
from torchweather.core.errors import InputValueError, check_at_least, check_between
from torchweather.physics.float64 import Quantity, to_complex128, to_float64
from torchweather.physics.radar_equation import SPEED_OF_LIGHT_M_PER_S
from torchweather.physics.refractive_index import water_refractive_index, water_refractive_index_microwave

__all__ = [
    "drop_cover",
    "film_thickness_mm",
    "impinging_rain_mm_per_h",
    "layers_transmittance",
    "microwave_film_loss_db",
    "optical_film_transmittance",
]

GRAVITY = 9.81  # m/s^2
MM_PER_H = 3.6  # of 1 g/(m^2 s) of water
MEAN_OVER_PLATE = 0.75  # mean of x^(1/3) over 0..1
COVER_INDEX_MICROWAVE = 1.6  # of a plastic cover (PBT, ABS: permittivity 2.5 to 3)
COVER_INDEX_OPTICAL = 1.57  # of polycarbonate in the near infrared
LARGEST_COVER = 0.55
MEAN_DROP_MM = 0.25  # water over the area of a sitting drop 2 mm wide at a contact angle near 60 degrees
FILM_MM = (0.0, 2.0)


def impinging_rain_mm_per_h(
    rain_mm_per_h: Quantity, water_g_per_m3: Quantity, speed_m_per_s: Quantity, inclination_deg: Quantity
) -> Tensor:
    """Rain that meets a driven plane, mm/h of its own area.

    Args:
        rain_mm_per_h: on level ground, 0 or more.
        water_g_per_m3: of the rain in the air (``SizeDistribution.liquid_water_g_per_m3``).
        speed_m_per_s: of the vehicle towards the plane, 0 to 100 m/s.
        inclination_deg: of the plane from the level, 0 (lying) to 90 (upright) degrees.

    Returns:
        Float64 of the broadcast shape.

    Example:
        >>> round(float(impinging_rain_mm_per_h(25.0, 1.3, 25.0, 90.0)), 1)
        117.0
    """
    owner = "impinging_rain_mm_per_h"
    check_broadcast(owner, rain=rain_mm_per_h, water=water_g_per_m3, speed=speed_m_per_s, inclination=inclination_deg)
    rain, water, speed, tilt = to_float64(rain_mm_per_h, water_g_per_m3, speed_m_per_s, inclination_deg)
    check_at_least("rain_mm_per_h", rain, 0.0, unit="mm/h", owner=owner)
    check_at_least("water_g_per_m3", water, 0.0, unit="g/m^3", owner=owner)
    check_between("speed_m_per_s", speed, 0.0, 100.0, unit="m/s", owner=owner)
    check_between("inclination_deg", tilt, 0.0, 90.0, unit="degrees", owner=owner)
    level = torch.sin(torch.deg2rad(90.0 - tilt))  # 0 of an upright plane, to the last bit
    tilt = torch.deg2rad(tilt)
    return rain * level + MM_PER_H * water * speed * torch.sin(tilt)


def film_thickness_mm(
    impinging_mm_per_h: Quantity, length_m: Quantity, inclination_deg: Quantity = 90.0, temperature_c: Quantity = 10.0
) -> Tensor:
    """Mean thickness of the film that runs down a plate, mm.

    Args:
        impinging_mm_per_h: rain that meets the plate, 0 to 2000 mm/h.
        length_m: of the plate along the slope, 0.001 to 5 m.
        inclination_deg: from the level, 5 to 90 degrees; nearly level plates hold pools instead.
        temperature_c: of the water, 0 to 60.

    Returns:
        Float64. A cover that repels water has drops in place of the film; then this is too much.

    Example:
        >>> round(float(film_thickness_mm(117.0, 0.1)), 3)
        0.082
    """
    owner = "film_thickness_mm"
    check_broadcast(owner, impinging=impinging_mm_per_h, length=length_m, inclination=inclination_deg)
    rain, length, tilt, temperature = to_float64(impinging_mm_per_h, length_m, inclination_deg, temperature_c)
    check_between("impinging_mm_per_h", rain, 0.0, 2000.0, unit="mm/h", owner=owner)
    check_between("length_m", length, 1e-3, 5.0, unit="m", owner=owner)
    check_between("inclination_deg", tilt, 5.0, 90.0, unit="degrees", owner=owner)
    check_between("temperature_c", temperature, 0.0, 60.0, unit="degrees Celsius", owner=owner)
    viscosity = 2.414e-8 * 10.0 ** (247.8 / (temperature + 133.15))  # m^2/s
    cube = 3.0 * viscosity * (rain / 3.6e6) * length / (GRAVITY * torch.sin(torch.deg2rad(tilt)))
    wet = cube > 0
    return torch.where(wet, MEAN_OVER_PLATE * 1e3 * torch.where(wet, cube, 1.0) ** (1.0 / 3.0), 0.0)


def drop_cover(water_mm: Quantity) -> Tensor:
    """Share of a window that sitting drops cover, after some water met it: ``c (1 - exp(-w / (c d)))``.

    The first drops cover the area ``w / d``, d = 0.25 mm being the mean thickness of a drop; drops that merge and run
    off leave c = 0.55 of the window covered.

    Args:
        water_mm: that met the window since it was wiped, 0 or more; infinity is a window without a wiper.

    Returns:
        Float64, 0 to 0.55.

    Example:
        >>> drop_cover(torch.tensor([0.0, 0.01, torch.inf])).round(decimals=3)
        tensor([0.0000, 0.0390, 0.5500], dtype=torch.float64)
    """
    (water,) = to_float64(water_mm)
    check_at_least("water_mm", water, 0.0, unit="mm", owner="drop_cover")
    return -LARGEST_COVER * torch.expm1(-water / (LARGEST_COVER * MEAN_DROP_MM))


def layers_transmittance(
    refractive_index: Sequence[complex | Tensor], thickness_mm: Sequence[Quantity], wavelength_mm: float
) -> Tensor:
    """Power that passes plane layers in air at normal incidence, 0 to 1, interference included.

    Args:
        refractive_index: ``n + i k`` of each layer, in the order of the wave.
        thickness_mm: of each layer; numbers and tensors broadcast.
        wavelength_mm: in air.

    Returns:
        Float64 of the broadcast shape.

    Example:
        >>> round(float(layers_transmittance([1.6], [0.0], 3.9)), 3)  # nothing
        1.0
        >>> round(float(layers_transmittance([1.6], [3.9 / 3.2], 3.9)), 3)  # half a wave thick
        1.0
        >>> round(float(layers_transmittance([1.6], [3.9 / 6.4], 3.9)), 3)  # a quarter: 4 n^2 / (1 + n^2)^2
        0.808
    """
    check_arguments(
        "layers_transmittance(refractive_index: Sequence, thickness_mm: Sequence, wavelength_mm: float)",
        refractive_index,
        thickness_mm,
        wavelength_mm,
    )
    if len(refractive_index) != len(thickness_mm):
        raise InputValueError(
            f"layers_transmittance: expected one thickness for each layer; got {len(refractive_index)} indices and "
            f"{len(thickness_mm)} thicknesses."
        )
    check_between("wavelength_mm", wavelength_mm, 1e-5, 1e4, unit="mm", owner="layers_transmittance")
    # Characteristic matrices of the tangential fields, [[a, b], [c, d]].
    (one,) = to_complex128(1.0)
    a, b, c, d = one, 0.0 * one, 0.0 * one, one
    for index, thickness in zip(refractive_index, thickness_mm, strict=True):
        check_at_least("thickness_mm", thickness, 0.0, unit="mm", owner="layers_transmittance")
        (m,), (way,) = to_complex128(index), to_float64(thickness)
        phase = 2.0 * math.pi * m * way / wavelength_mm
        cosine, sine = torch.cos(phase), -1j * torch.sin(phase)
        a, b, c, d = (
            a * cosine + b * sine * m,
            a * sine / m + b * cosine,
            c * cosine + d * sine * m,
            c * sine / m + d * cosine,
        )
    return (2.0 / (a + b + c + d)).abs().square()


def microwave_film_loss_db(
    film_mm: Quantity,
    frequency_ghz: float,
    temperature_c: float = 10.0,
    cover_index: float = COVER_INDEX_MICROWAVE,
    cover_mm: float | None = None,
) -> Tensor:
    """Loss of a film of water on a radar's cover, one way, dB over the dry cover.

    Args:
        film_mm: thickness of the film, 0 to 2 mm, any shape.
        frequency_ghz: 1 to 300 GHz.
        temperature_c: of the water.
        cover_index: refractive index of the cover.
        cover_mm: its thickness; ``None`` is half a wave, to which covers are tuned.

    Returns:
        Float64.

    Example:
        >>> microwave_film_loss_db(torch.tensor([0.0, 0.05, 0.1]), 77.0).round(decimals=1)
        tensor([0.0000, 3.7000, 6.3000], dtype=torch.float64)
    """
    check_arguments(
        "microwave_film_loss_db(film_mm: Quantity, frequency_ghz: float, temperature_c: float, cover_index: float, "
        "cover_mm: float | None)",
        film_mm,
        frequency_ghz,
        temperature_c,
        cover_index,
        cover_mm,
    )
    owner = "microwave_film_loss_db"
    check_between("film_mm", film_mm, *FILM_MM, unit="mm", owner=owner)
    check_between("frequency_ghz", frequency_ghz, 1.0, 300.0, unit="GHz", owner=owner)
    check_between("cover_index", cover_index, 1.0, 4.0, owner=owner)
    wavelength_mm = 1e-6 * SPEED_OF_LIGHT_M_PER_S / frequency_ghz
    cover = wavelength_mm / (2.0 * cover_index) if cover_mm is None else cover_mm
    water = water_refractive_index_microwave(frequency_ghz, temperature_c)
    (film,) = to_float64(film_mm)
    wet = layers_transmittance([cover_index, water], [cover, film], wavelength_mm)
    dry = layers_transmittance([cover_index, water], [cover, torch.zeros_like(film)], wavelength_mm)
    return 10.0 * torch.log10(dry / wet)


def optical_film_transmittance(
    film_mm: Quantity, wavelength_nm: float, cover_index: float = COVER_INDEX_OPTICAL
) -> Tensor:
    """Transmittance of a wet window over that of the dry one, one way, at normal incidence.

    The window is many waves thick and the laser's line broad, so powers add: ``T_c T_w exp(-4 pi k h / lambda) / T_a``,
    T_c from cover into water, T_w from water into air, T_a from cover into air. It is above 1 where the water absorbs
    nothing, as it lies between the cover and air and reflects less than the dry surface.

    Args:
        film_mm: 0 to 2 mm.
        wavelength_nm: 300 to 2500 nm.
        cover_index: of the window.

    Returns:
        Float64; 1 for a film of 0 mm.

    Example:
        >>> [round(float(optical_film_transmittance(0.5, nm)), 2) for nm in (905.0, 1550.0)]
        [1.02, 0.6]
    """
    check_arguments(
        "optical_film_transmittance(film_mm: Quantity, wavelength_nm: float, cover_index: float)",
        film_mm,
        wavelength_nm,
        cover_index,
    )
    owner = "optical_film_transmittance"
    check_between("film_mm", film_mm, *FILM_MM, unit="mm", owner=owner)
    check_between("cover_index", cover_index, 1.0, 4.0, owner=owner)
    (film,) = to_float64(film_mm)
    index = water_refractive_index(wavelength_nm)
    n = float(index.real)

    def through(one: float, other: float) -> float:
        return 4.0 * one * other / (one + other) ** 2

    surfaces = through(cover_index, n) * through(n, 1.0) / through(cover_index, 1.0)
    absorbed = torch.exp(-4.0 * math.pi * float(index.imag) * film * 1e6 / wavelength_nm)
    return torch.where(film > 0, surfaces * absorbed, 1.0)
