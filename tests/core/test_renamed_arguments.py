"""Arguments under their old names: taken for one release, with a warning, wherever they are kept."""

from __future__ import annotations

from pathlib import Path

import pytest

import torchweather as tw
from tests.contract.table import CAMERA
from torchweather.recipes import load_recipe
from torchweather.stages import Chain, ParticleVeil

OLD = {"cut": 1e-3, "crowding": 0.5, "drop_view": "upper"}
NEW = {"min_listed_coverage": 1e-3, "max_listed_density": 0.5, "drop_radiance": "upper"}
WARNED = r"cut is min_listed_coverage now; the old name goes with the next release"


@pytest.mark.filterwarnings("ignore:.* now; the old name:DeprecationWarning")
def test_old_names_build_the_same_transform() -> None:
    old, new = (tw.BayerRain(tw.Rain(5.0), CAMERA, **given) for given in (OLD, NEW))
    assert old.options.arguments() == new.options.arguments()
    assert old.chain.to_dict() == new.chain.to_dict()


def test_an_old_name_warns_at_the_users_line() -> None:
    with pytest.warns(DeprecationWarning, match="BayerWeather: " + WARNED) as caught:
        tw.BayerRain(tw.Rain(5.0), CAMERA, cut=1e-3)  # type: ignore[call-arg]
    assert Path(caught[0].filename) == Path(__file__)


def test_both_names_are_refused() -> None:
    with pytest.raises(TypeError, match=r"cut is the old name of min_listed_coverage; both were given\. Leave cut out"):
        tw.BayerRain(tw.Rain(5.0), CAMERA, cut=1e-3, min_listed_coverage=1e-3)  # type: ignore[call-arg]


def test_a_chain_saved_with_old_names_loads() -> None:
    saved = Chain({"particle_veil": ParticleVeil([tw.Rain(5.0)], CAMERA, **NEW)}).to_dict()
    stage = saved["stages"][0]
    stage["cut"] = stage.pop("min_listed_coverage")
    with pytest.warns(DeprecationWarning, match="ParticleVeil: " + WARNED):
        assert Chain.from_dict(saved).to_dict()["stages"][0]["min_listed_coverage"] == 1e-3


def test_a_recipe_with_old_names_loads(tmp_path: Path) -> None:
    path = tmp_path / "rain.yaml"
    path.write_text(
        "format: torchweather-recipe/2\nkind: transform\ntitle: Rain\ntransform: BayerRain\n"
        "weather: {kind: rain, rate_mm_per_h: 5.0}\nsensor: {kind: camera, preset: lucid-triton}\n"
        "options: {cut: 0.001}\n",
        encoding="utf-8",
    )
    with pytest.warns(DeprecationWarning, match="options: " + WARNED):
        transform = load_recipe(path)
    assert transform.options.min_listed_coverage == 1e-3
