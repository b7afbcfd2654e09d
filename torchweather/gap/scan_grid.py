"""Moved to ``torchweather.gap.study.scan_grid``; this path goes with the next release."""

from torchweather.core.moved import moved

__getattr__ = moved(__name__, "torchweather.gap.study.scan_grid")
