"""Earlier path of recipes of kind multi_sensor; it goes with the next release."""

from torchweather.core.moved import renamed

__getattr__ = renamed(__name__, "torchweather.recipes.pipelines")
