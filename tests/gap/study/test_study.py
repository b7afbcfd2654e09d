"""Studies from arrays: what they hold, what is held out, which data are refused and how."""

from __future__ import annotations

import copy
import math
import pickle
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.gap.studies import CAMERA, FRAMES, KINDS, LIDAR, H, W, arguments, lidar_frame, study
from torchweather.atmosphere.weather import Fog, Mixture, Rain
from torchweather.core.errors import TorchweatherError
from torchweather.gap.study.frames import Frames
from torchweather.gap.study.study import Study
from torchweather.sensors import Lidar

every_kind = pytest.mark.parametrize("kind", KINDS)


def changed(kind: str, path: tuple[Any, ...], value: Any) -> dict[str, Any]:
    """Arguments with one value replaced; ``...`` takes the key away."""
    found = copy.deepcopy(arguments(kind, clear=2, frames=2))
    place: Any = found
    for key in path[:-1]:
        place = place[key]
    if value is ...:
        del place[path[-1]]
    else:
        place[path[-1]] = value
    return found


def grid(value: float, *, at: tuple[int, ...] | None = None, shape: tuple[int, ...] = (H, W)) -> Any:
    """An array of 0.5, or of a value; at one place where that is given."""
    found = np.full(shape, 0.5 if at is not None else value)
    if at is not None:
        found[at] = value
    return found


# ---- what it holds ---------------------------------------------------------------------------------------------------


@every_kind
def test_a_study_holds_what_it_was_given(kind: str) -> None:
    given_values, built = arguments(kind), study(kind)
    assert built.kind == kind
    assert [one.id for one in built.conditions] == [one["id"] for one in given_values["conditions"]]
    for one, row in zip(built.conditions, given_values["conditions"], strict=True):
        assert len(one.frames) == len(row["frames"])
        for frame, source in zip(one.frames, row["frames"], strict=True):
            assert set(frame) == set(source)
            for name, array in source.items():
                assert np.array_equal(frame[name], array, equal_nan=True)
                assert frame[name].dtype == array.dtype
    if kind != "link":
        assert built.scene_of(built.conditions[1]).id == "s1"
        assert [one.rel_sd for one in built.conditions] == [0.1, 0.2, 0.3, 0.0, 0.1]
        assert built.conditions[0].weather == Rain(25)
        assert built.conditions[3].weather is None
        assert built.conditions[0].ego_speed_m_per_s == 13.9
        assert built.conditions[0].exposure_s == 0.004


def test_weather_is_an_object_a_text_or_keys() -> None:
    ways: list[Any] = [Fog(50.0), "fog:mor=50", {"kind": "fog", "mor_m": 50.0}]
    built = [Study.from_arrays(**changed("lidar", ("conditions", 0, "weather"), way)) for way in ways]
    assert [one.conditions[0].weather for one in built] == [Fog(50.0)] * 3
    for way in (None, "clear", {"kind": "clear"}):
        assert Study.from_arrays(**changed("lidar", ("conditions", 0, "weather"), way)).conditions[0].weather is None


def test_tensors_are_arrays_too() -> None:
    frame = {key: torch.from_numpy(value) for key, value in lidar_frame(np.random.default_rng(1)).items()}
    built = Study.from_arrays(**changed("lidar", ("conditions", 0, "frames"), [frame, frame]))
    assert isinstance(built.conditions[0].frames[0]["range_m"], np.ndarray)


def test_a_lidar_with_a_scan_pattern_needs_no_beams() -> None:
    lidar = Lidar(905.0, elevations_deg=(-3.0, -1.0, 1.0, 3.0), columns=W)
    values = arguments("lidar", clear=2, frames=2)
    del values["beams"]
    built = Study.from_arrays(**{**values, "sensor": lidar})
    assert built.beams["direction"].shape == (4, W, 3)
    assert built.beams["direction"][2, 0] == pytest.approx([math.cos(math.radians(1)), 0.0, math.sin(math.radians(1))])


@every_kind
def test_a_study_can_be_pickled_and_keeps_its_hash(kind: str) -> None:
    built = study(kind)
    assert pickle.loads(pickle.dumps(built)).sha256 == built.sha256


def test_frames_are_a_sequence() -> None:
    frames = study("camera").conditions[0].frames
    assert len(frames) == 5
    assert isinstance(frames[1:3], Frames)
    assert np.array_equal(frames[1:3][0]["bayer"], frames[1]["bayer"])
    assert np.array_equal(frames[-1]["bayer"], frames[4]["bayer"])
    assert len(list(frames)) == 5
    with pytest.raises(IndexError):
        frames[5]


# ---- hash ------------------------------------------------------------------------------------------------------------


@every_kind
def test_the_same_content_has_the_same_hash_and_other_content_another(kind: str) -> None:
    first = study(kind)
    assert study(kind).sha256 == first.sha256
    assert study(kind, seed=1).sha256 != first.sha256


@pytest.mark.parametrize(
    ("path", "value"),
    [
        (("conditions", 0, "weather"), Rain(26.0)),
        (("conditions", 1, "time_s"), [0.0, 0.2]),
        (("conditions", 1, "split"), "holdout"),
        (("conditions", 2, "id"), "other"),
        (("conditions", 2, "ego_speed_m_per_s"), 1.0),
        (("scenes", 0, "geometry"), ...),
        (("sensor",), Lidar.preset("ouster-os1-128", range_at_10_percent_m=33.4)),
    ],
    ids=str,
)
def test_every_part_counts_in_the_hash(path: tuple[Any, ...], value: Any) -> None:
    assert Study.from_arrays(**changed("lidar", path, value)).sha256 != study("lidar", clear=2, frames=2).sha256


@pytest.mark.parametrize("path", [("scenes", 1, "clear", 1), ("conditions", 2, "frames", 1)], ids=["clear", "measured"])
def test_one_changed_number_of_one_frame_changes_the_hash(path: tuple[Any, ...]) -> None:
    other = changed("radar", (*path, "noise_floor_db"), np.array(-100.0 + 1e-12))
    assert Study.from_arrays(**other).sha256 != study("radar", clear=2, frames=2).sha256


# ---- what is held out ------------------------------------------------------------------------------------------------


def split_of(*weathers: Any, scenes: Any = None, stated: Any = None) -> list[str]:
    rng = np.random.default_rng(0)
    values = arguments("lidar", clear=2, frames=1)
    values["conditions"] = [
        {
            "id": f"c{k}",
            "scene": scenes[k] if scenes else "s0",
            "weather": weather,
            "frames": [lidar_frame(rng)],
            **({"split": stated[k]} if stated and stated[k] else {}),
        }
        for k, weather in enumerate(weathers)
    ]
    return [one.split for one in Study.from_arrays(**values).conditions]


def test_of_the_severities_of_a_weather_every_third_is_held_out() -> None:
    assert split_of(*(Rain(float(rate)) for rate in (1, 2, 5, 10, 25, 50))) == [
        *("fit", "holdout", "fit"),
        *("fit", "holdout", "fit"),
    ]
    # Whatever the order; of fog the smaller visibility is the worse.
    assert split_of(Fog(20.0), Fog(100.0), Fog(50.0)) == ["fit", "fit", "holdout"]


def test_held_out_is_never_only_other_frames_of_a_condition() -> None:
    assert split_of(Rain(5.0), Rain(5.0), Rain(5.0)) == ["fit"] * 3
    assert split_of(Rain(5.0), Rain(10.0), Rain(10.0)) == ["fit", "holdout", "holdout"]
    # The same rate in another scene is another condition.
    assert split_of(Rain(5.0), Rain(5.0), scenes=["s0", "s1"]) == ["fit", "holdout"]


def test_each_kind_of_weather_keeps_a_condition_to_fit_to_and_clear_air_is_fitted() -> None:
    assert split_of(Rain(5.0), Fog(50.0), None) == ["fit", "fit", "fit"]
    assert split_of(None, Rain(5.0), Rain(9.0), Fog(50.0), Fog(10.0)) == ["fit", "fit", "holdout", "fit", "holdout"]


def test_a_stated_split_holds_and_others_of_its_condition_follow() -> None:
    assert split_of(Rain(5.0), Rain(9.0), Rain(20.0), stated=["holdout", None, None]) == ["holdout", "fit", "fit"]
    assert split_of(Rain(5.0), Rain(5.0), Rain(9.0), stated=[None, "holdout", None]) == ["holdout", "holdout", "fit"]
    assert split_of(Rain(5.0), Rain(9.0), stated=["fit", None]) == ["fit", "fit"]


@settings(max_examples=30, deadline=None)
@given(st.lists(st.sampled_from([1.0, 2.0, 5.0, 10.0, 20.0]), min_size=1, max_size=8), st.randoms())
def test_the_split_depends_on_the_conditions_and_not_on_their_order(rates: list[float], random: Any) -> None:
    by_rate = dict(zip(rates, split_of(*map(Rain, rates)), strict=True))
    shuffled = list(rates)
    random.shuffle(shuffled)
    assert split_of(*map(Rain, shuffled)) == [by_rate[rate] for rate in shuffled]
    assert ("holdout" in by_rate.values()) == (len(by_rate) > 1)
    assert "fit" in by_rate.values()


def test_fit_and_holdout_are_the_conditions_by_split() -> None:
    built = study("lidar")
    assert {one.id for one in built.fit} | {one.id for one in built.holdout} == {one.id for one in built.conditions}
    assert all(one.split == "holdout" for one in built.holdout)
    # Of links the same series is fitted and held out: links["split"] says which link.
    links = study("link")
    assert links.fit == links.holdout == links.conditions


# ---- bad data --------------------------------------------------------------------------------------------------------

LIDAR_FRAME = ("conditions", 0, "frames", 1)
CAMERA_FRAME = ("conditions", 0, "frames", 1)
BAD_ARRAYS = [
    ("lidar", (*LIDAR_FRAME, "range_m"), grid(-1.0, at=(0, 1)), r"frames\[1\]: range_m must be 0 m .*-1.0 at \(0, 1\)"),
    ("lidar", (*LIDAR_FRAME, "range_m"), grid(np.inf), r"range_m must be 0 m \(no return\).*inf.*24 of 24"),
    ("lidar", (*LIDAR_FRAME, "range_m"), grid(np.nan), r"range_m must be .*Set beams without a return to 0"),
    ("lidar", (*LIDAR_FRAME, "intensity"), grid(np.nan, at=(3, 3)), r"intensity must be 0 or more in the sensor's"),
    ("lidar", (*LIDAR_FRAME, "range_m"), ..., r"the array 'range_m' is missing: \(H, W\), 0 m"),
    ("lidar", (*LIDAR_FRAME, "range_m"), np.ones((H, W + 1)), r"\(H, W\) = \(4, 6\) as in the beams; got \(4, 7\)"),
    ("lidar", (*LIDAR_FRAME, "range_m"), np.ones((H, W), complex), r"range_m must be real numbers.*complex128"),
    ("lidar", (*LIDAR_FRAME, "range_m"), np.full((H, W), "x"), r"real numbers.*got dtype <U1"),
    ("lidar", ("beams", "direction"), np.ones((H, W, 3)), r"direction must be unit vectors.*Divide by their length"),
    ("lidar", ("beams", "direction"), np.ones((H, W)), r"direction must have shape \(H, W, 3\)"),
    ("lidar", ("beams", "direction"), np.ones((0, W, 3)), r"direction must hold numbers.*empty"),
    ("lidar", ("scenes", 0, "geometry"), {"cos_incidence": grid(1.1)}, r"cos_incidence must be 0..1"),
    ("lidar", ("scenes", 0, "geometry"), {"up": grid(-2.0)}, r"up must be -1..1"),
    ("lidar", ("scenes", 0, "geometry"), {"cos_incidance": grid(0.5)}, r"Did you mean 'cos_incidence'"),
    ("camera", (*CAMERA_FRAME, "bayer"), grid(1.5), r"bayer must be 0 \(black\) to 1.*Subtract the black level"),
    ("camera", (*CAMERA_FRAME, "bayer"), grid(np.nan, at=(0, 0)), r"bayer must be 0"),
    ("camera", (*CAMERA_FRAME, "bayer"), np.ones((H, W, 1)), r"bayer must have shape \(H, W\) = \(4, 6\)"),
    ("camera", (*CAMERA_FRAME, "bayer"), np.ones((W, H)) / 2, r"as in the sensor \(height, width\); got \(6, 4\)"),
    ("camera", ("scenes", 0, "geometry", "depth_m"), grid(0.0), r"depth_m must be above 0 m.*Sky is inf"),
    ("camera", ("scenes", 0, "geometry", "depth_m"), grid(np.nan), r"depth_m must be above 0 m"),
    ("camera", ("scenes", 0, "geometry", "normal"), np.ones((H, W, 3)), r"normal must be unit vectors"),
    ("camera", ("scenes", 0, "geometry", "label"), grid(0.5), r"label must be whole numbers"),
    ("camera", ("scenes", 0, "geometry"), ..., r"scenes\[0\].geometry is missing: a camera study needs depth_m"),
    ("radar", ("scenes", 1, "geometry"), ..., r"scenes\[1\].geometry is missing.*azimuth_rad"),
    ("radar", ("scenes", 0, "geometry", "azimuth_rad"), np.full(5, 90.0), r"azimuth_rad must be .*Degrees are not"),
    ("radar", ("scenes", 0, "geometry", "target_class"), np.full(5, 0.5), r"target_class must be whole numbers"),
    ("radar", (*LIDAR_FRAME, "power_db"), np.full(5, -np.inf), r"power_db must be finite in dB, or NaN where the"),
    ("radar", (*LIDAR_FRAME, "power_db"), np.zeros(4), r"power_db must have shape \(N,\) = \(5,\) as in the geometry"),
    ("radar", (*LIDAR_FRAME, "range_m"), np.full(5, np.nan), r"range_m must be a number wherever power_db is one"),
    ("radar", (*LIDAR_FRAME, "range_m"), np.full(5, -2.0), r"range_m must be 0 m or more"),
    ("radar", (*LIDAR_FRAME, "noise_floor_db"), np.zeros(5), r"noise_floor_db must have shape \(\) \(a scalar\); got"),
    ("radar", (*LIDAR_FRAME, "noise_floor_db"), np.array(np.nan), r"noise_floor_db must be finite in dB; got nan"),
    ("radar", (*LIDAR_FRAME, "clutter"), np.zeros((2, 5)), r"clutter must have shape \(M, 6\)"),
    ("radar", (*LIDAR_FRAME, "clutter"), np.full((2, 6), np.nan), r"clutter must be finite: range m"),
    ("link", ("links", "length_km"), np.zeros(3), r"length_km must be above 0 km"),
    ("link", ("links", "frequency_ghz"), np.full(3, 38000.0), r"frequency_ghz must be 1..1000 GHz.*Divide MHz"),
    ("link", ("links", "polarisation"), np.full(3, 2), r"polarisation must be 0 \(horizontal\) or 1"),
    ("link", ("links", "split"), np.full(2, 1), r"split must have shape \(L,\)"),
    (
        "link",
        ("conditions", 0, "frames", 0, "attenuation_db"),
        np.zeros((40, 2)),
        r"\(T, L\) = \(40, 3\) as in the links",
    ),
    ("link", ("conditions", 0, "frames", 0, "attenuation_db"), np.full((40, 3), np.nan), r"must hold some numbers"),
    (
        "link",
        ("conditions", 0, "frames", 0, "rain_mm_per_h"),
        np.full((40, 3, 1), -1.0),
        r"rain_mm_per_h must be 0 mm/h",
    ),
    ("link", ("conditions", 0, "frames", 0, "rain_mm_per_h"), np.zeros((40, 3)), r"shape \(T, L, P\)"),
    ("link", ("conditions", 0, "frames", 0, "time_s"), np.zeros(40), r"time_s must rise from sample to sample"),
]


@pytest.mark.parametrize(("kind", "path", "value", "message"), BAD_ARRAYS, ids=lambda value: None)
def test_wrong_arrays_are_refused_with_name_unit_and_advice(
    kind: str, path: tuple[Any, ...], value: Any, message: str
) -> None:
    with pytest.raises(TorchweatherError, match=f"(?s){message}"):
        Study.from_arrays(**changed(kind, path, value))


BAD_VALUES = [
    (("conditions", 0, "weather"), ..., r"conditions\[0\].weather is missing: expected kind rain"),
    (
        ("conditions", 0, "weather"),
        {"kind": "hail"},
        r"conditions\[0\].weather.kind must be one of rain, snow, fog, clear",
    ),
    (("conditions", 0, "weather"), {"kind": "rain"}, r"weather.rate_mm_per_h is missing: rain needs it"),
    (("conditions", 0, "weather"), {"kind": "rain", "rate_mm_per_h": "1e-3"}, r"It is text: YAML wants 1.0e-3"),
    (("conditions", 0, "weather"), {"kind": "rain", "rate_mm_per_h": -1.0}, r"must lie in 0..inf; got -1"),
    (("conditions", 0, "weather"), {"kind": "rain", "rate_mm_per_h": 5.0, "rate_rel_std": 1}, r"'rate_rel_std'"),
    (("conditions", 0, "weather"), {"kind": "rain", "rate_mm_per_h": 5.0, "rate_rel_sd": -1}, r"rate_rel_sd must lie"),
    (("conditions", 0, "weather"), {"kind": "clear", "mor_m": 3}, r"unknown key 'conditions\[0\].weather.mor_m'"),
    (("conditions", 0, "weather"), Mixture(Rain(5.0), Fog(50.0)), r"weather.kind must be one of"),
    (("conditions", 0, "weather"), Rain(torch.tensor([1.0, 2.0])), r"rate_mm_per_h must be one number"),
    (("conditions", 0, "weather"), 5, r"must be a weather such as Rain\(25.0\)"),
    (("conditions", 0, "scene"), "s7", r"conditions\[0\].scene must be one of s0, s1; got 's7'"),
    (("conditions", 0, "frames"), [], r"conditions\[0\].frames must hold at least one frame"),
    (("conditions", 0, "frames"), "c0.npz", r"conditions\[0\].frames must be a list of frames"),
    (("conditions", 0, "frames"), [np.zeros(3)], r"frames\[0\]: expected arrays by name \(range_m, intensity\)"),
    (("conditions", 0, "time_s"), [0.0], r"time_s must have one value in seconds for each of the 2 frames; got 1"),
    (("conditions", 0, "time_s"), [0.0, math.nan], r"time_s\[1\] must lie in -inf..inf s; got nan"),
    (("conditions", 0, "time_s"), [0.2, 0.1], r"time_s must not fall from frame to frame, s; got 0.1 at 1 after 0.2"),
    (("conditions", 0, "rel_sd"), 10.0, r"conditions\[0\].rel_sd must lie in 0..1; got 10"),
    (("conditions", 0, "split"), "test", r"split must be fit or holdout; got 'test'"),
    (("conditions", 0, "ego_speed_m_per_s"), "fast", r"ego_speed_m_per_s must be a number in m/s; got 'fast'"),
    (("conditions", 0, "exposure_s"), 5000.0, r"exposure_s must lie in 0..10 s; got 5000"),
    (("conditions", 0, "airlight"), 0.5, r"airlight belongs to a camera; the study is of a lidar"),
    (("conditions", 0, "exposure_gain"), 0.5, r"exposure_gain belongs to a camera; the study is of a lidar"),
    (("conditions", 0, "id"), "c1", r"conditions\[1\].id must differ from the others"),
    (("conditions", 0, "id"), 7, r"conditions\[0\].id must be text"),
    (("conditions", 0, "framse"), [], r"unknown key 'conditions\[0\].framse'.*Did you mean 'frames'"),
    (("conditions",), [], r"conditions must hold at least one condition"),
    (("conditions",), {"c0": 1}, r"conditions\[0\] must be keys with values"),
    (("scenes",), [], r"scenes must hold at least one scene"),
    (("scenes", 0, "clear"), [], r"scenes\[0\].clear must hold at least one frame"),
    (("scenes", 0, "claer"), [], r"unknown key 'scenes\[0\].claer'.*Did you mean 'clear'"),
    (("sensor",), CAMERA, r"beams belongs to a study of kind lidar; this one is camera"),
    (("beams",), ..., r"beams is missing: a LiDAR study needs direction"),
    (("kind",), "lidr", r"kind must be one of lidar, camera, radar, link; got 'lidr'.*Did you mean 'lidar'"),
    (("kind",), "radar", r"sensor must be a Radar for kind radar; got Lidar"),
    (("kind",), "link", r"a study of links has no sensor"),
    (("links",), {"length_km": np.ones(2)}, r"links belongs to a study of kind link"),
]


@pytest.mark.parametrize(("path", "value", "message"), BAD_VALUES, ids=lambda value: None)
def test_wrong_values_are_refused_with_their_key(path: tuple[Any, ...], value: Any, message: str) -> None:
    with pytest.raises(TorchweatherError, match=f"(?s){message}"):
        Study.from_arrays(**changed("lidar", path, value))


def test_a_camera_of_odd_size_is_refused() -> None:
    values = arguments("camera", clear=2, frames=2)
    with pytest.raises(TorchweatherError, match=r"must be even, px; got 5 x 6.*camera.cropped"):
        Study.from_arrays(**{**values, "sensor": replace(CAMERA, height=5)})


def test_intensities_beyond_the_unit_of_the_sensor_are_refused() -> None:
    values = changed("lidar", (*LIDAR_FRAME, "intensity"), grid(300.0))
    Study.from_arrays(**values)  # reflectivity has no end
    with pytest.raises(TorchweatherError, match=r"intensity must be at most 255 .*got 300.0"):
        Study.from_arrays(**{**values, "sensor": replace(LIDAR, intensity_unit="uint8_linear")})


def test_links_have_no_scenes() -> None:
    built = study("link")
    with pytest.raises(ValueError, match="a study of links has none"):
        built.scene_of(built.conditions[0])
    with pytest.raises(TorchweatherError, match="links have no clear frames"):
        Study.from_arrays(**{**arguments("link"), "scenes": [{"id": "s0", "clear": []}]})


def test_a_not_detected_target_may_keep_any_range() -> None:
    frame = FRAMES["radar"](np.random.default_rng(0))
    frame["power_db"] = np.full(5, np.nan)
    frame["range_m"] = np.full(5, 30.0)
    built = Study.from_arrays(**changed("radar", ("conditions", 0, "frames"), [frame, frame]))
    assert np.isnan(built.conditions[0].frames[0]["power_db"]).all()


@settings(max_examples=50, deadline=None)
@given(st.dictionaries(st.text(max_size=12), st.none() | st.integers() | st.floats() | st.text(max_size=5), max_size=4))
def test_whatever_stands_for_a_condition_gives_a_study_or_one_clear_error(row: dict[str, Any]) -> None:
    values = arguments("lidar", clear=2, frames=1)
    values["conditions"] = [row]
    with pytest.raises(TorchweatherError, match=r"Study\.from_arrays"):
        Study.from_arrays(**values)


@pytest.mark.parametrize(
    ("given", "said"),
    [
        ([0.5, 0.5], r"conditions\[0\]\.airlight: .*one number or \(red, green, blue\) in 0\.\.1"),
        (1.5, r"airlight: .*in 0\.\.1"),
        ("sky", r"airlight must be a number or \(red, green, blue\).*as measured; got 'sky'"),
    ],
)
def test_a_measured_airlight_is_three_signals(given: Any, said: str) -> None:
    values = arguments("camera")
    values["conditions"][0]["airlight"] = given
    with pytest.raises(TorchweatherError, match=said):
        Study.from_arrays(**values)


@pytest.mark.parametrize(
    ("given", "said"),
    [
        (0.0, r"conditions\[0\]\.exposure_gain must be above 0.*got 0"),
        (-1.0, r"exposure_gain must lie in 0\.\.1000; got -1"),
        ("auto", r"exposure_gain must be a number; got 'auto'"),
    ],
)
def test_a_measured_exposure_gain_is_a_factor(given: Any, said: str) -> None:
    values = arguments("camera")
    values["conditions"][0]["exposure_gain"] = given
    with pytest.raises(TorchweatherError, match=said):
        Study.from_arrays(**values)
