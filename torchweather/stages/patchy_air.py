"""Moved to ``torchweather.atmosphere.density_field``; this path goes with the next release."""

from torchweather.core.moved import moved

__getattr__ = moved(__name__, "torchweather.atmosphere.density_field")
