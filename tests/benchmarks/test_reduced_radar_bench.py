"""The hidden-effect bench of radar in small: eight studies of 64 targets, made from their seed and answered.

What is asserted is what the workflow must not lose: the right names, their parameters, no alarm where nothing is
missing, no name where the catalogue has none. The strengths come from the tables in ``radar_places/``.
"""

from pathlib import Path

import pytest

from benchmarks.gap_bench.generator.radar.cases import SENSOR, plan
from torchweather.gap import find_gap

CASES = plan("ci", 1, ["reduced"], small=True)
# All eight take minutes: what is not run in every test run is run by `pytest -m long`.
EVERY_TIME = (2,)
ALL = [pytest.param(case, marks=[] if place in EVERY_TIME else [pytest.mark.long]) for place, case in enumerate(CASES)]
RELATIVE = 0.3  # 64 targets: a d' of 30 is known to a few percent, its form to a fifth


@pytest.fixture(scope="module")
def build():
    return SENSOR.builder("ci", 1, Path(__file__).parent / "radar_places", CASES, True)


@pytest.mark.parametrize("case", ALL, ids=lambda case: "-".join([case.family, case.weather, *case.names]))
def test_a_study_of_the_reduced_bench(case, build):
    study, truth = build(case)
    found = find_gap(study, seed=0).to_dict()
    names = [one["name"] for one in found["effects"]]
    if case.family == "single":
        (hidden,) = truth["effects"]
        assert (found["verdict"], names) == ("named", [hidden["name"]])
        for name, value in hidden["parameters"].items():
            assert found["effects"][0]["parameters"][name] == pytest.approx(value, rel=RELATIVE)
        assert found["gap"]["after"] < found["gap"]["before"]
    elif case.family == "outside":
        assert names == []
        assert found["verdict"] == "unknown"
    else:
        assert (found["verdict"], names) == ("none", [])
