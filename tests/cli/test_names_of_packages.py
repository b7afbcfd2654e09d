"""Names that packages add: in Python, on the command line and in recipes; broken ones, and two of one name."""

from __future__ import annotations

import json
import re
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
import torch

import torchweather as tw
from tests.plugin_packages import EXAMPLE, install, install_example
from torchweather.atmosphere.weather import parse_weather, weather_from_dict
from torchweather.cli.program import main
from torchweather.core.errors import InputValueError, TorchweatherError
from torchweather.core.plugins import find_recipe, plugins
from torchweather.pipeline.chain import Chain
from torchweather.pipeline.effect import effect_from_dict
from torchweather.recipes import load_recipe, read_recipe
from torchweather.stages import EFFECTS, STAGES

PAGE = Path(__file__).parents[2] / "docs" / "how-to" / "write-a-package.md"
POINTS = torch.tensor([[20.0, 0.0, 0.0, 120.0], [8.0, 1.0, 0.5, 60.0]])


@pytest.fixture
def packages(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """A folder on the path; what is loaded and registered from it is forgotten after the test."""
    folder = tmp_path / "installed"
    folder.mkdir()
    monkeypatch.syspath_prepend(str(folder))
    modules, stages, effects = set(sys.modules), dict(STAGES), dict(EFFECTS)
    yield folder
    for name in set(sys.modules) - modules:
        if name.partition(".")[0] in ("acme_weather", "broken_weather"):
            del sys.modules[name]
    for registry, before in ((STAGES, stages), (EFFECTS, effects)):
        registry.clear()
        registry.update(before)  # type: ignore[arg-type]


@pytest.fixture
def acme(packages: Path) -> Path:
    install_example(packages)
    return packages


@pytest.mark.usefixtures("acme")
def test_each_group_is_looked_up_by_name() -> None:
    assert tw.Lidar.preset("acme-32").range_noise_m == 0.03
    assert tw.Lidar.preset("acme-32", range_noise_m=0.05).range_noise_m == 0.05
    drizzle = parse_weather("acme-drizzle:rate=0.5,mor=1500")
    assert drizzle == weather_from_dict({"kind": "acme-drizzle", "rate_mm_per_h": 0.5, "mor_m": 1500.0})
    assert [part.kind for part in drizzle.parts] == ["fog", "rain"]
    assert weather_from_dict(drizzle.to_dict()) == drizzle  # of the library's kinds: it needs the package no more
    assert effect_from_dict({"effect": "lidar.acme_gain_drift", "loss_db": 2.0}).config() == {"loss_db": 2.0}
    assert read_recipe("acme/drizzle-on-acme").name == "acme/drizzle-on-acme"


@pytest.mark.usefixtures("acme")
def test_a_recipe_of_the_package_does_what_its_parts_do() -> None:
    found = load_recipe("acme/drizzle-on-acme")
    by_hand = tw.LidarWeather(
        parse_weather("acme-drizzle:rate=0.5"),
        tw.Lidar.preset("acme-32"),
        effects=[{"effect": "lidar.acme_gain_drift", "loss_db": 1.0}],
    )
    assert torch.equal(found(POINTS, found.draw(POINTS, seed=3)), by_hand(POINTS, by_hand.draw(POINTS, seed=3)))
    plain = load_recipe("acme/drizzle-on-acme", effects=[])
    assert not torch.equal(found(POINTS, found.draw(POINTS, seed=3)), plain(POINTS, plain.draw(POINTS, seed=3)))


@pytest.mark.usefixtures("acme")
def test_a_weather_takes_distributions_and_five_severities(tmp_path: Path) -> None:
    suite = tmp_path / "mine.yaml"
    suite.write_text(
        "format: torchweather-recipe/2\nkind: suite\ntitle: Drizzle\nsensor: {kind: lidar}\n"
        "weathers: {acme-drizzle: {rate_mm_per_h: [0.1, 0.2, 0.3, 0.4, 0.5], mor_m: 900.0}}\n"
    )
    conditions = load_recipe(suite).conditions()
    assert [one.value for one in conditions] == [0.1, 0.2, 0.3, 0.4, 0.5]
    assert conditions[0].weather == parse_weather("acme-drizzle:rate=0.1,mor=900")
    drawn = weather_from_dict({"kind": "acme-drizzle", "rate_mm_per_h": {"uniform": [0.1, 0.5]}})
    assert list(drawn.random) == ["rain.rate_mm_per_h"]
    with pytest.raises(InputValueError, match=r"acme-drizzle: unknown field 'mor_n'; .* Did you mean 'mor_m'"):
        parse_weather("acme-drizzle:mor_n=3")


def test_a_saved_chain_loads_the_package(acme: Path, tmp_path: Path) -> None:
    file = tmp_path / "chain.zip"
    load_recipe("acme/drizzle-on-acme").chain.save(file)
    del STAGES["AcmeGainDrift"], EFFECTS["lidar.acme_gain_drift"]
    assert "acme_gain_drift" in Chain.load(file).stages
    assert acme.is_dir()


def test_the_command_line_applies_and_explains(acme: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    cloud, out = tmp_path / "cloud.bin", tmp_path / "drizzly"
    POINTS.numpy().tofile(cloud)
    assert main(["apply", str(cloud), "-o", str(out), "--recipe", "acme/drizzle-on-acme", "--seed", "3"]) == 0
    (written,) = out.glob("*.bin")
    assert np.fromfile(written, dtype="<f4").size % 4 == 0
    assert main(["explain", "--weather", "acme-drizzle:rate=0.5", "--sensor", "lidar:acme-32", "--json"]) == 0
    explained = capsys.readouterr().out
    assert '"sensor": "lidar:acme-32"' in explained
    assert '"kind": "mixture"' in explained
    assert acme.is_dir()


def in_a_fresh_process(folder: Path, code: str) -> str:
    path = f"import sys; sys.path.insert(0, {str(folder)!r})\n"
    done = subprocess.run([sys.executable, "-c", path + code], capture_output=True, text=True, check=True, timeout=60)
    return done.stdout + done.stderr


def test_list_and_early_mistakes_import_neither_torch_nor_the_package(acme: Path) -> None:
    code = (
        "from torchweather.cli.program import main\n"
        "main(['list'])\n"
        "main(['explain', '--weather', 'acme-drizle'])\n"
        "main(['explain', '--weather', 'rain:rate=1', '--sensor', 'lidar:acme-3'])\n"
        "main(['apply', 'nothing.bin', '-o', 'out.bin', '--recipe', 'acme/drizzle-on-acm'])\n"
        "print('loaded:', [one for one in ('torch', 'acme_weather') if one in sys.modules])"
    )
    printed = in_a_fresh_process(acme, code)
    for group, name in (
        ("sensors", "lidar.acme-32"),
        ("weathers", "acme-drizzle"),
        ("effects", "lidar.acme_gain_drift"),
        ("recipes", "acme/drizzle-on-acme"),
    ):
        assert re.search(rf"^  {group} +{re.escape(name)} +acme-weather$", printed, re.MULTILINE), printed
    assert all(f"Did you mean '{name}'" in printed for name in ("acme-drizzle", "acme-32", "acme/drizzle-on-acme"))
    assert "loaded: []" in printed


def test_a_broken_package_is_named_and_others_go_on(acme: Path) -> None:
    (acme / "broken_weather.py").write_text("import no_such_module\nVALUES = {}\n")
    entries = {
        "sensors": {"lidar.broken": "broken_weather:VALUES", "lidar.not-fields": "acme_weather.weathers:drizzle"},
        "weathers": {"broken": "broken_weather:VALUES", "not-weather": "builtins:dict"},
        "effects": {
            "lidar.no-value": ":",
            "lidar.broken": "broken_weather:VALUES",
            "lidar.other_id": "acme_weather.effects:AcmeGainDrift",
        },
        "recipes": {"broken": "broken_weather", "no-value": ":"},
    }
    install(acme, "broken-weather", entries)
    asked = {
        "sensors, entry point lidar.broken": lambda: tw.Lidar.preset("broken"),
        "lidar.not-fields": lambda: tw.Lidar.preset("not-fields"),
        "entry point broken = broken_weather:VALUES": lambda: parse_weather("broken"),
        "not-weather": lambda: parse_weather("not-weather"),
        "lidar.broken": lambda: effect_from_dict({"effect": "lidar.broken"}),
        "lidar.other_id": lambda: effect_from_dict({"effect": "lidar.other_id"}),
        "lidar.no-value": lambda: effect_from_dict({"effect": "lidar.no-value"}),
        "entry point no-value": lambda: read_recipe("no-value/any"),
        "entry point broken = broken_weather of": lambda: read_recipe("broken/any"),
    }
    for said, ask in asked.items():
        with pytest.raises(TorchweatherError, match=f"package broken-weather, .*{re.escape(said.split(', ')[-1])}"):
            ask()
    with pytest.raises(TorchweatherError, match=r"No module named 'no_such_module'\. Mend or uninstall"):
        Chain.from_dict({"format": "torchweather-chain/1", "stages": [{"name": "x", "stage": "VALUES"}]})
    assert tw.Lidar.preset("acme-32").range_noise_m == 0.03
    assert len(parse_weather("acme-drizzle").parts) == 2
    assert read_recipe("acme/drizzle-on-acme").kind == "transform"
    assert effect_from_dict({"effect": "lidar.acme_gain_drift"}).config() == {"loss_db": 0.0}


def test_a_name_of_two_owners_is_refused_with_both(acme: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (acme / "other_weather" / "lidar").mkdir(parents=True)
    (acme / "other_weather" / "lidar" / "drizzle-on-acme.yaml").write_text("kind: transform\n")
    (acme / "other_weather" / "lidar" / "os1-fog-10m.yaml").write_text("kind: transform\n")
    entries = {
        "sensors": {"lidar.acme-32": "acme_weather.sensors:ACME_32", "lidar.ouster-os1-128": "x:y"},
        "weathers": {"acme-drizzle": "x:y", "rain": "x:y"},
        "effects": {"lidar.acme_gain_drift": "x:y", "lidar.window_loss": "x:y"},
        "recipes": {"acme": "other_weather.lidar", "lidar": "other_weather.lidar"},
    }
    install(acme, "other-weather", entries)
    asked = [
        ("acme-weather", lambda: tw.Lidar.preset("acme-32")),
        ("torchweather", lambda: tw.Lidar.preset("ouster-os1-128")),
        ("acme-weather", lambda: parse_weather("acme-drizzle")),
        ("torchweather", lambda: parse_weather("rain:rate=3")),
        ("acme-weather", lambda: effect_from_dict({"effect": "lidar.acme_gain_drift"})),
        ("torchweather", lambda: effect_from_dict({"effect": "lidar.window_loss"})),
        ("acme-weather", lambda: read_recipe("acme/drizzle-on-acme")),
        ("torchweather", lambda: read_recipe("lidar/os1-fog-10m")),
    ]
    for other, ask in asked:
        with pytest.raises(InputValueError, match=rf"has 2 owners: .*{other}.*package other-weather") as found:
            ask()
        assert other in str(found.value)
    assert read_recipe("lidar/wads-snow-1mm-per-h").kind == "transform"
    assert find_recipe("lidar/os1-fog-20m", ["lidar/os1-fog-20m"]) is None
    assert main(["list", "--json"]) == 0
    rows = json.loads(capsys.readouterr().out)["added_by_packages"]
    refused = {(row["group"], row["name"]) for row in rows if row["refused"]}
    assert ("weathers", "rain") in refused
    assert ("recipes", "lidar/os1-fog-10m") in refused
    assert ("recipes", "lidar/drizzle-on-acme") not in refused
    assert len(refused) == 8


def test_the_page_shows_the_package() -> None:
    page = PAGE.read_text(encoding="utf-8")
    files = [path for path in EXAMPLE.rglob("*") if path.suffix in (".toml", ".py", ".yaml")]
    assert len(files) == 6
    for file in files:
        assert file.name == "__init__.py" or file.read_text(encoding="utf-8").strip() in page, file.name


@pytest.mark.usefixtures("packages")
def test_no_package_adds_names_in_this_environment() -> None:
    assert not any(one.package == "acme-weather" for owners in plugins("sensors").values() for one in owners)
