"""Earlier path of recipes of kind suite; it goes with the next release."""

from torchweather.core.moved import renamed

__getattr__ = renamed(__name__, "torchweather.recipes.suites")
