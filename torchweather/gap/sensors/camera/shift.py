"""Displacement of camera frames: each colour's regression on the gradients of the clear scene.

Light that is moved by a displacement d departs by ``-d . grad I``. The sum of ``residual * gradient`` over that of
squared gradients is the displacement of an image as a whole, across and down, in pixels; with the gradient along the
radius, the radius its weight, how far the corners move outward. Of all colours that is a camera that was knocked or
focused anew, of one colour a lens whose magnification depends on it.

References:
    Lucas & Kanade 1981 (regression on gradients). ISO 19084:2015 (chromatic displacement).
"""

from __future__ import annotations

import math

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from torchweather.gap.sensors.camera.bins import Key
from torchweather.gap.sensors.camera.edges import SHARED_CELLS

__all__ = ["MOTIONS", "Shifts", "shift_name"]

Floats = NDArray[np.float64]

MOTIONS = ("across", "down", "outward")
CELL_PX = 2.0  # pixels that a cell is wide


def shift_name(motion: str, colour: str) -> str:
    """Name of a statistic.

    Example:
        >>> shift_name("outward", "blue")
        'shift_outward_px_blue'
    """
    return f"shift_{motion}_px_{colour}"


def gradients(light: Tensor) -> Tensor:
    """Change of light ``(C, h, w)`` from a cell to the next, per pixel: across, down and outward, ``(3, C, h, w)``.

    0 at the border. Outward is along the radius, times the radius over that of the corners.
    """
    height, width = light.shape[-2:]
    across, down = torch.zeros_like(light), torch.zeros_like(light)
    across[..., 1:-1, 1:-1] = (light[..., 1:-1, 2:] - light[..., 1:-1, :-2]) / (2.0 * CELL_PX)
    down[..., 1:-1, 1:-1] = (light[..., 2:, 1:-1] - light[..., :-2, 1:-1]) / (2.0 * CELL_PX)
    y, x = (torch.arange(size, dtype=light.dtype) - 0.5 * (size - 1) for size in (height, width))
    corner = 0.5 * math.hypot(height - 1, width - 1)
    return torch.stack([across, down, (across * x + down * y[:, None]) / corner])


class Shifts:
    """Displacement of each colour, class by class.

    Args:
        light: ``(C, h, w)`` of the cells as the model has them.
        noise_variance: c and v of the variance ``c + v I`` of a cell's green.
        classes: ``(h, w)`` of each cell, -1 for none.
        number: of classes.
        colours: names, in rising order; a cell has two greens and one of each other.
        axis: along which the classes lie.
    """

    def __init__(
        self,
        light: Tensor,
        noise_variance: tuple[float, float],
        classes: Tensor,
        number: int,
        colours: tuple[str, ...],
        axis: str,
    ) -> None:
        slope = gradients(light).flatten(2).swapaxes(0, 1)  # (C, motions, cells)
        inside = classes.flatten() == torch.arange(number)[:, None]  # (classes, cells)
        self._slope = (slope[:, :, None] * inside).flatten(1, 2)  # (C, motions classes, cells)
        pixels = torch.tensor([1.0 if colour == "green" else 0.5 for colour in colours])[:, None]
        self._variance = (noise_variance[0] + noise_variance[1] * light.flatten(1)) / pixels
        # Weights sum up to the number of independent cells, were all as steep.
        square = slope.square().where(inside.any(0), 0.0).sum(-1) / max(int(inside.sum()), 1)
        scale = SHARED_CELLS * square.double().clamp_min(1e-12)
        self._scale = scale.repeat_interleave(number, 1)  # (C, motions classes)
        self.place: dict[Key, slice] = {}
        for place, (colour, motion) in enumerate((colour, motion) for colour in colours for motion in MOTIONS):
            self.place[shift_name(motion, colour), axis] = slice(place * number, (place + 1) * number)
        self._known = self._weights(None, 1)

    def sums(self, residual: Tensor, portion: Tensor | None, portions: int) -> tuple[Floats, Floats, Floats]:
        """Sums ``(F * portions, bins)`` of weights, of displacements in px, and of what noise makes of their squares.

        Args:
            residual: ``(F, C, h, w)`` frames less the model.
            portion: ``(h w,)`` of each cell; ``None``: all are one.
            portions: number of them.
        """
        flat = residual.flatten(2)
        found = [
            torch.einsum("fcn,crn->fcr", flat[..., own], self._slope[..., own]).double().div_(-self._scale)
            for own in _cells(portion, portions)
        ]
        total = torch.stack(found, 1).reshape(len(flat) * portions, -1).numpy()
        weight, noise = self._known if portion is None else self._weights(portion, portions)
        return np.tile(weight, (len(flat), 1)), total, np.tile(noise, (len(flat), 1))

    def _weights(self, portion: Tensor | None, portions: int) -> tuple[Floats, Floats]:
        """Sums ``(portions, bins)`` of weights and of the squared noise of displacements."""
        square = self._slope.square()
        weights, noises = [], []
        for own in _cells(portion, portions):
            weights.append(square[..., own].sum(-1).double() / self._scale)
            noise = (square * self._variance[:, None])[..., own].sum(-1).double()
            noises.append(SHARED_CELLS * noise / self._scale.square())
        return tuple(torch.stack(each).reshape(portions, -1).numpy() for each in (weights, noises))  # type: ignore[return-value]


def _cells(portion: Tensor | None, portions: int) -> list[Tensor | slice]:
    """Mask of the cells in each portion."""
    return [slice(None)] if portion is None else [portion == number for number in range(portions)]
