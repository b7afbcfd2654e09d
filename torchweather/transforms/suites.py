"""Earlier path of recipes of kind suite; it goes with the next release."""

from torchweather.recipes.suites import __getattr__ as __getattr__
