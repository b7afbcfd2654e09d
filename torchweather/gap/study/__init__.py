"""Study: scenes and conditions, the folder that holds them, recorded and simulated frames."""

from torchweather.core.moved import moved

__getattr__ = moved(__name__, "torchweather.gap.study.study")
