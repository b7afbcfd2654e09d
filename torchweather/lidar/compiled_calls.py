"""Calls of the compiled detection and reading (``compiled_detection.py``), beside stages that stay with torch.

Results equal those of torch to rounding: ln and exp by polynomials (2e-7).
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import torch
from torch import Tensor

from torchweather.lidar.intensity import LOG_STEP, WHITE
from torchweather.lidar.returns.compiled_calls import NO_ROW, array_of, is_plain
from torchweather.lidar.sensor import Lidar

if TYPE_CHECKING:
    from torchweather.lidar.compiled_beams import Receiver

__all__ = ["MODES", "chosen_echoes", "is_plain", "read_echoes"]

MODES = ("strongest", "first", "last", "dual")
"""Return modes, by the number that compiled loops have for them."""


def chosen_echoes(
    range_m: Tensor, signal: Tensor, kind: Tensor, threshold: Tensor, clear_m: Tensor, sensor: Lidar
) -> tuple[Tensor, Tensor, Tensor]:
    """Range, signal and kind ``(B, N, reported)`` of the reported echoes, as of ``Detection``.

    Args:
        range_m, signal, kind: ``(B, N, echoes)``, the object's echo first.
        threshold: ``()`` or ``(B, 1 or N)``.
        clear_m: ``(B, N)`` range of the objects, 0 without one.
        sensor: gives the return mode.
    """
    from torchweather.lidar.compiled_detection import choose_echoes

    of_echoes = [values.transpose(1, 2).contiguous().numpy() for values in (range_m, signal, kind)]
    batch, _, count = of_echoes[0].shape
    least = array_of(threshold.reshape(-1, threshold.shape[-1] if threshold.ndim else 1))
    reported = 2 if sensor.return_mode == "dual" else 1
    found = [torch.empty(batch, reported, count, dtype=values.dtype) for values in (range_m, signal, kind)]
    clear, receiver = array_of(clear_m), _receiver(sensor)
    found_m, found_signal, found_kind = (values.numpy() for values in found)
    ranges, signals, kinds = of_echoes
    for one in range(batch):
        own = least[min(one, len(least) - 1)]
        written = found_m[one], found_signal[one], found_kind[one]
        choose_echoes(*written, ranges[one], signals[one], kinds[one], own, clear[one], receiver)
    found_1, found_2, found_3 = (values.transpose(1, 2) for values in found)
    return found_1, found_2, found_3


def read_echoes(
    of_echo: tuple[Tensor, Tensor, Tensor],
    of_clear: tuple[Tensor, Tensor],
    points: Tensor,
    borrowed: Tensor | None,
    noise: Tensor | None,
    integral: Tensor,
    threshold: Tensor,
    sensor: Lidar,
) -> tuple[Tensor, Tensor]:
    """Range and intensity ``(B, N)`` of one reported echo, as of ``ToPoints.measurement``.

    Args:
        of_echo: its range, signal and kind ``(B, N)``.
        of_clear: range and signal ``(B, N)`` of the objects in clear air.
        points: ``(B, N, C)`` that came in.
        borrowed: ``(B, N)`` intensity of a particle, where it is not read from its signal.
        noise: ``(B, N)`` of the range of a particle.
        integral: ``(B, 1)`` whether intensities are integers.
        threshold: ``()`` of the sensor.
        sensor: gives unit, noise and resolution.
    """
    from torchweather.lidar.compiled_detection import read_echo

    range_m, signal, kind = (values.contiguous().numpy() for values in of_echo)
    clear_m, clear_signal = (array_of(values) for values in of_clear)
    given, receiver = array_of(points), _receiver(sensor, float(threshold))
    found_m, found_intensity = (torch.empty(*range_m.shape) for _ in range(2))
    for one in range(len(range_m)):
        read_echo(
            found_m[one].numpy(),
            found_intensity[one].numpy(),
            range_m[one],
            signal[one],
            kind[one],
            clear_m[one],
            clear_signal[one],
            given[one],
            NO_ROW if borrowed is None else array_of(borrowed[one]),
            NO_ROW if noise is None else array_of(noise[one]),
            bool(integral[min(one, len(integral) - 1), 0]),
            receiver,
        )
    return found_m, found_intensity


def _receiver(sensor: Lidar, threshold: float = 0.0) -> Receiver:
    """Numbers of a sensor that detection and reading look at; the others are 0."""
    from torchweather.lidar.compiled_beams import UNITS, Receiver

    single = {
        "threshold": threshold,
        "nearest_m": sensor.near_start_m,
        "apart_m": sensor.echo_separation,
        "white": WHITE.get(sensor.intensity_unit, 0.0),
        "log_step": LOG_STEP,
        "photons_at_threshold": sensor.photons_at_threshold,
        "range_noise_m": sensor.range_noise_m,
        "range_step_m": sensor.range_resolution_m,
    }
    unit, mode = UNITS[sensor.intensity_unit], MODES.index(sensor.return_mode)
    fields = [name for name in Receiver._fields if name not in ("unit", "mode")]
    return Receiver(**{name: np.float32(single.get(name, 0.0)) for name in fields}, unit=unit, mode=mode)
