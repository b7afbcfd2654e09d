"""Fall speeds of raindrops and snowflakes in still air at sea level."""

from __future__ import annotations

import torch
from torch import Tensor

from torchweather.core.arguments import check_arguments, check_broadcast
from torchweather.core.errors import check_at_least, check_one_of
from torchweather.physics.float64 import Quantity, to_float64
from torchweather.physics.snow_geometry import melted_diameter_mm

__all__ = [
    "RAIN_LAWS",
    "fall_speed_after_m_per_s",
    "flake_fall_speed_m_per_s",
    "rain_fall_speed_m_per_s",
    "snow_fall_speed_m_per_s",
]

STANDARD_GRAVITY_M_PER_S2 = 9.80665

RAIN_LAWS = ("brandes", "atlas-1973", "atlas-ulbrich")

# Brandes et al. 2002: v in m/s, D in mm, powers 0 to 4; within 4 % of Gunn & Kinzer for 0.5-5.8 mm, PHYSICS.md 2.5
BRANDES_2002 = (-0.1021, 4.932, -0.9551, 0.07934, -0.002362)
# Gunn & Kinzer 1949 (measured) below 0.5 mm, where the polynomial is up to 40 % high, PHYSICS.md 2.5
GUNN_KINZER_SMALL_MM = (0.0, 0.1, 0.2, 0.3)
GUNN_KINZER_SMALL_M_PER_S = (0.0, 0.27, 0.72, 1.17)
BRANDES_FROM_MM = 0.5
LARGEST_M_PER_S = 9.17  # Gunn & Kinzer 1949 at 5.8 mm, their largest drop
LARGEST_FROM_MM = 5.0  # the polynomial reaches 9.17 m/s at 5.6 mm: taking the smaller of the two joins without a step


def rain_fall_speed_m_per_s(diameter_mm: Quantity, law: str = "brandes") -> Tensor:
    """Terminal speed of raindrops, m/s.

    ``"brandes"``: the polynomial of Brandes et al. 2002 from 0.5 mm, linear between the speeds Gunn & Kinzer measured
    below (0 at 0), held at their 9.17 m/s above 5.8 mm; continuous. ``"atlas-1973"``:
    ``max(0, 9.65 - 10.3 e^{-0.6 D})``.
    ``"atlas-ulbrich"``: ``3.78 D^0.67`` (D3.4's law; valid 0.5-5 mm, 22 % high at 5 mm).

    Args:
        diameter_mm: drop diameter, mm, any shape, 0 or more.
        law: one of ``RAIN_LAWS``.

    Returns:
        m/s, float64, same shape.

    Note:
        The default is within 4 % of Gunn & Kinzer's measurements (0.1-5.8 mm).

    References:
        PHYSICS.md 2.5; Brandes et al. 2002; Gunn & Kinzer 1949; Atlas et al. 1973; Atlas & Ulbrich 1977.

    Example:
        >>> rain_fall_speed_m_per_s(torch.tensor([0.1, 1.0, 5.0])).round(decimals=2)
        tensor([0.2700, 3.9500, 9.1200], dtype=torch.float64)
    """
    check_arguments("rain_fall_speed_m_per_s(diameter_mm: Quantity, law: str)", diameter_mm, law)
    check_one_of("law", law, RAIN_LAWS, owner="rain_fall_speed_m_per_s")
    (diameter,) = to_float64(diameter_mm)
    check_at_least("diameter_mm", diameter, 0.0, unit="mm", owner="rain_fall_speed_m_per_s")
    if law == "atlas-1973":
        return (9.65 - 10.3 * torch.exp(-0.6 * diameter)).clamp_min(0.0)  # negative below 0.109 mm
    if law == "atlas-ulbrich":
        return 3.78 * diameter**0.67
    held = torch.where(diameter > LARGEST_FROM_MM, _brandes(diameter).clamp_max(LARGEST_M_PER_S), _brandes(diameter))
    # The polynomial turns down beyond 6 mm, where the speed is held.
    held = torch.where(diameter > 5.8, torch.full_like(held, LARGEST_M_PER_S), held)
    return torch.where(diameter < BRANDES_FROM_MM, _between_measured(diameter), held)


def fall_speed_after_m_per_s(terminal_m_per_s: Quantity, fall_m: Quantity) -> Tensor:
    """Speed of a particle that has fallen from rest over a height, as a sprinkler's drops have.

    With a drag that grows as the square of the speed, ``v = v_t sqrt(1 - exp(-2 g h / v_t^2))``. Drops of one flux are
    as many more as they are slower: ``v_t / v`` times the density of natural rain.

    Args:
        terminal_m_per_s: v_t, m/s, 0 or more, ``(...,)``, such as `rain_fall_speed_m_per_s`.
        fall_m: h, m, 0 or more; broadcast against it. Infinity gives the terminal speed.

    Returns:
        m/s, float64.

    Note:
        The drag of small drops grows more slowly than that; below 0.5 mm they have their speed within a metre or so.

    References:
        Motion under gravity and quadratic drag, in any book of mechanics.

    Example:
        >>> fall_speed_after_m_per_s(rain_fall_speed_m_per_s(torch.tensor([0.5, 4.0])), 3.0).round(decimals=2)
        tensor([2.1300, 6.4200], dtype=torch.float64)
    """
    owner = "fall_speed_after_m_per_s"
    check_arguments("fall_speed_after_m_per_s(terminal_m_per_s: Quantity, fall_m: Quantity)", terminal_m_per_s, fall_m)
    terminal, height = to_float64(terminal_m_per_s, fall_m)
    check_broadcast(owner, terminal_m_per_s=terminal, fall_m=height)
    check_at_least("terminal_m_per_s", terminal, 0.0, unit="m/s", owner=owner)
    check_at_least("fall_m", height, 0.0, unit="m", owner=owner)
    still = terminal == 0
    square = torch.where(still, 1.0, terminal).square()
    speed = (square * -torch.expm1(-2.0 * STANDARD_GRAVITY_M_PER_S2 * height / square)).sqrt()
    return torch.where(still, torch.zeros_like(speed), speed)


def _brandes(diameter: Tensor) -> Tensor:
    speed = torch.full_like(diameter, BRANDES_2002[4])
    for coefficient in BRANDES_2002[3::-1]:
        speed = speed * diameter + coefficient
    return speed


def _between_measured(diameter: Tensor) -> Tensor:
    """Linear between Gunn & Kinzer's speeds; the last node is the polynomial at 0.5 mm: a continuous join."""
    nodes = (*GUNN_KINZER_SMALL_MM, BRANDES_FROM_MM)
    at_join = sum(c * BRANDES_FROM_MM**power for power, c in enumerate(BRANDES_2002))
    speeds = (*GUNN_KINZER_SMALL_M_PER_S, at_join)
    speed = torch.zeros_like(diameter)
    for k in range(len(nodes) - 1):  # a sum of ramps: elementwise, so it exports and has a gradient
        slope = (speeds[k + 1] - speeds[k]) / (nodes[k + 1] - nodes[k])
        speed = speed + slope * (diameter - nodes[k]).clamp(0.0, nodes[k + 1] - nodes[k])
    return speed


def snow_fall_speed_m_per_s(melted_diameter_mm: Quantity, *, variant: str = "default") -> Tensor:
    """Terminal speed of dry snowflakes, m/s: ``2.07 (D / 10)^0.31``, D the *melted* diameter in mm.

    Args:
        melted_diameter_mm: diameter of the melted flake, mm, any shape, 0 or more.
        variant: ``"d3_4"`` is D3.4's ``2 (10 D)^0.31``, four times too fast (a law for cm, fed with mm).

    References:
        PHYSICS.md 2.5; Gunn & Marshall 1958 (Langleben's law, primary text not seen).

    Example:
        >>> round(float(snow_fall_speed_m_per_s(1.0)), 2)
        1.01
    """
    check_arguments("snow_fall_speed_m_per_s(melted_diameter_mm: Quantity, variant: str)", melted_diameter_mm, variant)
    check_one_of("variant", variant, ("default", "d3_4"), owner="snow_fall_speed_m_per_s")
    (melted,) = to_float64(melted_diameter_mm)
    check_at_least("melted_diameter_mm", melted, 0.0, unit="mm", owner="snow_fall_speed_m_per_s")
    return 2.0 * (10.0 * melted) ** 0.31 if variant == "d3_4" else 2.07 * (0.1 * melted) ** 0.31


def flake_fall_speed_m_per_s(physical_diameter_mm: Quantity, *, variant: str = "default") -> Tensor:
    """Terminal speed of dry snowflakes by their *physical* diameter, m/s: the law above at the melted diameter.

    Args:
        physical_diameter_mm: diameter of the flake, mm, any shape.
        variant: as in ``snow_fall_speed_m_per_s``.

    Example:
        >>> round(float(flake_fall_speed_m_per_s(2.2947)), 2)
        1.01
    """
    check_arguments(
        "flake_fall_speed_m_per_s(physical_diameter_mm: Quantity, variant: str)",
        physical_diameter_mm,
        variant,
    )
    return snow_fall_speed_m_per_s(melted_diameter_mm(physical_diameter_mm), variant=variant)
