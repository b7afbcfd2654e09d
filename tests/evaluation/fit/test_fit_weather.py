"""Fit of the weather: known answers of frames that share no code with the library's transforms, and coverage."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

import torchweather as tw
from torchweather.atmosphere.weather import Fog, Rain
from torchweather.camera.sensor import Camera
from torchweather.evaluation.fit import WeatherFit, fit_weather
from torchweather.evaluation.fit.camera_light import camera_loss_per_m
from torchweather.evaluation.fit.laws import PathLaw
from torchweather.evaluation.fit.least_squares import trimmed_mean
from torchweather.evaluation.fit.path_line import lidar_loss_per_m, radar_loss_db_per_km
from torchweather.evaluation.fit.result import Value
from torchweather.gap.study.study import Study
from torchweather.lidar.sensor import Lidar
from torchweather.radar.sensor import Radar

LIDAR = Lidar(905.0, elevations_deg=tuple(np.linspace(-6.0, 2.0, 12)), columns=60, intensity_unit="reflectivity")
CAMERA = Camera.from_intrinsics(4000.0, 4000.0, 39.5, 29.5, 80, 60)  # narrow: every ray is as long as its depth
FRAMES, CLEAR = 8, 8
AIRLIGHT = (0.42, 0.45, 0.50)


def lidar_study(seed: int, *, record: Fog | Rain, true: float, offset: float = 0.0, wild: bool = False) -> Study:
    """Objects at 5 to 60 m whose levels scatter by 5 % alone and 2 % all together in each frame."""
    rng = np.random.default_rng(seed)
    range_m = rng.uniform(5.0, 60.0, (12, 60))
    level = rng.uniform(0.1, 0.6, (12, 60))

    def frame(loss: float, shift: float) -> dict[str, Any]:
        noise = 0.05 * rng.standard_normal(level.shape) + 0.02 * rng.standard_normal()
        return {
            "range_m": range_m + 0.02 * rng.standard_normal(range_m.shape),
            "intensity": level * np.exp(-2 * loss * range_m + shift + noise),
        }

    kind = type(record)
    loss = lidar_loss_per_m(kind(true), LIDAR)
    frames = [frame(loss, offset) for _ in range(FRAMES)]
    if wild:  # something bright fills half of one frame
        frames[2]["intensity"][:, :30] *= 5.0
    return Study.from_arrays(
        sensor=LIDAR,
        scenes=[{"id": "s0", "clear": [frame(0.0, 0.0) for _ in range(CLEAR)]}],
        conditions=[{"id": "c0", "scene": "s0", "weather": record, "frames": frames}],
    )


def radar_study(seed: int, *, true: float) -> Study:
    """Corner reflectors at 20 to 250 m whose power scatters by 0.3 dB."""
    rng = np.random.default_rng(seed)
    radar = Radar()
    range_m = np.linspace(20.0, 250.0, 12)
    geometry = {name: np.zeros(12) for name in ("azimuth_rad", "elevation_rad", "speed_m_per_s", "target_class")}
    loss = radar_loss_db_per_km(Rain(true), radar)

    def frame(per_km: float) -> dict[str, Any]:
        return {
            "power_db": 40.0 - 2 * per_km * range_m / 1000 + 0.3 * rng.standard_normal(12),
            "range_m": range_m,
            "speed_m_per_s": np.zeros(12),
            "noise_floor_db": np.array(0.0),
        }

    geometry["range_m"] = range_m
    frames = [frame(loss) for _ in range(FRAMES)]
    return Study.from_arrays(
        sensor=radar,
        scenes=[{"id": "s0", "clear": [frame(0.0) for _ in range(CLEAR)], "geometry": geometry}],
        conditions=[{"id": "c0", "scene": "s0", "weather": "rain:rate=10", "frames": frames}],
    )


def camera_study(
    seed: int, *, true_m: float, gain: float = 1.0, airlight: bool = False, vehicle: bool = False, weak: bool = False
) -> Study:
    """Squares at 5 to 120 m in airlight of another colour than they have; noise of 1 % of saturation (weak: 3 %)."""
    rng = np.random.default_rng(seed)
    depth_m = np.repeat(np.geomspace(5.0, 120.0, 60)[:, None], 80, axis=1)
    texture = np.kron(rng.uniform(*((0.15, 0.25) if weak else (0.03, 0.35)), (15, 20)), np.ones((4, 4)))
    noise = 0.03 if weak else 0.01
    # RGGB: the colour of each pixel by hand.
    colour = np.array([[0, 1], [1, 2]])[np.arange(60)[:, None] % 2, np.arange(80)[None] % 2]
    per_m = camera_extinction(true_m)[colour]
    light = np.array(AIRLIGHT)[colour]

    def frame(passed: Any, factor: float) -> dict[str, Any]:
        seen = factor * (texture * passed + light * (1 - passed)) + noise * rng.standard_normal(texture.shape)
        return {"bayer": np.clip(seen, 0.0, 1.0)}

    frames = [frame(np.exp(-per_m * depth_m), gain) for _ in range(FRAMES)]
    if vehicle:
        frames[1]["bayer"][20:50, 20:60] = 0.02
    condition = {"id": "c0", "scene": "s0", "weather": "fog:mor=150", "frames": frames}
    if airlight:
        condition["airlight"] = [gain * level for level in AIRLIGHT]  # as these frames show it
    return Study.from_arrays(
        sensor=CAMERA,
        scenes=[{"id": "s0", "clear": [frame(1.0, 1.0) for _ in range(CLEAR)], "geometry": {"depth_m": depth_m}}],
        conditions=[condition],
    )


def camera_extinction(mor_m: float) -> Any:
    """By colour, from Mie over the fog's droplets (tested against oracles elsewhere)."""
    from torchweather.physics import extinction_per_m

    blue, green, red = CAMERA.wavelengths_nm
    drops = Fog(mor_m=mor_m).distribution(mor_m)
    return np.array([float(extinction_per_m(drops, w, temperature_c=10.0)) for w in (red, green, blue)])


def by_name(found: WeatherFit) -> dict[str, Any]:
    return {each.name: each for each in found.conditions[0].estimates}


def test_a_lidars_visibility_from_a_wrong_record() -> None:
    found = by_name(fit_weather(lidar_study(1, record=Fog(400.0), true=120.0), bootstrap=100))
    for each in found.values():
        # 8 frames, each off by 2 % alike: slopes over 55 m have an error of about 2e-4 1/m of 0.025.
        assert each.intensity.value == pytest.approx(120.0, rel=0.04)
        assert each.misfit < 2.0
        assert each.intensity.low < each.intensity.value < each.intensity.high


def integer_study(seed: int, *, rate: float, twice: bool) -> Study:
    """Levels of 10 to 40 steps nearby and up to 100 farther off, rounded down: after the loss, or before it as well.

    A level that was rounded stands for the middle of its step, as the library has it (PHYSICS.md 5.3).
    """
    rng = np.random.default_rng(seed)
    lidar = Lidar(905.0, elevations_deg=tuple(np.linspace(-6.0, 2.0, 32)), columns=200, intensity_unit="uint8_linear")
    shape = (32, 200)
    near = rng.random(shape) < 0.7  # most beams end on the ground nearby, as those of a car do
    range_m = np.where(near, rng.uniform(4.0, 12.0, shape), rng.uniform(12.0, 60.0, shape))
    level = np.where(near, rng.uniform(10.0, 40.0, shape), rng.uniform(40.0, 100.0, shape))
    passed = np.exp(-2 * lidar_loss_per_m(Rain(rate), lidar) * range_m)

    def frame(share: Any) -> dict[str, Any]:
        before = np.floor(level) + 0.5 if twice else level
        return {"range_m": range_m + 0.02 * rng.standard_normal(shape), "intensity": np.floor(before * share)}

    return Study.from_arrays(
        sensor=lidar,
        scenes=[{"id": "s0", "clear": [frame(1.0) for _ in range(CLEAR)]}],
        conditions=[
            {"id": "c0", "scene": "s0", "weather": Rain(rate), "frames": [frame(passed) for _ in range(FRAMES)]}
        ],
    )


def test_integers_that_are_rounded_once_give_the_rate() -> None:
    for each in by_name(fit_weather(integer_study(1, rate=20.0, twice=False), bootstrap=50)).values():
        # Rounding scatters a level of 25 steps by 0.29, over 4,500 near beams and 1,900 others by less: 1 % of the
        # rate. Levels taken for whole steps would lose 0.5 of 25 too little: 2 % more.
        assert each.intensity.value == pytest.approx(20.0, rel=0.012)


def test_rounding_twice_hides_the_loss_of_near_objects() -> None:
    """The cause of the slope that read 1.25 to 1.46 of the record: less than half a step is lost, and seen as none."""
    found = by_name(fit_weather(integer_study(1, rate=5.0, twice=True), bootstrap=50))
    assert found["slope"].intensity.value > 1.25 * 5.0
    assert found["slope"].others["offset_log"].value > 0.0


def test_the_embedded_study_rounds_once() -> None:
    from torchweather.gap.study.embedded import embedded_study

    study = embedded_study("lidar", clear_frames=2, frames=1)
    condition = next(one for one in study.conditions if one.id == "rain-10")
    loss = lidar_loss_per_m(Rain(10.0), study.sensor_as(Lidar))
    clear, seen = study.scene_of(condition).clear[0], condition.frames[0]
    range_m, before = (np.asarray(clear[name], dtype=np.float64) for name in ("range_m", "intensity"))
    same = (np.abs(range_m - seen["range_m"]) < 0.3) & (before >= 10) & (before < 100)
    near = same & (range_m > 4.0) & (range_m < 8.0)  # loses a third of a step
    ratio = (seen["intensity"][near] + 0.5).sum() / (before[near] + 0.5).sum()
    wanted = ((before + 0.5) * np.exp(-2 * loss * range_m))[near].sum() / (before[near] + 0.5).sum()
    # A loss of a third of a step takes a step from a third of the beams: the error of their mean, three times.
    error = 0.5 / np.sqrt(near.sum()) / (before[near] + 0.5).mean()
    assert 1.0 - ratio == pytest.approx(1.0 - wanted, abs=3.0 * error)
    assert 3.0 * error < 0.5 * (1.0 - wanted)


def test_an_offset_is_the_slopes_and_a_misfit_of_the_other() -> None:
    found = by_name(fit_weather(lidar_study(2, record=Fog(100.0), true=100.0, offset=-0.7), bootstrap=100))
    assert found["slope"].intensity.value == pytest.approx(100.0, rel=0.05)
    assert found["slope"].others["offset_log"].value == pytest.approx(-0.7, abs=0.05)
    assert found["slope"].fits
    assert not found["no_offset"].fits
    assert found["no_offset"].intensity.value < 90.0


def test_one_wild_frame_of_eight_does_not_count() -> None:
    calm, wild = (
        by_name(fit_weather(lidar_study(3, record=Fog(100.0), true=100.0, wild=w), bootstrap=100))["slope"]
        for w in (False, True)
    )
    assert wild.intensity.value == pytest.approx(calm.intensity.value, rel=0.03)


def test_a_rain_rate_from_corner_reflectors() -> None:
    found = by_name(fit_weather(radar_study(4, true=40.0), bootstrap=100))
    loss = radar_loss_db_per_km(Rain(40.0), Radar())
    assert found["no_offset"].loss.value == pytest.approx(loss, rel=0.06)
    assert found["no_offset"].intensity.value == pytest.approx(40.0, rel=0.08)


@pytest.mark.parametrize("gain", [1.0, 0.6])
def test_a_cameras_visibility_airlight_and_gain(gain: float) -> None:
    found = by_name(fit_weather(camera_study(5, true_m=80.0, gain=gain, airlight=True), bootstrap=100))
    assert set(found) == {"contrast", "all_light", "measured_airlight"}
    for name, within in (("contrast", 0.05), ("all_light", 0.03), ("measured_airlight", 0.02)):
        each = found[name]
        assert each.intensity.value == pytest.approx(80.0, rel=within), name
        assert each.others["exposure_gain"].value == pytest.approx(gain, rel=0.04)
    colours = [found["all_light"].others[f"airlight_{c}"].value for c in ("red", "green", "blue")]
    assert colours == pytest.approx(AIRLIGHT, rel=0.04)


def test_a_stated_gain_is_not_fitted_and_a_wrong_one_shows() -> None:
    study = camera_study(5, true_m=80.0, gain=0.6, airlight=True)

    def fitted(gain: float) -> dict[str, Any]:
        stated = tuple(replace(each, exposure_gain=gain) for each in study.conditions)
        return by_name(fit_weather(replace(study, conditions=stated), bootstrap=50))

    for each in fitted(0.6).values():
        assert each.intensity.value == pytest.approx(80.0, rel=0.03)
        assert "exposure_gain" not in each.others
    assert fitted(0.6)["all_light"].others["airlight_green"].value > 0
    # Twice the light says that the way took twice as much of it.
    assert fitted(1.2)["contrast"].intensity.value < 60.0


def test_noise_is_no_contrast() -> None:
    found = by_name(fit_weather(camera_study(9, true_m=300.0, weak=True), bootstrap=50))["contrast"]
    # Noise of clear frames as large as their contrast would make the gain a half.
    assert found.others["exposure_gain"].value == pytest.approx(1.0, abs=0.12)


def test_a_vehicle_that_passes_does_not_count() -> None:
    found = by_name(fit_weather(camera_study(6, true_m=80.0, vehicle=True), bootstrap=100))
    assert found["all_light"].intensity.value == pytest.approx(80.0, rel=0.05)


def test_a_mask_leaves_pixels_out() -> None:
    study = camera_study(7, true_m=80.0)
    scene = study.scenes["s0"]
    mask = np.zeros((60, 80), dtype=bool)
    mask[:, :30] = True
    frames = [{"bayer": np.where(mask, 0.9, f["bayer"])} for f in study.conditions[0].frames]  # a pillar in the way
    blocked = Study.from_arrays(
        sensor=CAMERA,
        scenes=[{"id": "s0", "clear": list(scene.clear), "geometry": scene.geometry}],
        conditions=[{"id": "c0", "scene": "s0", "weather": "fog:mor=150", "frames": frames}],
    )
    masked = by_name(fit_weather(blocked, mask=mask, bootstrap=50))["all_light"]
    assert masked.intensity.value == pytest.approx(80.0, rel=0.05)
    stated = Study.from_arrays(
        sensor=CAMERA,
        scenes=[
            {"id": "s0", "clear": list(scene.clear), "geometry": {**scene.geometry, "mask": mask.astype(np.uint8)}}
        ],
        conditions=[{"id": "c0", "scene": "s0", "weather": "fog:mor=150", "frames": frames}],
    )
    assert by_name(fit_weather(stated, bootstrap=50))["all_light"] == masked
    assert not by_name(fit_weather(blocked, bootstrap=50))["all_light"].fits
    with pytest.raises(ValueError, match=r"mask of scene s0: expected shape \(60, 80\)"):
        fit_weather(blocked, mask=mask[:2])


KNOWN = {
    "lidar": lambda seed: (lidar_study(seed, record=Fog(150.0), true=150.0), 150.0),
    "radar": lambda seed: (radar_study(seed, true=25.0), 25.0),
    "camera": lambda seed: (camera_study(seed, true_m=100.0, airlight=True), 100.0),
}


@pytest.mark.parametrize(
    ("kind", "studies"),
    [
        *((kind, 12) for kind in ("lidar", "radar")),
        ("camera", 3),
        *(pytest.param(kind, 200, marks=pytest.mark.long) for kind in KNOWN),
    ],
)
def test_intervals_of_90_percent_cover(kind: str, studies: int) -> None:
    held: dict[str, list[bool]] = {}
    drawn = 100 if studies >= 100 else 50
    for seed in range(studies):
        study, truth = KNOWN[kind](1000 + seed)
        for name, each in by_name(fit_weather(study, bootstrap=drawn)).items():
            held.setdefault(name, []).append(each.intensity.low <= truth <= each.intensity.high)
    for name, inside in held.items():
        # 85 %, less two binomial errors of so few studies.
        least = 0.85 - (2 * math.sqrt(0.85 * 0.15 / studies) if studies < 100 else 0.0)
        assert np.mean(inside) >= least, f"{name}: {np.mean(inside)}"


def test_the_law_is_inverted() -> None:
    law = PathLaw.of(Fog(mor_m=200.0), lambda each: camera_loss_per_m(each, CAMERA))
    for mor_m in (60.0, 200.0, 700.0):
        loss = camera_loss_per_m(Fog(mor_m=mor_m), CAMERA)
        assert law.inverse(Value(loss, loss, loss)).value == pytest.approx(mor_m, rel=2e-3)
    none = law.inverse(Value(0.0, -1.0, 0.03))
    assert none.value == none.high == math.inf
    assert none.low == pytest.approx(100.0, rel=0.05)
    assert PathLaw.of(Rain(5.0), lambda each: radar_loss_db_per_km(each, Radar())).inverse(none).value == math.inf


def test_means_are_trimmed() -> None:
    values = np.array([[1.0, 1.0], [2.0, math.nan], [3.0, 3.0], [4.0, math.nan], [90.0, 5.0]])
    assert trimmed_mean(values).tolist() == [3.0, 3.0]


def test_what_cannot_be_fitted_is_named() -> None:
    found = fit_weather(camera_study(8, true_m=80.0), estimators=["sky_airlight", "contrast"], bootstrap=50)
    assert found.conditions[0].left_out == {"sky_airlight": "no sky (depth inf) in these frames"}
    assert "left out: no sky" in found.text()
    json.dumps(found.to_dict(), allow_nan=False)
    with pytest.raises(ValueError, match="estimator must be one of slope, no_offset"):
        fit_weather(radar_study(1, true=5.0), estimators=["slop"])
    assert tw.fit_weather is fit_weather
