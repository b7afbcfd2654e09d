"""The page of the LiDAR effects says of each what its class says, and the script draws its picture."""

from __future__ import annotations

import importlib.util
import math
import re
import sys
from pathlib import Path
from types import ModuleType

import pytest
from PIL import Image

from torchweather.recipes import load_recipe
from torchweather.stages import EFFECTS, Effect, Parameter

ROOT = Path(__file__).parents[1]
PAGE = ROOT / "docs" / "effects-lidar.md"
PICTURES = ROOT / "docs" / "images" / "effects"
SCRIPT = ROOT / "docs" / "_figures" / "lidar_effects.py"
LIDAR = [name for name in EFFECTS if name.startswith("lidar.")]

MOST_BYTES = 40_000  # of a picture: twenty of them are on one page
SIZE_PX = (720, 312)

HEAD = ["| parameter | unit | bounds | does nothing at | typical size |", "| --- | --- | --- | --- | --- |"]
every_effect = pytest.mark.parametrize("name", LIDAR)


def number(value: float) -> str:
    if abs(value) == 2.0 * math.pi:
        return "2π" if value > 0 else "−2π"
    return f"{value:g}".replace("inf", "∞").replace("-", "−")


def row(parameter: Parameter) -> str:
    """A parameter's row in the table."""
    at = "–" if parameter.identity is None else number(parameter.identity)
    if parameter.identity is None:
        at = f"sets where or how; {'π' if parameter.value == math.pi else number(parameter.value)} unless given"
    bounds = f"{number(parameter.low)} to {number(parameter.high)}"
    return f"| `{parameter.name}` | {parameter.unit} | {bounds} | {at} | {number(parameter.scale)} |"


def table(effect: type[Effect]) -> list[str]:
    return [*HEAD, *(row(parameter) for parameter in effect.arguments)]


def facts(effect: type[Effect]) -> list[str]:
    """What follows the table: place, export, node of the cause tree, what it is taken for."""
    # An exported graph takes any number of points and so knows no rows.
    onnx = "no, it looks at the rows of the scan" if "grid" in effect.needs else "yes"
    return [
        f"- **In the chain**: behind `{effect.after}`",
        f"- **ONNX**: {onnx}",
        f"- **PerCollECT**: {effect.percollect or 'no node'}",
        *(f"- **Taken for** `{other}`. Distinguished by {by}" for other, by in effect.confusable_with.items()),
    ]


def heading(effect: type[Effect]) -> str:
    return effect.title[0].upper() + effect.title[1:]


def sections_of(page: Path) -> dict[str, list[str]]:
    """Heading to the lines below it."""
    parts = re.split(r"^## (.*)$", page.read_text(encoding="utf-8"), flags=re.MULTILINE)
    return {title: body.strip().splitlines() for title, body in zip(parts[1::2], parts[2::2], strict=True)}


def module_of(path: Path) -> ModuleType:
    """A script as a module, which is quicker than a process of its own."""
    spec = importlib.util.spec_from_file_location(path.stem, path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module  # dataclasses ask for theirs
    sys.path.insert(0, str(path.parent))  # as where a script runs: it may take something from its neighbour
    try:
        spec.loader.exec_module(module)
    finally:
        sys.path.remove(str(path.parent))
    return module


def draw_small(monkeypatch: pytest.MonkeyPatch) -> tuple[int, int]:
    """Let a loaded script draw a quarter of the dots either way; size of its pictures, pixels.

    The size of those in the repository is checked where they are shown.
    """
    monkeypatch.setattr(sys.modules["effect_drawing"], "DPI", sys.modules["effect_drawing"].DPI // 4)
    return SIZE_PX[0] // 4, SIZE_PX[1] // 4


def picture(name: str) -> Path:
    return PICTURES / f"{name}.png"


def test_every_effect_has_its_section_in_the_order_of_the_catalogue() -> None:
    assert list(sections_of(PAGE)) == [heading(EFFECTS[name]) for name in LIDAR]


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
    found = re.fullmatch(rf"!\[(.+)\]\(images/effects/{re.escape(name)}\.png\)", shown)
    assert found is not None
    assert picture(name).stat().st_size < MOST_BYTES
    with Image.open(picture(name)) as image:
        assert (image.format, image.size) == ("PNG", SIZE_PX)
    prose = [line for line in lines[1:] if line and line[0] not in "!|-"]
    assert len(" ".join(prose)) > 80, "no words on what the effect does"


def test_no_picture_is_left_over() -> None:
    assert {path.name for path in PICTURES.glob("lidar.*")} == {picture(name).name for name in LIDAR}


def test_the_recipe_on_the_page_holds_an_effect(tmp_path: Path) -> None:
    (recipe,) = re.findall(r"^```yaml\n(.*?)^```$", PAGE.read_text(encoding="utf-8"), re.MULTILINE | re.DOTALL)
    (tmp_path / "recipe.yaml").write_text(recipe, encoding="utf-8")
    stages = load_recipe(tmp_path / "recipe.yaml").chain.stages
    assert float(stages["window_loss"].loss_db) == 3.0


@pytest.fixture(scope="module")
def script() -> ModuleType:
    return module_of(SCRIPT)


def test_the_script_has_two_settings_of_every_effect_at_which_it_acts(script: ModuleType) -> None:
    assert list(script.PICTURES) == LIDAR
    for name, drawn in script.PICTURES.items():
        weak, strong = (EFFECTS[name](**drawn.common, **setting) for setting in drawn.settings)
        assert not bool(weak.at_identity)
        assert not bool(strong.at_identity)
        assert weak.config() != strong.config()


def test_the_script_draws_one_picture_of_each_make(
    script: ModuleType, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Drawing all of them takes too long for a test."""
    makes = {type(panel): name for name, drawn in script.PICTURES.items() for panel in drawn.panels}
    # In clear air, too; on a scan of its own.
    drawn = sorted(set(makes.values()) | {"lidar.crosstalk", "lidar.shared_particles"})
    small = ["--frames", "1", "--columns", "32", "--fine-columns", "512"]
    monkeypatch.setattr(sys, "argv", ["", "--out", str(tmp_path), *small, *drawn])
    size_px = draw_small(monkeypatch)
    script.main()
    assert sorted(path.name for path in tmp_path.iterdir()) == [picture(name).name for name in drawn]
    printed = capsys.readouterr().out
    for name in drawn:
        with Image.open(tmp_path / f"{name}.png") as image:
            assert image.size == size_px
        assert f"{EFFECTS[name].title}: " in printed


def test_the_script_refuses_an_effect_that_it_does_not_know(
    script: ModuleType, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(sys, "argv", ["", "--out", str(tmp_path / "pictures"), "lidar.window_los"])
    with pytest.raises(SystemExit):
        script.main()
    assert "no such effect: lidar.window_los; known are lidar.beam_divergence" in capsys.readouterr().err
    assert not (tmp_path / "pictures").exists()
