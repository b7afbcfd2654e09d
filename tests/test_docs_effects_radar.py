"""The page of the radar effects says of each what its class says, and the script draws its picture."""

from __future__ import annotations

import re
import sys
from pathlib import Path
from types import ModuleType

import pytest
from PIL import Image

from tests.test_docs_effects import (
    MOST_BYTES,
    PICTURES,
    SIZE_PX,
    draw_small,
    heading,
    module_of,
    picture,
    sections_of,
    table,
)
from torchweather.recipes import load_recipe
from torchweather.stages import EFFECTS, Effect

ROOT = Path(__file__).parents[1]
PAGE = ROOT / "docs" / "effects-radar.md"
SCRIPT = ROOT / "docs" / "_figures" / "radar_effects.py"
RADAR = [name for name in EFFECTS if name.startswith("radar.")]
every_effect = pytest.mark.parametrize("name", RADAR)
NOT_IN_A_GRAPH = {
    "radar.volume_clutter": "it learns from the state what falls; `RadarAttenuation(clutter=True)` can be exported",
    "radar.wet_rcs": "a graph has no input for classes",
    "radar.range_migration": "a graph has no input for frame numbers",
}


def facts(effect: type[Effect]) -> list[str]:
    """What follows the table: place, export, node of the cause tree, what it is taken for."""
    why_not = NOT_IN_A_GRAPH.get(effect.id)
    return [
        f"- **In the chain**: behind `{effect.after}`",
        f"- **ONNX**: {'yes' if why_not is None else f'no, {why_not}'}",
        f"- **PerCollECT**: {effect.percollect or 'no node'}",
        *(f"- **Taken for** `{other}`. Distinguished by {by}" for other, by in effect.confusable_with.items()),
    ]


def test_every_effect_has_its_section_in_the_order_of_the_catalogue() -> None:
    assert list(sections_of(PAGE)) == [heading(EFFECTS[name]) for name in RADAR]


@every_effect
def test_a_section_says_what_the_class_says(name: str) -> None:
    effect = EFFECTS[name]
    lines = sections_of(PAGE)[heading(effect)]
    assert lines[0] == f"`{name}` · {effect.term}"
    assert [line for line in lines if line.startswith("|")] == table(effect)
    assert [line for line in lines if line.startswith("- ")] == facts(effect)


@every_effect
def test_a_section_shows_its_picture_and_says_what_is_seen(name: str) -> None:
    lines = sections_of(PAGE)[heading(EFFECTS[name])]
    (shown,) = [line for line in lines if line.startswith("![")]
    assert re.fullmatch(rf"!\[(.+)\]\(images/effects/{re.escape(name)}\.png\)", shown) is not None
    assert picture(name).stat().st_size < MOST_BYTES
    with Image.open(picture(name)) as image:
        assert (image.format, image.size) == ("PNG", SIZE_PX)
    prose = [line for line in lines[1:] if line and line[0] not in "!|-"]
    assert len(" ".join(prose)) > 80, "no words on what the effect does"


def test_no_picture_is_left_over() -> None:
    assert {path.name for path in PICTURES.glob("radar.*")} == {picture(name).name for name in RADAR}


def test_the_recipe_on_the_page_holds_an_effect(tmp_path: Path) -> None:
    (recipe,) = re.findall(r"^```yaml\n(.*?)^```$", PAGE.read_text(encoding="utf-8"), re.MULTILINE | re.DOTALL)
    (tmp_path / "recipe.yaml").write_text(recipe, encoding="utf-8")
    stages = load_recipe(tmp_path / "recipe.yaml").chain.stages
    assert float(stages["wet_radome"].film_db) == 0.5


@pytest.fixture(scope="module")
def script() -> ModuleType:
    return module_of(SCRIPT)


def test_the_script_has_two_settings_of_every_effect_at_which_it_acts(script: ModuleType) -> None:
    assert list(script.PICTURES) == RADAR
    for name, drawn in script.PICTURES.items():
        weak, strong = (EFFECTS[name](**drawn.common, **setting) for setting in drawn.settings)
        assert not bool(weak.at_identity)
        assert not bool(strong.at_identity)
        assert weak.config() != strong.config()


def test_the_script_draws_every_picture(
    script: ModuleType, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(sys, "argv", ["", "--out", str(tmp_path), "--frames", "2"])
    size_px = draw_small(monkeypatch)
    script.main()
    assert sorted(path.name for path in tmp_path.iterdir()) == sorted(picture(name).name for name in RADAR)
    printed = capsys.readouterr().out
    for name in RADAR:
        with Image.open(tmp_path / f"{name}.png") as image:
            assert image.size == size_px
        assert f"{EFFECTS[name].title}: " in printed


def test_the_script_refuses_an_effect_that_it_does_not_know(
    script: ModuleType, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(sys, "argv", ["", "--out", str(tmp_path / "pictures"), "radar.wet_radom"])
    with pytest.raises(SystemExit):
        script.main()
    assert "no such effect: radar.wet_radom; known are radar.wet_radome" in capsys.readouterr().err
    assert not (tmp_path / "pictures").exists()
