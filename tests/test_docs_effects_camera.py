"""The page of the camera effects says of each what its class says, and the script draws its picture."""

from __future__ import annotations

import math
import re
import sys
from pathlib import Path
from types import ModuleType

import pytest
from PIL import Image

from tests.test_docs_effects import HEAD, MOST_BYTES, PICTURES, SIZE_PX, draw_small, heading, module_of, sections_of
from torchweather.recipes import load_recipe
from torchweather.stages import EFFECTS, Effect, Parameter

ROOT = Path(__file__).parents[1]
PAGE = ROOT / "docs" / "effects-camera.md"
SCRIPT = ROOT / "docs" / "_figures" / "camera_effects.py"
CAMERA = [name for name in EFFECTS if name.startswith("camera.")]
# Tested in tests/camera/effects/test_effects_camera.py.
NOT_IN_A_GRAPH = (
    "camera.wet_surface",
    "camera.rolling_shutter",
    "camera.snow_cover",
    "camera.refracting_drops",
)
every_effect = pytest.mark.parametrize("name", CAMERA)


def number(value: float) -> str:
    if abs(value) == math.pi:
        return "π" if value > 0 else "−π"
    return f"{value:g}".replace("inf", "∞").replace("-", "−")


def row(parameter: Parameter) -> str:
    """A parameter's row in the table."""
    if parameter.identity is None:
        at = f"sets where or how; {number(parameter.value)} unless given"
    else:
        at = number(parameter.identity)
    bounds = f"{number(parameter.low)} to {number(parameter.high)}"
    return f"| `{parameter.name}` | {parameter.unit} | {bounds} | {at} | {number(parameter.scale)} |"


def facts(effect: type[Effect]) -> list[str]:
    """What follows the table: place, and what it is taken for."""
    place = "in front of all stages" if effect.after == "scene" else f"behind `{effect.after}`"
    return [
        f"- **In the chain**: {place}",
        *(f"- **Taken for** `{other}`. Distinguished by {by}" for other, by in effect.confusable_with.items()),
    ]


def test_every_effect_has_its_section_in_the_order_of_the_catalogue() -> None:
    assert list(sections_of(PAGE)) == [heading(EFFECTS[name]) for name in CAMERA]


@every_effect
def test_a_section_says_what_the_class_says(name: str) -> None:
    effect = EFFECTS[name]
    lines = sections_of(PAGE)[heading(effect)]
    assert lines[0] == f"`{name}` · {effect.term}"
    assert [line for line in lines if line.startswith("|")] == [*HEAD, *(row(one) for one in effect.arguments)]
    listed = [line for line in lines if line.startswith("- ")]
    assert [line for line in listed if not line.startswith("- **ONNX**")] == facts(effect)
    (onnx,) = [line for line in listed if line.startswith("- **ONNX**")]
    assert onnx.startswith("- **ONNX**: no, ") == (name in NOT_IN_A_GRAPH)


@every_effect
def test_a_section_shows_its_picture_and_says_what_is_seen(name: str) -> None:
    lines = sections_of(PAGE)[heading(EFFECTS[name])]
    (shown,) = [line for line in lines if line.startswith("![")]
    assert re.fullmatch(rf"!\[(.+)\]\(images/effects/{re.escape(name)}\.png\)", shown) is not None
    picture = PICTURES / f"{name}.png"
    assert picture.stat().st_size < MOST_BYTES
    with Image.open(picture) as image:
        assert (image.format, image.size) == ("PNG", SIZE_PX)
    prose = [line for line in lines[1:] if line and line[0] not in "!|-"]
    assert len(" ".join(prose)) > 80, "no words on what the effect does"


def test_no_picture_is_left_over() -> None:
    assert {path.name for path in PICTURES.glob("camera.*")} == {f"{name}.png" for name in CAMERA}


def test_the_recipe_on_the_page_holds_an_effect(tmp_path: Path) -> None:
    (recipe,) = re.findall(r"^```yaml\n(.*?)^```$", PAGE.read_text(encoding="utf-8"), re.MULTILINE | re.DOTALL)
    (tmp_path / "recipe.yaml").write_text(recipe, encoding="utf-8")
    stages = load_recipe(tmp_path / "recipe.yaml").chain.stages
    assert float(stages["defocus"].radius_px) == 2.0


@pytest.fixture(scope="module")
def script() -> ModuleType:
    return module_of(SCRIPT)


def test_the_script_has_two_settings_of_every_effect_at_which_it_acts(script: ModuleType) -> None:
    assert list(script.PICTURES) == CAMERA
    for name, drawn in script.PICTURES.items():
        weak, strong = (EFFECTS[name](**drawn.common, **setting) for setting in drawn.settings)
        assert not bool(weak.at_identity)
        assert not bool(strong.at_identity)
        assert weak.config() != strong.config()


def test_the_script_draws_a_frame_a_cover_and_a_change(
    script: ModuleType, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Drawing all of them takes too long for a test."""
    drawn = ["camera.height_fog", "camera.streak_contrast", "camera.wind_slant"]
    monkeypatch.setattr(sys, "argv", ["", "--out", str(tmp_path), "--frames", "2", "--width", "64", *drawn])
    size_px = draw_small(monkeypatch)
    script.main()
    assert sorted(path.name for path in tmp_path.iterdir()) == [f"{name}.png" for name in drawn]
    printed = capsys.readouterr().out
    for name in drawn:
        with Image.open(tmp_path / f"{name}.png") as image:
            assert image.size == size_px
        assert f"{EFFECTS[name].title}: " in printed


def test_the_script_refuses_an_effect_that_it_does_not_know(
    script: ModuleType, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(sys, "argv", ["", "--out", str(tmp_path / "pictures"), "camera.defocu"])
    with pytest.raises(SystemExit):
        script.main()
    assert "no such effect: camera.defocu; known are camera.exposure_gain" in capsys.readouterr().err
    assert not (tmp_path / "pictures").exists()
