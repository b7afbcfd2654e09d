"""Moved to ``torchweather.camera.particles.veil``; this path goes with the next release."""

from torchweather.core.moved import moved

__getattr__ = moved(__name__, "torchweather.camera.particles.veil")
