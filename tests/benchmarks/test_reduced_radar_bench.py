"""The hidden-effect bench of radar in small: eight studies of 64 targets, made from their seed and answered.

What is asserted is what the workflow must not lose: the right names, their parameters, no alarm where nothing is
missing, no name where the catalogue has none. The strengths come from the tables in ``radar_places/``.
"""

from pathlib import Path

import pytest

from benchmarks.gap_bench.generator.radar.cases import SENSOR, plan
from torchweather.gap import find_gap

CASES = plan("ci", 1, ["reduced"], small=True)
RELATIVE = 0.3  # 64 targets: a d' of 30 is known to a few percent, its form to a fifth


@pytest.fixture(scope="module")
def build():
    return SENSOR.builder("ci", 1, Path(__file__).parent / "radar_places", CASES, True)


def test_a_study_is_made_with_what_is_hidden_in_it(build):
    """What `find_gap` makes of a study of each kind: tests/gap/sensors/radar/test_radar_frames.py, and below."""
    case = CASES[2]
    study, truth = build(case)
    assert [effect["name"] for effect in truth["effects"]] == list(case.names)
    assert {condition.split for condition in study.conditions} == {"fit", "holdout"}
    assert all(len(condition.frames) > 1 for condition in study.conditions)


@pytest.mark.long  # minutes
@pytest.mark.parametrize("case", CASES, ids=lambda case: "-".join([case.family, case.weather, *case.names]))
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
