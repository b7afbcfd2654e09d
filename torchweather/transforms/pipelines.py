"""Earlier path of recipes of kind multi_sensor; it goes with the next release."""

from torchweather.recipes.pipelines import __getattr__ as __getattr__
