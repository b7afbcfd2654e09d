"""Motion of particles over the image: how long and in which direction streaks are, over the whole frame."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

__all__ = ["ImageMotion", "Streaks"]

Array = NDArray[np.float64]

NODES = 3  # Gauss-Legendre nodes across the frame and down it
SPEED_STEP_M_PER_S = 0.25  # to which a drift is rounded: frames of a drive share their tables


@dataclass(frozen=True)
class Streaks:
    """Streaks of particles of each size at one place of the frame.

    Args:
        weight: of the place in the mean over the frame.
        speed_m_per_s: ``(K,)`` speed over the image, times depth over focal length.
        cosine, sine: ``(K,)`` of the angle between the streak and the haze's axis.
    """

    weight: float
    speed_m_per_s: Array
    cosine: Array
    sine: Array


@dataclass(frozen=True)
class ImageMotion:
    """Velocity of the air relative to the camera, and the frame that it is seen in.

    Args:
        down: direction of the fall in the camera's frame (right, down, forward).
        drift_m_per_s: wind less the vehicle's speed, likewise.
        x, y: first and last normalised coordinate of the frame, undistorted.
        steep, slope: axis of the haze's noise: down the image or across it, and the pixels aside per step.
    """

    down: tuple[float, float, float]
    drift_m_per_s: tuple[float, float, float]
    x: tuple[float, float]
    y: tuple[float, float]
    steep: bool
    slope: float

    @property
    def still(self) -> bool:
        """True where all streaks run straight down, as long as their fall."""
        return self.down == (0.0, 1.0, 0.0) and self.drift_m_per_s == (0.0, 0.0, 0.0)

    def rounded(self) -> ImageMotion:
        """The same with a drift in steps of 0.25 m/s and a slope in hundredths."""
        drift = tuple(round(v / SPEED_STEP_M_PER_S) * SPEED_STEP_M_PER_S + 0.0 for v in self.drift_m_per_s)
        return ImageMotion(self.down, drift, self.x, self.y, self.steep, round(self.slope, 2))  # type: ignore[arg-type]

    def streaks(self, fall_m_per_s: Array) -> list[Streaks]:
        """Streaks at the nodes of a quadrature over the frame.

        A particle at (x, y, 1) Z with the velocity v moves over the image as ``(v_x - x v_z, v_y - y v_z) / Z``.

        Args:
            fall_m_per_s: ``(K,)`` fall speed of each size.
        """
        nodes, weights = np.polynomial.legendre.leggauss(NODES)
        vx, vy, vz = (d * fall_m_per_s + w for d, w in zip(self.down, self.drift_m_per_s, strict=True))
        axis = math.atan2(self.slope, 1.0) if self.steep else math.atan2(1.0, self.slope)  # from straight down
        found = []
        for place_x, weight_x in zip(nodes.tolist(), weights.tolist(), strict=True):
            x = 0.5 * (self.x[0] + self.x[1]) + 0.5 * (self.x[1] - self.x[0]) * place_x
            for place_y, weight_y in zip(nodes.tolist(), weights.tolist(), strict=True):
                y = 0.5 * (self.y[0] + self.y[1]) + 0.5 * (self.y[1] - self.y[0]) * place_y
                across, along = vx - x * vz, vy - y * vz
                angle = np.arctan2(across, along) - axis
                found.append(Streaks(0.25 * weight_x * weight_y, np.hypot(across, along), np.cos(angle), np.sin(angle)))
        return found
