"""Moved to ``torchweather.gap.study.folders``; this path goes with the next release."""

from torchweather.core.moved import moved

__getattr__ = moved(__name__, "torchweather.gap.study.folders")
