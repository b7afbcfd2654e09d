"""Intensity of a LiDAR's point, in the sensor's unit, to signal and back.

Units (``Lidar.intensity_unit``): ``reflectivity`` (1 = Lambertian white), ``reflectivity_percent``, ``uint8_linear``
(255 = 1), ``uint8_calibrated`` (0-100 percent, above that retroreflective), ``photons``, ``none``. A signal is
X = N/K of ``PHYSICS.md`` 5.3, 1/(m^2 sr).
"""

from __future__ import annotations

import math

import numpy as np
import torch
from torch import Tensor

from torchweather.lidar.cloud_frame import are_plain

__all__ = [
    "COUNTED",
    "EIGHT_BITS",
    "FULL_SCALE",
    "LOG_STEP",
    "WHITE",
    "are_integers",
    "borrowed_intensity",
    "dimmed_intensity",
    "intensity_from_signal",
    "intensity_of_reflectivity",
    "reflectivity_from_intensity",
    "zero_intensity",
]

# Largest value of a unit; None where there is no end.
FULL_SCALE: dict[str, float | None] = {
    "reflectivity": None,
    "reflectivity_percent": None,
    "uint8_linear": 255.0,
    "uint8_calibrated": 255.0,
    "photons": None,
    "none": None,
}
# Value of a white Lambertian target.
WHITE = {"reflectivity": 1.0, "reflectivity_percent": 100.0, "uint8_linear": 255.0, "uint8_calibrated": 100.0}
# uint8_calibrated above 100 is logarithmic up to this reflectivity at 255 (generic: makers do not publish it).
RETROREFLECTIVE_AT_255 = 100.0
LOG_STEP = math.log(RETROREFLECTIVE_AT_255) / 155.0
# Units whose values may be integers; those are then rounded down.
COUNTED = ("reflectivity_percent", "uint8_linear", "uint8_calibrated", "photons")

EIGHT_BITS = ("uint8_linear", "uint8_calibrated")
# Step of KITTI's intensities, and how far off its multiples their float32 may lie, in steps.
HUNDREDTH = 0.01
OFF_STEP = 1e-3


def are_integers(intensity: Tensor, unit: str) -> Tensor:
    """Check whether all intensities of a sample ``(B, N)`` are integers of a unit that counts, bool ``(B, 1)``."""
    if unit not in COUNTED:
        return torch.zeros_like(intensity[..., :1], dtype=torch.bool)
    if are_plain(intensity):
        return _all_multiples(intensity, 1.0, 0.0)[0]
    return (intensity == intensity.floor()).all(-1, keepdim=True)


def zero_intensity(intensity: Tensor, unit: str, given: float | None = None, integral: Tensor | None = None) -> Tensor:
    """Intensity that a value of 0 stands for, ``(..., 1)``: the middle of what is rounded to it.

    A sensor that counts in steps reports 0 for ``[0, step)``. The step is 1 for units of 8 bits whose values are all
    integers, and 0.01 for reflectivities that are all multiples of it (KITTI). Of other data 0 is 0.

    Args:
        intensity: ``(..., N)`` of one sensor.
        unit: see the module.
        given: the answer where it is known, ``Lidar.zero_intensity``.
        integral: that of ``are_integers``, where it is known.

    Example:
        >>> zero_intensity(torch.tensor([[0.0, 0.31, 0.02]]), "reflectivity")
        tensor([[0.0050]])
    """
    if given is not None:
        return torch.full_like(intensity[..., :1], given)
    if unit in EIGHT_BITS:
        return 0.5 * (are_integers(intensity, unit) if integral is None else integral).to(intensity)
    if unit != "reflectivity":
        return torch.zeros_like(intensity[..., :1])
    if are_plain(intensity):
        stepped, some = _all_multiples(intensity, HUNDREDTH, OFF_STEP)
        return 0.5 * HUNDREDTH * (stepped & some).to(intensity)
    steps = intensity / HUNDREDTH
    stepped = ((steps - steps.round()).abs() < OFF_STEP).all(-1, keepdim=True)
    return 0.5 * HUNDREDTH * (stepped & (intensity > 0).any(-1, keepdim=True)).to(intensity)


def _all_multiples(intensity: Tensor, step: float, off: float) -> tuple[Tensor, Tensor]:
    """For each sample, bool ``(..., 1)``: all are multiples of a step, one is above 0 (where all are); compiled."""
    from torchweather.lidar.compiled_cloud import all_multiples

    rows = intensity.detach().reshape(-1, intensity.shape[-1])
    found = [all_multiples(row.numpy(), np.float32(step), np.float32(off)) for row in rows]
    of_samples = torch.tensor(found, dtype=torch.bool).reshape(*intensity.shape[:-1], 2)
    return of_samples[..., :1], of_samples[..., 1:]


def borrowed_intensity(intensity: Tensor, seen: Tensor, unit: str) -> Tensor | None:
    """Value of an object for each beam, ``(B, N)``, where the column has no meaning; ``None`` where it has one.

    It is the beam's own where it has an object, else that of the object before it, so that particles have the objects'
    own distribution: a constant would tell them apart. A cloud without objects gives 1.

    Args:
        intensity: ``(B, N)``.
        seen: ``(B, N)`` bool, whether the beam has an object.
        unit: see the module.

    Example:
        >>> column = torch.tensor([[0.0, 120.0, 0.0, 80.0]])
        >>> borrowed_intensity(column, column > 0, "none")
        tensor([[120., 120., 120.,  80.]])
    """
    if unit != "none":
        return None
    beams = seen.shape[1]
    row = torch.arange(beams, device=seen.device).expand(seen.shape)
    objects = torch.where(seen, row, row + beams).sort(1).values  # rows with an object first, in order
    number = seen.to(torch.int64).cumsum(1) - 1  # of the object at or before each row, -1 where there is none
    found = intensity.gather(1, objects.gather(1, number.clamp_min(0)).clamp_max(beams - 1))
    return torch.where(seen.any(1, keepdim=True), found, 1.0)


def reflectivity_from_intensity(intensity: Tensor, unit: str, assumed: float) -> Tensor:
    """Apparent Lambertian reflectivity; for every unit but ``photons``. The calibrated scale ends at 255.

    Args:
        intensity: in the unit.
        unit: see the module.
        assumed: reflectivity where the unit is ``none``.
    """
    if unit == "none":
        return torch.full_like(intensity, assumed)
    linear = intensity / WHITE[unit]
    if unit != "uint8_calibrated":
        return linear
    # Values that 8 bits cannot hold count as 255: the exponential of 3087 would overflow.
    above = torch.exp((intensity.clamp_max(255.0) - 100.0) * LOG_STEP)
    return torch.where(intensity > 100.0, above, linear)


def _intensity_from_reflectivity(reflectivity: Tensor, unit: str) -> Tensor:
    linear = reflectivity * WHITE[unit]
    if unit != "uint8_calibrated":
        return linear
    return torch.where(reflectivity > 1.0, 100.0 + reflectivity.clamp_min(1.0).log() / LOG_STEP, linear)


def dimmed_intensity(intensity: Tensor, gain: Tensor, unit: str, integral: Tensor) -> Tensor:
    """Intensity of an object whose signal became ``gain`` times what it was; bit for bit the input where gain is 1.

    Args:
        intensity: ``(B, N)`` in the unit.
        gain: ``(B, N)``.
        unit: see the module.
        integral: ``(B, 1)`` whether the sample's values are integers. They were rounded down by the sensor, so the
            middle of the step is dimmed and rounded down again.
    """
    if unit == "none":
        return intensity
    # The middle of the step an integer stands for: the sensor rounded down.
    middle = torch.where(integral, intensity + 0.5, intensity) if unit in COUNTED else intensity
    if unit == "uint8_calibrated":
        # In the logarithmic part the logarithm of the gain adds; below it the value is linear again.
        brighter = middle + gain.clamp_min(1e-30).log() / LOG_STEP
        above = torch.where(brighter > 100.0, brighter, 100.0 * torch.exp((brighter - 100.0) * LOG_STEP))
        dimmed = torch.where(middle > 100.0, above, middle * gain)
    else:
        dimmed = middle * gain
    if unit in COUNTED:
        dimmed = torch.where(integral, dimmed.floor(), dimmed)
    full = FULL_SCALE[unit]
    if full is not None:
        dimmed = torch.where(integral, dimmed.clamp_max(full), dimmed)
    return torch.where(gain == 1.0, intensity, dimmed)


def intensity_from_signal(
    signal: Tensor, range_m: Tensor, unit: str, integral: Tensor, photons_per_signal: Tensor
) -> Tensor:
    """Intensity of a particle, from its equivalent reflectivity ``pi X R^2``; integers are rounded down.

    For every unit but ``none``, whose particles have a `borrowed_intensity`.

    Args:
        signal: X, ``(B, N)``.
        range_m: R, ``(B, N)``.
        unit: see the module.
        integral: ``(B, 1)``, as above.
        photons_per_signal: K, photons m^2 sr, for the unit ``photons``.
    """
    return intensity_of_reflectivity(math.pi * signal * range_m.square(), signal * photons_per_signal, unit, integral)


def intensity_of_reflectivity(reflectivity: Tensor, photons: Tensor, unit: str, integral: Tensor) -> Tensor:
    """Intensity of a return, from its reflectivity, or from its photons where those are the unit.

    Args:
        reflectivity: ``(B, N)``, 1 = Lambertian white.
        photons: ``(B, N)``, counted.
        unit: see the module; ``none`` gives 1.
        integral: ``(B, 1)``, as above.
    """
    if unit == "none":
        return torch.ones_like(reflectivity)
    found = photons if unit == "photons" else _intensity_from_reflectivity(reflectivity, unit)
    if unit in COUNTED:
        rounded = torch.floor(found)
        ceiling = FULL_SCALE[unit]
        found = torch.where(integral, rounded if ceiling is None else rounded.clamp_max(ceiling), found)
    return found
