"""The page of the search for a missing effect: its sentence, its numbers and its pictures, for every verdict."""

from __future__ import annotations

import base64
import json
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from tests.gap import studies
from tests.report.made_up_gaps import EMPIRICAL, UNKNOWN, WINDOW_LOSS, report
from tests.report.parsed_page import Page
from torchweather.gap.gap_report import BinDeparture, Curve, GapReport, ResidualMap, Response, read_model
from torchweather.gap.study.study import Study
from torchweather.lidar.effects.all import EFFECTS
from torchweather.report.gap_figures import curve_uri, residual_uri, response_uri
from torchweather.report.gap_page import write_gap
from torchweather.report.gap_words import exact_twins, gap_sentence, group_name, parameter_rows, verdict_sentence
from torchweather.report.tables import number_text

VERDICTS = ("none", "named", "named_and_rest", "unknown")


@pytest.fixture(scope="module")
def study() -> Study:
    return studies.study("lidar")


@pytest.fixture(scope="module")
def pages(study: Study, tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    found = {}
    for verdict in VERDICTS:
        found[verdict] = tmp_path_factory.mktemp("gap") / verdict
        write_gap(found[verdict], study, report(verdict, study))
    return found


def page_of(folder: Path) -> Page:
    return Page((folder / "report.html").read_text(encoding="utf-8"))


def words_of(folder: Path) -> str:
    return " ".join(page_of(folder).words.split())


@pytest.mark.parametrize("verdict", VERDICTS)
def test_the_page_is_whole_and_carries_everything(verdict: str, pages: dict[str, Path]) -> None:
    folder = pages[verdict]
    assert {path.name for path in folder.iterdir()} == {"gap.json", "model.yaml", "report.html"}
    page = page_of(folder)
    assert page.mistakes == []
    assert page.open == []
    images = [attrs for tag, attrs in page.elements if tag == "img"]
    # The scan; curves, the map, the held-out gap; responses of what was fitted; the curve that nothing explains.
    assert len(images) == 1 + 3 + 2 + (verdict != "none") + (verdict == "unknown")
    assert all(str(image["src"]).startswith("data:image/") and image["alt"] for image in images)
    ids = {attrs.get("id") for _, attrs in page.elements}
    for tag, attrs in page.elements:
        assert tag != "script"
        link = attrs.get("href")
        if tag == "a":
            assert link is not None
            assert link[1:] in ids if link.startswith("#") else (folder / link).is_file()
    assert "built-in method" not in page.words
    for wrong in (r"\bNone\b", r"\bnan\b", r"\binf\b", r"\{"):
        assert not re.search(wrong, page.words), wrong


@pytest.mark.parametrize("verdict", VERDICTS)
def test_sentence_and_provenance_stand_on_the_page(verdict: str, pages: dict[str, Path], study: Study) -> None:
    answer = json.loads((pages[verdict] / "gap.json").read_text(encoding="utf-8"))
    words = words_of(pages[verdict])
    assert verdict_sentence(answer) in words
    assert f"seed 7 · 41.2 s · study {study.sha256}" in words


def test_the_model_of_the_folder_holds_what_was_named(pages: dict[str, Path]) -> None:
    assert len(read_model(pages["none"] / "model.yaml")) == 0
    (effect,) = read_model(pages["named"] / "model.yaml")
    assert effect.to_dict() == {"effect": "lidar.window_loss", "loss_db": pytest.approx(0.02)}


def test_a_named_effect_in_one_sentence(study: Study) -> None:
    assert verdict_sentence(report("named", study).answer) == (
        "The simulation lacks window loss (lidar.window_loss): loss 0.0200 dB (90 %: 0.0180 to 0.0220), confidence "
        "0.97. Held-out conditions depart by 2.13 standard deviations before and 1.03 after; a perfect model scores "
        "1.00, so 2.7 % of the excess is left."
    )


def test_two_effects_their_rival_and_the_rest_in_one_paragraph(study: Study) -> None:
    assert verdict_sentence(report("named_and_rest", study).answer) == (
        "The simulation lacks static structure (lidar.static_structure): azimuth −29.8°, range 9.70 m, width 1.78°, "
        "confidence over 0.99; and window loss (lidar.window_loss): loss 0.0200 dB (90 %: 0.0180 to 0.0220), "
        "confidence 0.97. Held-out conditions depart by 2.13 standard deviations before and 1.03 after; a perfect "
        "model scores 1.00, so 2.7 % of the excess is left. These data cannot exclude sector loss in its place. "
        "More is missing, which no effect of the catalogue explains (most of it in: "
        "intensity over clear air's, over time)."
    )


def test_nothing_and_unknown_name_no_effect(study: Study) -> None:
    nothing = verdict_sentence(report("none", study).answer)
    assert nothing == (
        "Nothing is missing that these data could show (p = 0.31). Held-out conditions depart by 1.03 standard "
        "deviations; a perfect model scores 1.00."
    )
    unknown = verdict_sentence(report("unknown", study).answer)
    assert unknown.startswith("Something is missing that no effect of the catalogue explains (most of it in: intensity")
    assert "lidar." not in unknown
    nowhere = verdict_sentence(report("unknown", study, unknown=None).answer)
    assert nowhere.startswith(
        "Something is missing that no effect of the catalogue explains. Held-out conditions depart by 2.13"
    )


def test_unknown_says_what_the_catalogue_has_that_is_closest(study: Study) -> None:
    closest = [{"name": name, "parameters": {}} for name in ("lidar.spray", "lidar.patchy_weather")]
    words = gap_sentence(report("unknown", study, closest=closest).answer)
    assert " and by 1.03 with the best of the catalogue, spray and patchy weather; a perfect model" in words
    assert " and by 1.03 with the best effects; a perfect model" in gap_sentence(report("unknown", study).answer)


def test_a_parameter_that_was_not_fitted_and_does_nothing_is_left_out(study: Study) -> None:
    effect = {
        **WINDOW_LOSS,
        "name": "lidar.intensity_compression",
        "parameters": {"exponent": 0.8, "saturation": "inf"},
        "interval": {"exponent": [0.7, 0.9]},
    }
    said = verdict_sentence(report("named", study, effects=[effect]).answer)
    assert "intensity compression (lidar.intensity_compression): exponent 0.800 (90 %: 0.700 to 0.900), conf" in said


def test_what_tells_rivals_apart_is_the_catalogue_s(pages: dict[str, Path]) -> None:
    words = words_of(pages["named_and_rest"])
    between = EFFECTS["lidar.static_structure"].confusable_with["lidar.sector_loss"]
    assert f"sector loss cannot be excluded {between}" in words
    between = EFFECTS["lidar.window_loss"].confusable_with["lidar.threshold_shift"]
    assert f"threshold shift fits worse {between}" in words
    between = EFFECTS["lidar.window_loss"].confusable_with["lidar.wet_target"]
    assert f"wet target explains less, by its response alone {between}" in words


@pytest.mark.usefixtures("undrawn")
def test_a_search_of_some_effects_says_so_and_excludes_no_other(study: Study, tmp_path: Path) -> None:
    names = ["lidar.window_loss", "lidar.threshold_shift"]
    write_gap(tmp_path / "out", study, report("named", study), effects=names)
    words = words_of(tmp_path / "out")
    assert "Only these effects were searched for: threshold shift, window loss." in words
    assert "wet target was not searched for" in words
    assert "threshold shift fits worse" in words


@pytest.mark.usefixtures("undrawn")
def test_ignored_parts_are_listed(study: Study, tmp_path: Path) -> None:
    found = report("named", study)
    write_gap(tmp_path / "out", study, replace(found, answer={**found.answer, "ignored_parts": ["s0:0,32"]}))
    assert "were ignored: s0:0,32." in words_of(tmp_path / "out")


@pytest.mark.parametrize("reached", [False, True])
@pytest.mark.usefixtures("undrawn")
def test_a_search_that_stopped_at_its_limit_says_so(study: Study, tmp_path: Path, reached: bool) -> None:
    found = report("named", study)
    answer = {**found.answer, "max_frames": {"limit": 12000, "reached": reached}}
    write_gap(tmp_path / "out", study, replace(found, answer=answer))
    assert ("stopped at its limit of 12,000 simulated frames" in words_of(tmp_path / "out")) == reached


def test_the_whole_catalogue_needs_no_word(pages: dict[str, Path]) -> None:
    assert "searched for" not in words_of(pages["named"])
    assert "were ignored" not in words_of(pages["named"])


def test_the_ranking_lists_candidates_without_idle_parameters(pages: dict[str, Path]) -> None:
    words = words_of(pages["named"])
    assert re.search(r"window loss the window is wet or dirty loss 0\.0200 dB 97 % 812 431 threshold shift", words)
    assert "exponent 0.970 0.7 % 377 866" in words
    assert "saturation" not in words
    assert "Ranking" not in words_of(pages["none"])


def test_the_record_is_shown_in_its_own_uncertainty(pages: dict[str, Path], study: Study) -> None:
    moved = report("named", study).answer["nuisance"]["by_condition"]
    name, factor = list(moved.items())[-1]
    assert factor > 1.3  # far enough that a logarithm differs from a difference
    (one,) = [each for each in study.conditions if each.id == name]
    in_sd = np.log(factor) / one.rel_sd
    assert one.rel_sd > 0
    assert f"{100 * (factor - 1):+.1f} % {in_sd:+.1f}" in words_of(pages["named"])


def test_held_out_conditions_are_named(pages: dict[str, Path], study: Study) -> None:
    (held,) = [one for one in study.holdout if one.weather is not None]
    assert f"Held out: {held.id} (" in words_of(pages["named"])
    assert "The 90 % interval of the departure after is 0.940 to 1.13." in words_of(pages["named"])
    assert "Nothing was added, so before and after are one." in words_of(pages["none"])


def test_angles_are_in_degrees_as_on_the_axis(pages: dict[str, Path]) -> None:
    assert "azimuth, degrees −180 90 +3.10 % of beams +6.7" in words_of(pages["named"])


def svg(uri: str) -> str:
    return base64.b64decode(uri.partition(",")[2]).decode("utf-8")


def marks(text: str, colour: str) -> int:
    """Number of marks that a figure draws in a colour, fill or edge."""
    return len(re.findall(rf"<use [^>]*style=\"[^\"]*{colour}", text))


def test_a_bin_without_enough_in_it_has_no_mark() -> None:
    before = np.array([3.0, np.nan, -40.0])
    curve = Curve("lost_share", "range_m", (0.0, 10.0, 20.0, 30.0), "c0", before, np.array([0.1, np.nan, 0.2]))
    full = Curve("lost_share", "range_m", (0.0, 10.0, 20.0, 30.0), "c0", np.ones(3), np.zeros(3))
    shown, all_shown = svg(curve_uri([curve])), svg(curve_uri([full]))
    for colour in ("#e03131", "#1c7ed6"):
        assert (marks(shown, colour), marks(all_shown, colour)) == (2, 3)


def test_the_same_report_gives_the_same_page(pages: dict[str, Path], study: Study, tmp_path: Path) -> None:
    write_gap(tmp_path / "again", study, report("named", study))
    assert (tmp_path / "again" / "report.html").read_bytes() == (pages["named"] / "report.html").read_bytes()


@pytest.mark.usefixtures("undrawn")
def test_nothing_is_left_where_writing_fails(study: Study, tmp_path: Path) -> None:
    class Broken(GapReport):
        def write(self, folder: Path) -> None:
            (folder / "gap.json").write_text("half", encoding="utf-8")
            raise OSError("disk full")

    good = report("named", study)
    with pytest.raises(OSError, match="disk full"):
        write_gap(tmp_path / "deep" / "out", study, Broken(good.answer, good.effects, good.curves, good.study_sha256))
    assert list(tmp_path.iterdir()) == []


@pytest.mark.usefixtures("undrawn")
def test_names_of_conditions_are_escaped(study: Study, tmp_path: Path) -> None:
    good = report("named", study)
    curves = tuple(
        Curve(one.statistic, one.axis, one.edges, f"<b>{one.condition}", one.before, one.after) for one in good.curves
    )
    write_gap(tmp_path / "out", study, GapReport(good.answer, good.effects, curves, good.study_sha256))
    text = (tmp_path / "out" / "report.html").read_text(encoding="utf-8")
    assert "<b>c" not in text
    assert "&lt;b&gt;c" in text


def test_what_no_effect_explains_has_its_curve_formula_and_stage_on_the_page(pages: dict[str, Path]) -> None:
    words = words_of(pages["unknown"])
    assert "Intensity over clear air's, by azimuth: of all statistics this one departs most significantly" in words
    assert "It is largest from −112 to −90 (azimuth, degrees): +7.4 standard deviations." in words
    assert "a sine: 0.0513 sin(3 azimuth_rad + 0.4) , ln(intensity ratio); χ² per degree of freedom 1.13" in words
    assert "intensity, valid between −158 and 180 (azimuth, degrees); in model.yaml" in words
    assert 'read_model("model.yaml").apply(LidarWeather(weather, sensor), empirical=True)' in words
    found = read_model(pages["unknown"] / "model.yaml")
    assert found.empirical is not None
    assert found.empirical.config() == EMPIRICAL.config()


def test_what_no_stage_copies_says_why(pages: dict[str, Path]) -> None:
    words = words_of(pages["named_and_rest"])
    assert "−0.210 (−0.240 to −0.180), change from the first frame to the last" in words
    assert (
        "none: it changes from the first frame to the last, and a stage does not know when a frame was taken" in words
    )
    assert "empirical=True" not in words


@pytest.mark.usefixtures("undrawn")
def test_a_curve_without_a_formula_says_so(study: Study, tmp_path: Path) -> None:
    write_gap(tmp_path / "out", study, report("unknown", study, unknown={**UNKNOWN, "formula": None}))
    assert "Simplest formula none: no constant, line, logarithm," in words_of(tmp_path / "out")


def test_what_acts_exactly_like_an_effect_is_said_with_what_would_tell(pages: dict[str, Path]) -> None:
    words = words_of(pages["named"])
    assert "Cannot be told apart with these data: a laser that is weaker than in the clear frames acts exactly" in words
    assert "It would be with clear frames recorded after those in weather" in words
    assert "a higher detection threshold" not in words  # the study has intensities
    assert "Cannot be told apart" not in words_of(pages["none"])


def test_a_sensor_without_intensities_cannot_tell_the_window_from_the_threshold() -> None:
    (_, (twin, data)) = exact_twins("lidar.window_loss", with_intensity=False)
    assert twin == "a higher detection threshold (lidar.threshold_shift)"
    assert "intensities" in data


def test_the_map_shows_numbers_and_leaves_out_what_never_counts(study: Study) -> None:
    groups = (("lost_share", "range_m"), ("particles", "place"))
    picture = svg(residual_uri(ResidualMap(groups, ("c0", "c1"), np.array([[12.3, np.nan], [np.nan, np.nan]]), None)))
    shown = re.findall(r"<!-- (.*?) -->", picture)
    assert "Beams that lost their return, by range" in shown
    assert "Map of the particle returns, in one place of every frame" not in shown
    assert {"12", "–"} <= set(shown)


def test_the_map_has_the_largest_departure_in_its_own_unit_beside_it() -> None:
    groups = (("lost_share", "range_m"), ("log_intensity_ratio", "frame"), ("lost_share", "azimuth_rad"))
    groups += (("particles", "azimuth_rad"),)
    nothing = BinDeparture(4.51e-16, "% of beams", 0.0, 1.0)  # of a row that departs nowhere
    largest = (BinDeparture(3.21, "% of beams", 17.0, 23.0), BinDeparture(-0.5, "dB", 0.0, 1.0), None, nothing)
    picture = svg(residual_uri(ResidualMap(groups, ("c0",), np.array([[12.3], [2.0], [1.0], [0.01]]), None, largest)))
    shown = re.findall(r"<!-- (.*?) -->", picture)
    assert {"+3.21 % of beams, 17 to 23 m", "−0.500 dB", "as it is: the largest, measured less simulated"} <= set(shown)
    assert not any("4.51" in text for text in shown)


def test_a_response_is_drawn_for_the_measurement_and_every_effect() -> None:
    edges = (0.0, 10.0, 20.0, 30.0)
    values = np.array([1.0, np.nan, -8.0])
    three = [
        Response("lost_share", "range_m", edges, name, values) for name in (None, "lidar.window_loss", "lidar.spray")
    ]
    shown = re.findall(r"<!-- (.*?) -->", svg(response_uri(three)))
    assert {"measured", "window loss", "spray"} <= set(shown)


def test_versions_stand_on_the_page(pages: dict[str, Path]) -> None:
    assert f"torch {torch.__version__}, numpy {np.__version__}, Python" in words_of(pages["none"])


# ---- for a sensor engineer -------------------------------------------------------------------------------------------


@pytest.mark.parametrize("verdict", VERDICTS)
def test_no_word_of_the_method_stands_on_the_page_without_its_definition(verdict: str, pages: dict[str, Path]) -> None:
    words = words_of(pages[verdict]).lower()
    for private in ("scatters", "floor", "entries", "nuisance", "whitened", "held-out gap"):
        assert private not in words, private
    assert "missing is what acts in the measured frames and not in the simulated ones" in words
    assert "standard deviation of chance is that of the difference between two simulations" in words


@pytest.mark.parametrize("verdict", VERDICTS)
def test_missing_means_one_thing(verdict: str, pages: dict[str, Path]) -> None:
    """What the simulation lacks; never what the study or the catalogue lacks."""
    words = words_of(pages[verdict])
    assert "What the study lacks" not in words
    assert "missing from the catalogue" not in words
    assert "found missing." not in words


def test_the_page_goes_from_the_sentence_to_the_data_that_would_decide(pages: dict[str, Path]) -> None:
    page = (pages["named"] / "report.html").read_text(encoding="utf-8")
    titles = [re.sub("<[^>]*>", "", one).strip() for one in re.findall(r"<h2[^>]*>(.*?)</h2>", page, re.DOTALL)]
    assert titles[:5] == ["Where", "What", "Ranking", "What remains", "What data would decide"]


def test_the_record_s_alarm_stands_beside_the_headline(pages: dict[str, Path]) -> None:
    words = words_of(pages["named"])  # a record of 10 %, moved by up to 42 %
    assert words.index("The weather record is in doubt.") < words.index("Where")
    assert "of its standard deviations)" in words


@pytest.mark.usefixtures("undrawn")
def test_a_record_within_its_uncertainty_is_no_alarm(study: Study, tmp_path: Path) -> None:
    moved = {"rate_factor": 1.0, "by_condition": {one.id: 1.01 for one in study.fit if one.weather is not None}}
    write_gap(tmp_path / "out", study, report("named", study, nuisance=moved))
    assert "in doubt" not in words_of(tmp_path / "out")


def test_the_scan_counts_the_places_that_depart(pages: dict[str, Path]) -> None:
    words = words_of(pages["named"])
    assert "more than 3 standard deviations of chance apart: 6 of 23. By chance alone it would be one or none." in words


@pytest.mark.parametrize(
    ("ends", "text"),
    [
        ([0.018, 0.022], "0.0180 to 0.0220"),
        ([0.0, 0.022], "0.0220 or less"),
        ([0.018, 30.0], "0.0180 or more"),
        ([0.0, 30.0], "not determined by these data"),
    ],
)
def test_an_end_of_the_search_is_no_end_of_an_interval(ends: list[float], text: str) -> None:
    (row,) = parameter_rows({**WINDOW_LOSS, "interval": {"loss_db": ends}})
    assert row["interval"] == text


def test_an_interval_over_a_whole_turn_is_no_interval() -> None:
    """Answers hold six digits of pi."""
    effect = {"name": "lidar.sector_loss", "parameters": {"azimuth_rad": 0.5}}
    declared = next(one for one in EFFECTS["lidar.sector_loss"].arguments if one.name == "azimuth_rad")
    ends = [float(f"{end:.6g}") for end in (declared.low, declared.high)]
    assert (
        parameter_rows({**effect, "interval": {"azimuth_rad": ends}})[0]["interval"] == "not determined by these data"
    )


@pytest.mark.usefixtures("undrawn")
def test_a_value_on_its_bound_is_said_in_sentence_table_and_confidence(study: Study, tmp_path: Path) -> None:
    loss = {**WINDOW_LOSS, "parameters": {"loss_db": 30.0}, "interval": {"loss_db": [24.0, 30.0]}}
    loss |= {"at_bound": {"loss_db": "highest"}, "beside_bound": []}
    zone = {
        "name": "lidar.blind_zone",
        "parameters": {"range_m": 2.0},
        "interval": {"range_m": [1.5, 2.5]},
        "confidence": 0.8,
        "confusable_with": [],
        "at_bound": {},
        "beside_bound": ["lidar.window_loss"],
    }
    write_gap(tmp_path / "out", study, report("named", study, effects=[loss, zone]))
    words = words_of(tmp_path / "out")
    assert "loss 30.0 dB (90 %: 24.0 or more)" in words
    assert (
        "The loss of window loss is the highest value that is searched, 30.0 dB: the true one may be higher." in words
    )
    assert "24.0 or more the highest value searched" in words
    assert "confidence 0.80, lowered: window loss beside it ends where the search does" in words
    assert (
        "Confidence 0.80: its posterior, below, times the share of right names in development studies. It is" in words
    )


def test_a_curve_is_drawn_in_its_own_unit_and_in_standard_deviations(study: Study) -> None:
    members = [one for one in report("named", study).curves if one.statistic == "lost_share"]
    shown = re.findall(r"<!-- (.*?) -->", svg(curve_uri(members)))
    assert {"% of beams", "standard deviations,"} <= set(shown)


@pytest.mark.parametrize(("size", "label"), [(5.0, "measured − simulated"), (400.0, "logarithmic beyond ±3")])
def test_a_scale_is_linear_or_labelled(size: float, label: str) -> None:
    curve = Curve("lost_share", "range_m", (0.0, 10.0, 20.0), "c0", np.array([size, -1.0]), None)
    assert label in re.findall(r"<!-- (.*?) -->", svg(curve_uri([curve])))


def test_classes_have_their_names_on_the_axis() -> None:
    curve = Curve("lost_target_share", "target_class", (-0.5, 0.5, 1.5), "c0", np.array([3.0, -1.0]), None)
    shown = re.findall(r"<!-- (.*?) -->", svg(curve_uri([curve])))
    assert {"0", "1"} <= set(shown)
    assert "−0.5" not in shown


@pytest.mark.parametrize(
    ("kind", "transform"), [("lidar", "LidarWeather"), ("camera", "BayerWeather"), ("radar", "RadarAttenuation")]
)
def test_the_lines_of_code_are_of_the_study_s_sensor(kind: str, transform: str, tmp_path: Path) -> None:
    study = studies.study(kind)
    write_gap(tmp_path / "out", study, report("named", study))
    words = words_of(tmp_path / "out")
    assert f'repaired = {transform}(weather, sensor, effects=read_model("model.yaml"))' in words
    assert f"from torchweather import {transform}" in words


def test_neighbouring_axes_have_names_of_their_own() -> None:
    near, far = (group_name("log_ratio_green", f"elevation_rad_{where}") for where in ("near", "far"))
    assert (near, far) == (
        "Green light over clear air's, by elevation, near by",
        "Green light over clear air's, by elevation, far",
    )


@pytest.mark.usefixtures("undrawn")
def test_a_scan_without_departing_places_says_what_one_would_take(study: Study, tmp_path: Path) -> None:
    """A map of no departures above curves that depart is no contradiction: a curve adds many places up."""
    found = report("named", study)
    assert found.places is not None
    chance = np.full_like(found.places.before, 0.4 + np.nanmax(np.abs(found.places.before)))
    write_gap(tmp_path / "out", study, replace(found, places=replace(found.places, chance=chance)))
    words = words_of(tmp_path / "out")
    least, unit = 3.0 * chance[0], found.places.values.unit
    assert ": 0 of " in words
    assert f"a single place stands out only where it departs by {number_text(least)} {unit} or more" in words
