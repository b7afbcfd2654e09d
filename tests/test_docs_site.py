"""The site of the documentation: every page has its place, and its reference comes from what the package has.

CI builds the site itself (.ci/run), strictly: a dead link, a missing anchor or a missing name fails there.
"""

from __future__ import annotations

import argparse
import importlib.util
import sys
import types
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest
import yaml

import torchweather
from torchweather.cli.program import build_parser
from torchweather.recipes import list_recipes, read_recipe
from torchweather.stages import EFFECTS

ROOT = Path(__file__).parents[1]
SITE = ROOT / "docs" / "_site"
SECTIONS = ["Home", "Tutorials", "Gallery", "How-to", "Reference", "Explanation", "Validation", "Research notes"]
WRITTEN_AT_BUILD = ("reference/", "gallery/")


class Generated:
    """What a hook asks mkdocs to add."""

    @staticmethod
    def generated(config: Any, uri: str, *, content: str | bytes) -> tuple[str, str | bytes]:
        return uri, content


def converted(formula: str, display: str) -> str:
    """Stand-in for latex2mathml, which leaves a command that it does not have as it is, too."""
    return f'<math display="{display}">{formula.replace("<", "&lt;").replace(chr(92) + "pi", "&#x003C0;")}</math>'


@pytest.fixture
def hook(monkeypatch: pytest.MonkeyPatch, request: pytest.FixtureRequest) -> ModuleType:
    """A hook of the site as a module, without mkdocs, which the tests' environment lacks."""
    places = ("mkdocs", "mkdocs.config", "mkdocs.config.defaults", "mkdocs.structure", "mkdocs.structure.files")
    stand_ins = {name: types.ModuleType(name) for name in (*places, "mkdocs.exceptions")}
    stand_ins["mkdocs.exceptions"].PluginError = ValueError  # type: ignore[attr-defined]
    stand_ins["mkdocs.config.defaults"].MkDocsConfig = object  # type: ignore[attr-defined]
    stand_ins["mkdocs.structure.files"].File = Generated  # type: ignore[attr-defined]
    stand_ins["mkdocs.structure.files"].Files = list  # type: ignore[attr-defined]
    stand_ins |= {name: types.ModuleType(name) for name in ("latex2mathml", "latex2mathml.converter")}
    stand_ins["latex2mathml.converter"].convert = converted  # type: ignore[attr-defined]
    for name, module in stand_ins.items():
        monkeypatch.setitem(sys.modules, name, module)
    monkeypatch.syspath_prepend(SITE)
    spec = importlib.util.spec_from_file_location(request.param, SITE / f"{request.param}.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def settings() -> dict[str, Any]:
    loaded: dict[str, Any] = yaml.safe_load((ROOT / "mkdocs.yml").read_text(encoding="utf-8"))
    return loaded


def pages_in(nav: list[Any]) -> Iterator[str]:
    for entry in nav:
        under = next(iter(entry.values())) if isinstance(entry, dict) else entry
        if isinstance(under, list):
            yield from pages_in(under)
        else:
            yield under


def test_every_page_has_one_place_in_the_navigation() -> None:
    nav = settings()["nav"]
    assert [next(iter(section)) for section in nav] == SECTIONS
    listed = [page for page in pages_in(nav) if not page.startswith(WRITTEN_AT_BUILD)]
    there = [page.relative_to(ROOT / "docs").as_posix() for page in (ROOT / "docs").rglob("*.md")]
    assert sorted(listed) == sorted(there)


def written_by(hook: ModuleType) -> dict[str, str]:
    return dict(hook.on_files([], types.SimpleNamespace(docs_dir=str(ROOT / "docs"))))


@pytest.mark.parametrize("hook", ["version"], indirect=True)
def test_every_page_states_the_version(hook: ModuleType) -> None:
    config = hook.on_config(types.SimpleNamespace(docs_dir=str(ROOT / "docs"), copyright="Some-licence"))
    assert config.copyright == f"torchweather {torchweather.__version__}. Licence: Some-licence"


@pytest.mark.parametrize("hook", ["tables"], indirect=True)
def test_the_reference_lists_every_recipe(hook: ModuleType) -> None:
    page = written_by(hook)["reference/recipes.md"]
    assert all(f"| `{recipe.name}` |" in page for recipe in list_recipes())
    shown = [recipe.name.replace("/", "-") for recipe in list_recipes(kind="transform")]
    assert all(f"images/gallery/recipe-{name}.webp" in page for name in shown)
    several = [recipe.name for recipe in list_recipes(kind="multi_sensor") if f"\n`{recipe.name}`\n" in page]
    assert page.count('<div class="before-after"') == len(shown) + 3 * len(several)
    assert min(len(shown), len(several)) > 1


@pytest.mark.parametrize("hook", ["pictures"], indirect=True)
def test_pictures_of_a_recipe_of_several_sensors_are_of_its_weather_and_sensors(hook: ModuleType) -> None:
    for found in list_recipes(kind="multi_sensor"):
        recipe = read_recipe(found.name)
        weathers = recipe.build_weather().values
        if found.name.startswith("multi_sensor/") and len(weathers) == 1:
            rest = found.name.partition("/")[2]
            parts = [read_recipe(f"{before}{rest}") for before in hook.PARTS]
            assert [part.sensor_name for part in parts] == [one.sensor_name for one in recipe.transforms.values()]
            assert all(part.build().weather == weathers[0] for part in parts), found.name
            assert not any(one.options for one in (*parts, *recipe.transforms.values()))


@pytest.mark.parametrize("hook", ["commands"], indirect=True)
def test_the_reference_lists_every_argument_of_every_command(hook: ModuleType) -> None:
    page = written_by(hook)["reference/command-line.md"]
    (commands,) = [a for a in build_parser()._actions if isinstance(a, argparse._SubParsersAction)]
    for name, parser in commands.choices.items():
        assert f"\n## {name} " in page
        for action in parser._actions:
            if action.help is not argparse.SUPPRESS and not isinstance(action, argparse._HelpAction):
                assert all(f"`{option}" in page for option in action.option_strings)


@pytest.mark.parametrize("hook", ["formulas"], indirect=True)
def test_formulas_become_mathml_and_other_code_stays(hook: ModuleType) -> None:
    page = """A share $`a < \\pi`$ of `$x$`.

- In a list:
  ```math
  b =
    \\pi
  ```

```sh
echo $`date`$
```
"""
    found = hook.on_page_markdown(page, page=None)
    assert (
        'A share <span><math alttext="a &lt; \\pi" display="inline">a &lt; &#x003C0;</math></span> of `$x$`.' in found
    )
    assert '\n  <div class="formula"><math alttext="b = \\pi" display="block">b = &#x003C0;</math></div>\n' in found
    assert "```sh\necho $`date`$\n```" in found


@pytest.mark.parametrize("hook", ["formulas"], indirect=True)
def test_a_command_that_is_not_converted_stops_the_build(hook: ModuleType) -> None:
    with pytest.raises(ValueError, match=r"'\\\\foo'"):
        hook.on_page_markdown("$`\\foo + 1`$", page=None)


@pytest.mark.parametrize("hook", ["effects"], indirect=True)
def test_every_effect_has_a_page_with_its_parameters_picture_and_class(hook: ModuleType) -> None:
    pages = written_by(hook)
    effects = {name: effect for name, effect in EFFECTS.items() if name.partition(".")[0] in hook.SENSORS}
    assert {f"reference/effects/{name}.md" for name in effects} == set(pages) - {"reference/effects.md"}
    for name, effect in effects.items():
        page = pages[f"reference/effects/{name}.md"]
        assert f"(effects/{name}.md)" in pages["reference/effects.md"]
        assert (
            f"[`{effect.__name__}`](../torchweather.{name.partition('.')[0]}.effects.all/{effect.__name__}.md)" in page
        )
        assert all(f"| `{parameter.name}` |" in page for parameter in effect.arguments)
        assert all(f"[`{other}`]({other}.md)" in page for other in effect.confusable_with)
        assert f"images/gallery/{name}.webp" in page
