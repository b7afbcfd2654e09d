"""Base of the effects that a bench hides: one strength that is swept, and what several of them do."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from .lidar_shot import Echoes, Effect
from .scene import FloatArray

__all__ = ["Known", "power", "scale_all", "turn"]


def power(db: FloatArray | float) -> FloatArray:
    """Ratio of powers from decibels."""
    return np.asarray(10.0 ** (0.1 * np.asarray(db)))


def turn(angle_rad: FloatArray) -> FloatArray:
    """An angle in -pi..pi."""
    return np.asarray(np.mod(angle_rad + np.pi, 2.0 * np.pi) - np.pi)


def scale_all(echoes: Echoes, gain: FloatArray) -> None:
    """Multiply every echo of a beam by its gain ``(N,)``."""
    echoes.target = echoes.target * gain
    echoes.signal = echoes.signal * gain[echoes.beam]


@dataclass
class Known(Effect):
    """An effect of the catalogue with its parameters.

    ``swept`` is the parameter that sets its strength, ``weak`` and ``strong`` the ends between which the strength is
    looked for; ``fixed`` draws the others; ``differs`` says that it is another one in every frame.
    """

    parameters: dict[str, float]
    name: ClassVar[str] = ""
    same_form: ClassVar[bool] = True
    swept: ClassVar[str] = ""
    weak: ClassVar[float] = 0.0
    strong: ClassVar[float] = 0.0
    two_sided: ClassVar[bool] = False
    differs: ClassVar[bool] = False

    @property
    def value(self) -> float:
        """The swept parameter."""
        return self.parameters[self.swept]

    @classmethod
    def fixed(cls, rng: np.random.Generator) -> dict[str, float]:
        """The parameters that are not swept, drawn."""
        return {}

    @classmethod
    def at(cls, strength: float, fixed: Mapping[str, float]) -> Known:
        """The effect where ``strength`` (0 to 1, or -1 to 1 where both signs have a meaning) sets the swept one."""
        size = cls.weak * (cls.strong / cls.weak) ** abs(strength)
        return cls({cls.swept: float(np.sign(strength) * size), **fixed})
