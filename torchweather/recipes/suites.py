"""Earlier names of recipes of kind suite; they go with the next release."""

from functools import partial

from torchweather.core.moved import renamed
from torchweather.recipes.recipes import list_recipes, read_recipe
from torchweather.recipes.suite import SEVERITIES, Condition, SuiteRecipe

RENAMED = {
    "SEVERITIES": ("torchweather.recipes.suite.SEVERITIES", SEVERITIES),
    "Condition": ("torchweather.recipes.Condition", Condition),
    "Suite": ("torchweather.recipes.SuiteRecipe", SuiteRecipe),
    "list_suites": ("torchweather.recipes.list_recipes('suite')", partial(list_recipes, "suite")),
    "read_suite": ("torchweather.recipes.read_recipe", partial(read_recipe, kind="suite")),
}
__getattr__ = renamed(__name__, RENAMED)
