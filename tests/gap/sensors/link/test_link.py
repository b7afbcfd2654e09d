"""The search on microwave links: hidden losses at the ends and on the path, of records made here.

The generator has its own rain, its own film and its own noise; of the library it takes the law of attenuation alone.
"""

from __future__ import annotations

import json
import math
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.gap.tiny_link_study import LINKS, STEP_MIN
from tests.gap.tiny_link_study import link_record as record
from tests.gap.tiny_link_study import tiny_link_study as study
from torchweather.atmosphere.weather import Rain
from torchweather.core.errors import TorchweatherError
from torchweather.gap import Study, find_gap
from torchweather.gap.gap_report import GapReport
from torchweather.gap.sensors.link.effects import attenuation_db
from torchweather.gap.sensors.link.frames import LinkFrames
from torchweather.gap.sensors.link.samples import LinkSamples, Scatter, link_samples
from torchweather.radar.effects.all import RadarNoiseFloor, RadarPathLossScale, RadarWetRadome
from torchweather.sensors import Lidar, Radar
from torchweather.transforms import LidarWeather, RadarAttenuation


def named(report: GapReport) -> dict[str, dict[str, float]]:
    return {one["name"]: one["parameters"] for one in report.answer["effects"]}


@cache
def searched(*effects: str) -> GapReport:
    """The search on links with a film on their covers, among some effects or all."""
    return find_gap(study(film_db=1.2), effects=effects or None)


def inside(report: GapReport, name: str, value: float) -> bool:
    low, high = report.answer["effects"][0]["interval"][name]
    return bool(low <= value <= high)


# ---- what is found ---------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_links_that_lose_what_the_rain_takes_lack_nothing(seed: int) -> None:
    found = find_gap(study(seed=seed))
    assert found.verdict == "none"
    assert found.answer["p_value"] > 1e-3


@pytest.mark.parametrize("rel_sd", [0.0, 0.2])
def test_a_constant_loss_while_the_covers_are_wet_is_found_with_how_long_it_lasts(rel_sd: float) -> None:
    found = find_gap(study(rel_sd, constant_db=1.0, drying_min=12.0))
    assert found.verdict == "named"
    effect = named(found)["radar.wet_radome"]
    assert effect["loss_db"] + effect["film_db"] == pytest.approx(1.0, abs=0.2)
    assert inside(found, "drying_min", 12.0)
    assert found.answer["gap"]["after"] < 1.3 * found.answer["gap"]["floor"] < found.answer["gap"]["before"]


def test_a_film_that_grows_with_the_root_of_the_rain_is_found() -> None:
    found = searched()
    assert found.verdict == "named"
    effect = named(found)["radar.wet_radome"]
    for rate in (0.5, 2.0, 10.0):
        loss = effect["loss_db"] + effect["film_db"] * rate ** effect["film_exponent"]
        assert loss == pytest.approx(1.2 * math.sqrt(rate), rel=0.15, abs=0.1)


def test_a_scale_of_the_path_is_named_while_the_reference_counts_as_exact() -> None:
    found = find_gap(study(scale=1.5))
    assert list(named(found)) == ["radar.path_loss_scale"]
    assert named(found)["radar.path_loss_scale"]["factor"] == pytest.approx(1.5, abs=0.08)


def test_it_is_the_reference_s_where_that_may_be_off() -> None:
    """1.5 is two standard deviations of 20 %: rain that was read too low."""
    found = find_gap(study(0.2, scale=1.5))
    assert found.verdict == "none"
    assert found.answer["nuisance"]["rate_factor"] == pytest.approx(1.5 ** (1 / 1.05), rel=0.15)


def test_a_path_scale_is_never_named_beside_another() -> None:
    found = find_gap(study(constant_db=1.5, scale=1.4))
    assert list(named(found)) == ["radar.wet_radome"]


def test_the_loss_at_the_ends_ranks_before_that_of_the_path() -> None:
    alone = [searched(name) for name in ("radar.wet_radome", "radar.path_loss_scale")]
    gains = [one.answer["candidates"][0]["gain"] for one in alone]
    assert gains[0] > 1.5 * gains[1]
    assert alone[1].answer["gap"]["after"] > 1.5 * alone[1].answer["gap"]["floor"]


def test_the_same_seed_gives_the_same_answer() -> None:
    one, other = (searched("radar.wet_radome"), find_gap(study(film_db=1.2), effects=["radar.wet_radome"]))
    assert {**one.to_dict(), "seconds": 0} == {**other.to_dict(), "seconds": 0}


def test_a_model_that_has_the_effect_lacks_nothing() -> None:
    effect = RadarWetRadome(film_db=1.2, film_exponent=0.5, drying_min=12.0)
    assert find_gap(study(film_db=1.2), model_effects=[effect]).verdict == "none"


# ---- its parts -------------------------------------------------------------------------------------------------------


def samples_of(**more: Any) -> LinkSamples:
    made = record(**more)
    return link_samples(made["links"], made["series"], np.ones(LINKS, bool), "test")[0]


def test_effects_on_a_link_are_the_formulas() -> None:
    samples = samples_of()
    rain = attenuation_db(samples, [])
    assert np.array_equal(rain, samples.path_db)
    radome = RadarWetRadome(loss_db=0.5, film_db=2.0, film_exponent=0.4, drying_min=10.0)
    dried = np.exp(-samples.since_min / 10.0)
    wanted = rain + dried * (0.5 + 2.0 * samples.wet_mm_per_h**0.4)
    np.testing.assert_allclose(attenuation_db(samples, [radome]), wanted, rtol=1e-6)
    np.testing.assert_allclose(attenuation_db(samples, [RadarPathLossScale(factor=1.3)]), 1.3 * rain, rtol=1e-6)
    with pytest.raises(ValueError, match="does nothing to a link"):
        attenuation_db(samples, [RadarNoiseFloor(shift_db=1.0)])


def test_more_rain_than_recorded_is_the_power_law() -> None:
    samples = samples_of()
    wet = samples.of(samples.since_min == 0)
    ratio = attenuation_db(wet, [], math.log(2.0)) / attenuation_db(wet, [])
    np.testing.assert_allclose(ratio, 2.0**wet.exponent, rtol=1e-9)
    assert 0.8 < wet.exponent.min() < wet.exponent.max() < 1.15  # a of 18 to 38 GHz (P.838-3)


def test_samples_after_rain_know_how_long_it_is_over() -> None:
    samples = samples_of()
    later = samples.of(samples.since_min > 0)
    assert set(np.unique(later.since_min)) == {STEP_MIN * step for step in range(1, 25)}
    assert (later.path_db == 0).all()
    assert (later.wet_mm_per_h >= 0.1).all()


def test_the_parts_of_the_scatter_are_found() -> None:
    rng = np.random.default_rng(0)
    link, hour = (part.ravel() for part in np.meshgrid(np.arange(200), np.repeat(np.arange(8), 12), indexing="ij"))
    number = len(link)
    apart = rng.normal(0.0, 0.5, 200)[link] + rng.normal(0.0, 0.8, 1600)[link * 8 + hour] + rng.normal(0.0, 1.0, number)
    zero = np.zeros(number)
    samples = LinkSamples(link, hour, zero, zero, zero, zero, zero, zero, zero, apart)
    found = Scatter.of(samples, np.zeros(number, np.int64))
    # 200 links: a variance of 0.25 + 0.64 / 8 known to sqrt(2 / 200), 10 %; 1,400 hours more: 4 %.
    assert found.link == pytest.approx(0.25, abs=4 * 0.1 * 0.33)
    assert found.hour == pytest.approx(0.64, rel=4 * 0.04)
    assert found.sample == pytest.approx(1.0, rel=0.03)
    drawn = found.drawn(samples, 5)
    assert drawn.var() == pytest.approx(found.link + found.hour + found.sample, rel=0.15)
    assert np.array_equal(drawn, found.drawn(samples, 5))
    assert not np.array_equal(drawn, found.drawn(samples, 6))


def test_links_that_are_held_out_are_not_fitted_to() -> None:
    made = study()
    model = LinkFrames(made)
    held, length_km = np.asarray(made.links["split"]) == 1, np.asarray(made.links["length_km"])
    assert not set(length_km[held]) & set(length_km[~held])  # which tell the links apart
    for conditions, links in ((model.fit, ~held), (model.holdout, held)):
        fitted = np.concatenate([model.samples[one.id].length_km for one in conditions])
        assert set(fitted) == set(length_km[links])


def test_sums_are_those_of_the_samples() -> None:
    model = LinkFrames(study())
    condition = model.fit[2]
    samples = model.samples[condition.id]
    found = model.measured(condition)
    start = 0
    for group in model.layout.binned:
        values = {"length_km": samples.length_km, "frequency_ghz": samples.frequency_ghz}.get(group.axis)
        for place, (low, high) in enumerate(zip(group.edges, group.edges[1:], strict=False)):
            if values is not None:
                own = samples.measured_db[(values >= low) & (values < high)]
                assert found.weight[0, start + place] == len(own)
                assert found.value[0, start + place] == pytest.approx(own.sum())
                assert found.square[0, start + place] == pytest.approx((own**2).sum())
        start += group.bins
    portioned = model.simulated(condition, [], 0.0, [7, 8], portions=16)
    whole = model.simulated(condition, [], 0.0, [7, 8])
    np.testing.assert_allclose(portioned.value.reshape(2, 16, -1).sum(1), whole.value, rtol=1e-9)


# ---- the record ------------------------------------------------------------------------------------------------------


def test_the_uncertainty_of_the_rain_is_written_and_read(tmp_path: Path) -> None:
    made = study(0.15)
    made.write(tmp_path / "links")
    assert "rain_rel_sd: 0.15" in (tmp_path / "links" / "study.yaml").read_text()
    read = Study.read(tmp_path / "links")
    assert read.conditions[0].rel_sd == 0.15
    assert read.sha256 == made.sha256
    json.dumps(find_gap(read).to_dict())


def changed(series: dict[str, Any], links: dict[str, Any]) -> Study:
    made = record()
    condition = {"id": "may", "frames": [made["series"] | series]}
    return Study.from_arrays(kind="link", links=made["links"] | links, conditions=[condition])


RAIN = record()["series"]["rain_mm_per_h"]
BROKEN: list[tuple[str, dict[str, Any], dict[str, Any], str]] = [
    ("no rain", {"rain_mm_per_h": np.zeros_like(RAIN)}, {}, "no rain"),
    ("never dry", {"rain_mm_per_h": np.full_like(RAIN, 2.0)}, {}, "no dry sample"),
    (
        "none held out",
        {},
        {"split": np.zeros(LINKS, int)},
        r"split: expected links to fit to \(0\) and others held out",
    ),
    ("all held out", {}, {"split": np.ones(LINKS, int)}, "All links are held out"),
]


@pytest.mark.parametrize(("series", "links", "message"), [one[1:] for one in BROKEN], ids=[one[0] for one in BROKEN])
def test_a_record_that_cannot_tell_is_refused(series: dict[str, Any], links: dict[str, Any], message: str) -> None:
    with pytest.raises(TorchweatherError, match=message):
        find_gap(changed(series, links))


def test_a_single_link_is_refused() -> None:
    made = record()
    links = {name: values[:1] for name, values in made["links"].items()}
    series = {name: values if name == "time_s" else values[:, :1] for name, values in made["series"].items()}
    one = Study.from_arrays(kind="link", links=links, conditions=[{"id": "may", "frames": [series]}])
    with pytest.raises(TorchweatherError, match="not enough data to decide"):
        find_gap(one)


def test_a_model_of_links_has_no_options() -> None:
    with pytest.raises(TorchweatherError, match="the model of links has none"):
        find_gap(study(), options={"variant": "d3_4"})


def test_what_was_found_on_links_goes_into_a_radar_and_into_no_lidar() -> None:
    found = searched()
    repaired = found.apply(RadarAttenuation(Rain(10.0), Radar.preset("imaging-77ghz")))
    assert "wet_radome" in repaired.chain.stages
    with pytest.raises(ValueError, match=r"radar\.wet_radome"):
        found.apply(LidarWeather(Rain(10.0), Lidar.preset("ouster-os1-128")))
    with pytest.raises(TypeError, match="expected a LidarWeather, a BayerWeather or a RadarAttenuation; got Rain"):
        found.apply(Rain(10.0))  # type: ignore[type-var]
