"""The order of things on a bench: make, run in parts, known, score; and files that several processes write."""

import json
import subprocess
import sys
from dataclasses import asdict
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from benchmarks.gap_bench import report, steps
from benchmarks.gap_bench.generator.lidar import cases, streets
from benchmarks.gap_bench.generator.lidar.cases import Streets, build, needed_strengths, plan
from benchmarks.gap_bench.generator.lidar.design import Size
from benchmarks.gap_bench.scoring import score
from benchmarks.gap_bench.sealed import append_line, read_lines, sha256_of, write_json
from torchweather.gap.study.study import Study

ROOT = Path(__file__).resolve().parents[2]
LOSS = "lidar.window_loss"


def _truth(case, name=LOSS):
    effect = {
        "name": name, "parameters": {"loss_db": 1.0}, "same_form": True, "level": 30.0, "confusable_with": {},
        "identifiable": True, "axes": None,
    }  # fmt: skip
    return {"id": case, "family": "single", "weather": "rain", "effects": [effect], "options": {}}


def _answer(name=LOSS, width=0.4, **more):
    effect = {"name": name, "parameters": {"loss_db": 1.0}, "interval": {"loss_db": [1.0, 1.0 + width]}}
    return {"seconds": 1.0, "report": {"verdict": "named", "effects": [{**effect, "confidence": 0.9}]}, **more}


@pytest.fixture
def folder(tmp_path):
    """Of three studies, the answers of which are put in."""
    for case in ("a", "b", "c"):
        (tmp_path / "studies" / case).mkdir(parents=True)
        (tmp_path / "studies" / case / "study.yaml").write_text("")
    write_json(tmp_path / "sealed" / "truth.json", {case: _truth(case) for case in "abc"})
    seal = sha256_of(tmp_path / "sealed" / "truth.json")
    write_json(tmp_path / "seal.json", {"sensor": "lidar", "set": "dev", "seed": 1, "truth_sha256": seal})
    return tmp_path


def _arguments(folder, **more):
    return SimpleNamespace(
        **{"folder": folder, "seed": 0, "count": None, "part": None, "out": None, "folders": [folder], **more}
    )


def test_time_searches_every_nth_answered_study_again(folder, monkeypatch):
    for case in ("c", "a", "b"):
        append_line(folder / "answers.jsonl", {"case": case, "sealed": "x", **_answer()})
    asked = []

    def slow(path, seed):
        asked.append(path.name)
        return {"seconds": 7.0, "report": {}}

    monkeypatch.setattr(steps, "answer", slow)
    steps.timed(SimpleNamespace(folder=folder, seed=0, every=2, skip=0))
    steps.timed(SimpleNamespace(folder=folder, seed=0, every=2, skip=0))
    assert asked == ["a", "c"]
    assert read_lines(folder / "seconds.jsonl") == [{"case": "a", "seconds": 7.0}, {"case": "c", "seconds": 7.0}]


def test_lines_of_two_processes_stay_whole(tmp_path):
    path = tmp_path / "answers.jsonl"
    code = (
        "import sys; from pathlib import Path; from benchmarks.gap_bench.sealed import append_line\n"
        "path, who = Path(sys.argv[1]), sys.argv[2]\n"
        "for i in range(60): append_line(path, {'who': who, 'i': i, 'long': who * 30000})"
    )
    both = [subprocess.Popen([sys.executable, "-c", code, str(path), who], cwd=ROOT) for who in "xy"]
    assert [one.wait() for one in both] == [0, 0]
    # A line that is seen while it is being written is ended once more: an empty line, and nothing else.
    found = [json.loads(line) for line in path.read_text().splitlines() if line]
    assert sorted((one["who"], one["i"]) for one in found) == sorted((who, i) for who in "xy" for i in range(60))


def test_a_line_after_one_that_was_cut_off_is_whole(tmp_path):
    path = tmp_path / "answers.jsonl"
    append_line(path, {"case": "a"})
    with path.open("a") as file:
        file.write('{"case": "b", "va')
    append_line(path, {"case": "c"})
    assert [one["case"] for one in read_lines(path)] == ["a", "c"]


def test_parts_never_overlap_whatever_is_done_already(folder, monkeypatch, capsys):
    monkeypatch.setattr(steps, "answer", lambda study, seed, **more: _answer())
    assert steps.part_of(["a", "b", "c"], "1/2") == ["a", "c"]
    steps.run(_arguments(folder, part="1/2", count=1))
    steps.run(_arguments(folder, part="2/2"))
    steps.run(_arguments(folder, part="1/2"))
    assert [one["case"] for one in read_lines(folder / "answers.jsonl")] == ["a", "b", "c"]
    steps.run(_arguments(folder))
    assert "3 of 3 studies have an answer; 0 to go" in capsys.readouterr().out
    for wrong in ("0/2", "3/2"):
        with pytest.raises(SystemExit, match="k/n"):
            steps.part_of(["a"], wrong)


def test_known_opens_the_truth_after_the_last_answer_and_asks_for_the_true_effects_alone(folder, monkeypatch):
    asked = []

    def answer(study, seed, effects=None, **more):
        asked.append((study.name, effects))
        return _answer("lidar.spray" if study.name == "b" else LOSS, width=0.4 if effects is None else 0.2)

    monkeypatch.setattr(steps, "answer", answer)
    steps.run(_arguments(folder, count=2))
    with pytest.raises(SystemExit, match="1 studies have no answer"):
        steps.known(_arguments(folder))
    steps.run(_arguments(folder))
    asked.clear()
    steps.known(_arguments(folder, count=1))
    steps.known(_arguments(folder))
    assert asked == [("a", [LOSS]), ("c", [LOSS])]  # b was not answered right
    report.report(_arguments(folder))
    written = json.loads((folder / "score" / "score.json").read_text())
    table, bars = written["table"], {one["figure"]: one for one in written["bars"]}
    assert bars["singles_identifiable_exact"]["holds"] is False
    assert (bars["interval_width_over_known"]["holds"], bars["pairs_both"]["holds"]) == (True, None)
    assert table["singles_exact"]["hits"] == 2
    assert table["interval_width_over_known"] == {"median": pytest.approx(2.0), "of": 2}
    write_json(folder / "sealed" / "truth.json", {case: _truth(case, "lidar.spray") for case in "abc"})
    for act in (steps.known, report.report):
        with pytest.raises(SystemExit, match="SHA-256"):
            act(_arguments(folder))


def test_a_table_counts_the_families_of_a_set_that_are_asked_for(folder, monkeypatch):
    truths = {
        case: {**_truth(case), "family": family}
        for case, family in zip("abc", ("single", "pair", "decoy"), strict=True)
    }
    write_json(folder / "sealed" / "truth.json", truths)
    seal = {"sensor": "lidar", "set": "dev", "seed": 1, "truth_sha256": sha256_of(folder / "sealed" / "truth.json")}
    write_json(folder / "seal.json", seal)
    monkeypatch.setattr(steps, "answer", lambda study, seed, **more: _answer())
    steps.run(_arguments(folder))
    for given, counted in ((f"{folder}:single,pair", (1, 1)), (f"{folder}:pair", (0, 1))):
        report.report(_arguments(folder, folders=[given]))
        written = json.loads((folder / "score" / "score.json").read_text())
        assert tuple(written["table"][name]["of"] for name in ("singles_exact", "pairs_both")) == counted
        assert written["sets"] == [{**seal, "families": given.rpartition(":")[2].split(",")}]
    with pytest.raises(SystemExit, match=r"expected a folder, or one with :null,single.*got singles"):
        report.report(_arguments(folder, folders=[f"{folder}:singles"]))


def test_of_several_answers_to_a_study_the_first_counts():
    answers = [{"case": "a", **_answer()}, {"case": "a", **_answer("lidar.spray")}]
    table = score({"a": _truth("a")}, answers)["table"]
    assert (table["answered"], table["singles_exact"]["hits"], table["singles_wrong_asserted"]["hits"]) == (1, 1, 0)


def test_a_right_name_with_a_wrong_parameter_shows():
    truth = {"a": _truth("a", "lidar.extinction_scale")}
    truth["a"]["effects"][0]["parameters"] = {"factor": 1.06}
    answer = _answer("lidar.extinction_scale")
    answer["report"]["effects"][0] |= {"parameters": {"factor": 0.94}, "interval": {"factor": [0.93, 0.95]}}
    found = score(truth, [{"case": "a", **answer}])["table"]
    assert found["singles_exact"]["hits"] == 1
    assert found["parameter_off_over_departure"] == {"median": pytest.approx(2.0), "most": pytest.approx(2.0), "of": 1}
    answer["report"]["effects"][0]["parameters"] = {"factor": 1.06}
    assert score(truth, [{"case": "a", **answer}])["table"]["parameter_off_over_departure"]["most"] == 0.0


def test_what_is_left_of_the_other_metrics_is_of_those_that_stood_out():
    gaps = {
        "before": {"returns": 5.0, "lost": 9.0, "particles": 1.9},
        "after": {"returns": 2.0, "lost": 0.8, "particles": 7.0},
    }
    table = score({"a": _truth("a")}, [{"case": "a", **_answer(other_metrics=gaps)}])["table"]
    found = table["other_metrics_after_over_before"]
    assert found["by_metric"] == {"lost": 0.0, "returns": 0.25}
    assert (found["median"], found["of"], found["nothing_stood_out"]) == (0.125, 1, 0)
    quiet = {"before": {"returns": 1.5}, "after": {"returns": 1.5}}
    found = score({"a": _truth("a")}, [{"case": "a", **_answer(other_metrics=quiet)}])["table"]
    assert found["other_metrics_after_over_before"]["nothing_stood_out"] == 1
    assert found["other_metrics_after_over_before"]["median"] is None


def test_what_two_codes_differ_by_is_no_excess_that_an_effect_leaves():
    """Nulls of the same weather leave 3 at the root mean square: of 13 that an effect leaves 5, that is a fifth."""
    truths = {"a": _truth("a"), **{f"n{k}": {**_truth(f"n{k}"), "family": "null", "effects": []} for k in range(4)}}
    gaps = {"before": {"returns": 13.0, "lost": 5.9}, "after": {"returns": 5.0, "lost": 5.9}}
    quiet = [{"returns": value, "lost": 3.0} for value in (1.0, 3.0, 1.0, 5.0)]
    answers = [{"case": "a", **_answer(other_metrics=gaps)}]
    answers += [
        {
            "case": f"n{k}",
            "seconds": 1.0,
            "report": {"verdict": "none", "effects": []},
            "other_metrics": {"before": one, "after": one},
        }
        for k, one in enumerate(quiet)
    ]
    table = score(truths, answers)["table"]
    assert table["other_metrics_floors"] == {truths["a"]["weather"]: {"returns": 3.0, "lost": 3.0}}
    assert table["other_metrics_after_over_before"]["by_metric"] == {"returns": pytest.approx(0.2)}
    few = score({case: truths[case] for case in ("a", "n0", "n1", "n2")}, answers)["table"]  # too few to tell
    assert "other_metrics_floors" not in few
    assert few["other_metrics_after_over_before"]["by_metric"]["returns"] == pytest.approx(1.0 / 3.0)


def test_a_null_needs_no_table_of_strengths(monkeypatch):
    def refuse(*arguments):
        raise AssertionError("a detector was made")

    monkeypatch.setattr(streets, "Detector", refuse)
    tiny = Size(rings=16, columns=64, clear_frames=2, rates=2, frames=2)
    places = Streets("dev", 1, None)
    nulls = [case for case in plan("dev", 1, ["nulls", "screen"], tiny) if case.size.rings < 64][:7]
    assert {tuple(needed_strengths(case)) for case in nulls} == {()}
    study, truth = build(nulls[0], places)
    assert len(study.conditions) == 4
    assert truth["effects"] == []
    single = next(plan("dev", 1, ["singles"], tiny))
    with pytest.raises(AssertionError, match="detector"):
        build(single, places)


def test_decoys_say_which_strengths_they_ask_for():
    asked = {}
    for name, decoy in cases.DECOYS.items():

        def at(effect, level, name=name):
            asked.setdefault(name, set()).add(effect)
            return {"loss_db": 1.0, "std_m": 1.0}

        if name != "decoy.no_target":  # it looks at the scene
            decoy(SimpleNamespace(views=()), at, np.random.default_rng(1))
    assert asked == {name: set(effects) for name, effects in cases.STRENGTHS_OF.items()}


def test_spray_grows_with_the_speed_that_the_conditions_carry(tmp_path):
    tiny = Size(rings=16, columns=64, clear_frames=2, rates=3, frames=4)
    case = next(plan("dev", 1, ["moving"], tiny))
    street = Streets("dev", 1, None).bare("rain", 0, tiny)

    def made(strength):
        held = {
            "parameters": {"strength": strength, "azimuth_rad": 0.0, "width_rad": 6.0},
            "reached": 30.0,
            "cosine": {},
        }
        return build(case, lambda weather, number, size: streets.Street(street.design, {"lidar.spray": {"30": held}}))

    def near(study):
        """Share of faint near returns in each condition; drops of the rain among them."""
        return np.array(
            [
                np.mean(
                    [
                        (frame["range_m"] > 0) & (frame["range_m"] < 8.0) & (frame["intensity"] < 0.02)
                        for frame in one.frames
                    ]
                )
                for one in study.conditions
            ]
        )

    study, truth = made(3.0)
    study.write(tmp_path / "study")
    speeds = [one.ego_speed_m_per_s for one in Study.read(tmp_path / "study").conditions]
    assert len(set(speeds)) == len(speeds)
    assert truth["effects"][0]["parameters"] == {"azimuth_rad": 0.0, "width_rad": 6.0}
    spray = near(study) - near(made(0.0)[0])
    assert np.corrcoef(np.square(speeds), spray)[0, 1] > 0.9


def test_a_sealed_truth_is_made_in_the_size_that_it_was_sealed_with(tmp_path):
    """Studies of another size under the same names would change the seal."""
    arguments = SimpleNamespace(
        folder=tmp_path, sensor="camera", set="dev", seed=1, cases=["screen"], count=1, skip=0, small=False, few=True
    )
    case = steps.bench_sensor("camera").plan("dev", 1, ["screen"], True)[0]
    write_json(tmp_path / "sealed" / "truth.json", {case.id: {"size": asdict(case.size)}})
    seal = sha256_of(tmp_path / "sealed" / "truth.json")
    with pytest.raises(SystemExit, match=r"160.*480.*--small"):
        steps.make(arguments)
    assert sha256_of(tmp_path / "sealed" / "truth.json") == seal


def test_a_kept_set_is_compressed_the_same_each_time_and_read_as_before(folder, tmp_path, monkeypatch):
    monkeypatch.setattr(steps, "answer", lambda study, seed, **more: _answer())
    steps.run(_arguments(folder))
    for into in ("kept", "again"):
        steps.keep(SimpleNamespace(folder=folder, into=tmp_path / into))
    files = [path.relative_to(tmp_path / "kept") for path in sorted((tmp_path / "kept").rglob("*.*"))]
    assert [str(path) for path in files] == ["answers.jsonl.gz", "seal.json", "sealed/truth.json.gz"]
    assert all((tmp_path / "kept" / path).read_bytes() == (tmp_path / "again" / path).read_bytes() for path in files)
    for one in (folder, tmp_path / "kept"):
        report.report(_arguments(one, folders=[one], out=tmp_path / f"score of {one.name}"))
    scores = [(tmp_path / f"score of {one}").joinpath("score.json").read_text() for one in (folder.name, "kept")]
    assert scores[0] == scores[1]
    with pytest.raises(SystemExit, match="has answers"):
        steps.make(SimpleNamespace(folder=tmp_path / "kept", sensor="lidar"))
