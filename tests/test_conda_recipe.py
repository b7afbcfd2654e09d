"""The recipe of the conda package says what pyproject.toml says, and renders where rattler-build is installed."""

from __future__ import annotations

import tomllib
from pathlib import Path
from typing import Any

import pytest
import yaml

import torchweather

ROOT = Path(__file__).parents[1]
FILE = ROOT / "conda" / "recipe.yaml"
# Names at conda-forge that differ from those of PyPI.
CONDA_NAMES = {"torch": "pytorch", "matplotlib": "matplotlib-base"}


@pytest.fixture(scope="module")
def project() -> dict[str, Any]:
    found: dict[str, Any] = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
    return found


def named(dependency: str) -> str:
    """``PyYAML>=6.0`` as conda writes it."""
    name, _, bound = dependency.partition(">=")
    return f"{CONDA_NAMES.get(name, name.lower())} >={bound}"


def test_the_recipe_says_what_the_project_says(project: dict[str, Any]) -> None:
    recipe = yaml.safe_load(FILE.read_text(encoding="utf-8"))
    about = project["project"]
    assert recipe["context"]["version"] == torchweather.__version__
    python = f"python {about['requires-python']}"
    assert recipe["requirements"]["run"] == [python, *map(named, about["dependencies"])]
    (backend,) = project["build-system"]["requires"]
    assert recipe["requirements"]["host"] == [python, "pip", named(backend)]
    (script,) = about["scripts"].items()
    assert recipe["build"]["python"]["entry_points"] == [" = ".join(script)]
    assert recipe["about"]["summary"] == about["description"]
    assert (recipe["about"]["license"], recipe["about"]["license_file"]) == (about["license"], about["license-files"])


def test_the_recipe_renders() -> None:
    rattler_build = pytest.importorskip("rattler_build", reason="py-rattler-build is not installed")
    (variant,) = rattler_build.Stage0Recipe.from_file(FILE).render()
    rendered = variant.recipe.to_dict()
    assert rendered["package"] == {"name": "torchweather", "version": torchweather.__version__}
    assert len(rendered["requirements"]["run"]) == 11
