"""Moved to ``torchweather.evaluation.validation.run``; this path goes with the next release."""

from torchweather.core.moved import moved

__getattr__ = moved(__name__, "torchweather.evaluation.validation.run")
