"""Recipes as YAML files, of kind transform, multi_sensor or suite: listed, read, loaded and saved."""

from torchweather.recipes.files import recipes_folder
from torchweather.recipes.multi_sensor import MultiSensorRecipe
from torchweather.recipes.recipes import Recipe, list_recipes, load_recipe, read_recipe, save_recipe
from torchweather.recipes.suite import Condition, SuiteRecipe
from torchweather.recipes.transform import TransformRecipe

__all__ = [
    "Condition",
    "MultiSensorRecipe",
    "Recipe",
    "SuiteRecipe",
    "TransformRecipe",
    "list_recipes",
    "load_recipe",
    "read_recipe",
    "recipes_folder",
    "save_recipe",
]
