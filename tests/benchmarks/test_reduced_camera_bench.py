"""The camera's hidden-effect bench in small: eight studies of 160 x 120 px in fog, made and answered."""

from __future__ import annotations

from typing import Any

import pytest

from benchmarks.gap_bench.generator.bench_sensor import bench_sensor
from benchmarks.gap_bench.generator.camera.cases import SENSOR, Places, build, plan
from benchmarks.gap_bench.generator.camera.design import Size
from benchmarks.gap_bench.generator.camera.effects import CATALOGUE
from benchmarks.gap_bench.generator.camera.outside import OUTSIDE
from benchmarks.gap_bench.generator.planning import Case
from torchweather.camera.effects.all import EFFECTS
from torchweather.gap import find_gap

CASES = list(plan("ci", 1, ["reduced"], Size().smaller()))
# All eight take minutes: what is not run in every test run is run by `pytest -m long`.
EVERY_TIME = (5,)
ALL = [pytest.param(case, marks=[] if place in EVERY_TIME else [pytest.mark.long]) for place, case in enumerate(CASES)]
RELATIVE = 0.4  # d' of 30 tells a parameter to some percent, another form of the effect than the catalogue's to less


@pytest.fixture(scope="module")
def places() -> Places:
    return Places((1, 1), few=True)


def test_the_bench_knows_the_sensor() -> None:
    assert bench_sensor("camera") is SENSOR


def test_the_generator_has_all_effects_of_the_catalogue_and_more() -> None:
    assert set(CATALOGUE) == {
        name for name, effect in EFFECTS.items() if name.startswith("camera.") and effect.searched
    }
    assert len(OUTSIDE) >= 6
    another_form = [kind for kind in CATALOGUE.values() if not kind.same_form]
    assert 3 * len(another_form) >= len(CATALOGUE)


@pytest.mark.parametrize("case", ALL, ids=lambda case: "-".join([case.family, case.weather, *case.names]))
def test_a_study_of_the_reduced_bench(case: Case, places: Places) -> None:
    study, truth = build(case, places)
    found: dict[str, Any] = find_gap(study, seed=0).to_dict()
    names = [one["name"] for one in found["effects"]]
    if case.family == "single":
        (hidden,) = truth["effects"]
        assert found["verdict"] in ("named", "named_and_rest")
        assert names == [hidden["name"]]
        fitted = found["effects"][0]["parameters"]
        for name, value in hidden["parameters"].items():
            parameter = next(one for one in EFFECTS[hidden["name"]].arguments if one.name == name)
            if value != parameter.identity:
                assert parameter.identity is not None
                identity = 0.0 if parameter.identity == float("inf") else parameter.identity
                assert fitted[name] - identity == pytest.approx(value - identity, rel=RELATIVE)
        assert found["gap"]["after"] < found["gap"]["before"]
    elif case.family == "outside":
        assert (found["verdict"], names) == ("unknown", [])
    else:
        assert (found["verdict"], names) == ("none", [])
