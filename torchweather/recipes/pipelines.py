"""Earlier names of recipes of kind multi_sensor; they go with the next release."""

from functools import partial

from torchweather.core.moved import renamed
from torchweather.recipes.multi_sensor import MultiSensorRecipe
from torchweather.recipes.recipes import list_recipes, load_recipe, read_recipe, save_recipe

KIND = "multi_sensor"

RENAMED = {
    "Pipeline": ("torchweather.recipes.MultiSensorRecipe", MultiSensorRecipe),
    "list_pipelines": ("torchweather.recipes.list_recipes('multi_sensor')", partial(list_recipes, KIND)),
    "load_pipeline": ("torchweather.recipes.load_recipe", partial(load_recipe, kind=KIND)),
    "read_pipeline": ("torchweather.recipes.read_recipe", partial(read_recipe, kind=KIND)),
    "save_pipeline": ("torchweather.recipes.save_recipe", save_recipe),
}
__getattr__ = renamed(__name__, RENAMED)
