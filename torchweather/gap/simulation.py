"""Moved to ``gap.study.simulation`` and ``gap.sensors``; this path goes with the next release."""

from torchweather.core.moved import moved

PLACES = ("study.simulation", *(f"sensors.{kind}.study_kind" for kind in ("lidar", "camera", "radar", "link")))
__getattr__ = moved(__name__, [f"torchweather.gap.{place}" for place in PLACES])
