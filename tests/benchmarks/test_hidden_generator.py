"""The generator of studies with a hidden effect against closed forms, and the protocol around it."""

import math
from dataclasses import replace

import numpy as np
import pytest
import torch

from benchmarks.gap_bench.generator.lidar.coarse_statistics import Tally
from benchmarks.gap_bench.generator.lidar.decoys import DECOYS
from benchmarks.gap_bench.generator.lidar.design import Size, draw_design, study_of, with_record
from benchmarks.gap_bench.generator.lidar.detectability import KINDS, Detector, brighter, cosine, independent, length
from benchmarks.gap_bench.generator.lidar.effects import CATALOGUE
from benchmarks.gap_bench.generator.lidar.lidar_sensor import shoot, study_sensor
from benchmarks.gap_bench.generator.lidar.lidar_shot import PARTICLE, TARGET, View, Weather
from benchmarks.gap_bench.generator.lidar.particles import air_of, draw_drops
from benchmarks.gap_bench.generator.lidar.rays import Target, cast, scan_pattern
from benchmarks.gap_bench.generator.lidar.scene import SENSOR_HEIGHT_M, Box, Scene, draw_scene
from benchmarks.gap_bench.generator.lidar.streets import Street
from benchmarks.gap_bench.scoring import score, wilson
from benchmarks.gap_bench.sealed import append_line, read_lines, sha256_of, write_json
from torchweather.gap.study.study import Study

TINY = Size(rings=16, columns=64, clear_frames=2, rates=2, frames=2)
FRAMES = 8


@pytest.fixture(autouse=True)
def _one_thread():
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    yield
    torch.set_num_threads(before)


def _view(range_m, reflectivity=0.5, near=(1.0, 3.0), rings=32, columns=128):
    """All beams meet a white-ish wall at one range, face on; ``inf`` is sky."""
    scan = scan_pattern(rings, columns)
    ones = np.ones(rings * columns)
    target = Target(range_m * ones, reflectivity * ones, ones, 0.0 * ones)
    return View(scan, target, study_sensor(scan, *near), Scene((), 0.2, 1))


# ---- scene -----------------------------------------------------------------------------------------------------------


def test_a_ray_meets_the_ground_where_geometry_says():
    scan = scan_pattern(16, 8)
    target = cast(Scene((), 0.2, 1), scan, 120.0)
    down = -scan.direction.reshape(-1, 3)[:, 2]
    hit = down > SENSOR_HEIGHT_M / 120.0
    assert np.allclose(target.range_m[hit], SENSOR_HEIGHT_M / down[hit])
    assert np.isinf(target.range_m[~hit]).all()
    assert np.allclose(target.cos_incidence[hit], down[hit])


def test_rays_meet_what_small_steps_along_them_meet():
    rng = np.random.default_rng(5)
    scene = draw_scene(rng)
    scan = scan_pattern(8, 24)
    target = cast(scene, scan, 120.0)
    beams = scan.direction.reshape(-1, 3)
    step = 0.01
    at = np.arange(step, 60.0, step)
    for beam in rng.choice(len(beams), 40, replace=False):
        point = at[:, None] * beams[beam]
        inside = point[:, 2] <= -SENSOR_HEIGHT_M
        for box in scene.boxes:
            x, y = point[:, 0] - box.x_m, point[:, 1] - box.y_m
            along = x * math.cos(box.yaw_rad) + y * math.sin(box.yaw_rad)
            aside = -x * math.sin(box.yaw_rad) + y * math.cos(box.yaw_rad)
            height = point[:, 2] + SENSOR_HEIGHT_M
            inside |= (np.abs(along) < box.length_m / 2) & (np.abs(aside) < box.width_m / 2) & (height < box.height_m)
        walked = at[inside.argmax()] if inside.any() else np.inf
        if target.range_m[beam] < 59.0 or walked < 59.0:
            # A step, or a corner thinner than one that the steps jump over.
            assert target.range_m[beam] <= walked + 1e-9
            assert walked - target.range_m[beam] < 0.3


def test_a_box_is_turned_about_the_vertical():
    box = Box("wall", 10.0, 0.0, 0.2, 20.0, 10.0, math.radians(30.0), 0.5)
    scan = scan_pattern(4, 4)
    level = replace(scan, direction=np.array([[[1.0, 0.0, 0.0]]]))
    target = cast(Scene((box,), 0.2, 1), level, 120.0)
    assert target.range_m[0] == pytest.approx(10.0 - 0.1 / math.cos(math.radians(30.0)))
    assert target.cos_incidence[0] == pytest.approx(math.cos(math.radians(30.0)))


# ---- link budget and weather -----------------------------------------------------------------------------------------


def test_half_of_the_beams_see_a_ten_percent_target_at_its_range():
    view = _view(40.0, reflectivity=0.1)
    report = shoot(view, Weather(), (), np.arange(64.0), np.random.default_rng(1))
    seen = report.range_m > 0
    assert seen.mean() == pytest.approx(0.5, abs=4 * 0.5 / math.sqrt(seen.size))


def test_clear_frames_differ_and_flicker_at_the_threshold():
    view = _view(39.5, reflectivity=0.1)
    report = shoot(view, Weather(), (), np.arange(4.0), np.random.default_rng(1))
    seen = report.range_m > 0
    assert (seen.any(0) & ~seen.all(0)).mean() > 0.3
    assert len({frame.tobytes() for frame in report.range_m}) == 4


def test_reported_intensity_is_the_reflectivity():
    report = shoot(_view(12.0, reflectivity=0.3), Weather(), (), np.arange(16.0), np.random.default_rng(2))
    # The scale of a frame scatters by 1.5 %, 16 frames.
    assert report.intensity.mean() == pytest.approx(0.3, rel=4 * 0.015 / 4)


@pytest.mark.parametrize(("kind", "amount"), [("rain", 60.0), ("snow", 2.0), ("fog", 150.0)])
def test_a_target_is_weakened_by_beer_and_lambert_there_and_back(kind, amount):
    near, far = 14.0, 26.0
    ratio = []
    for range_m in (near, far):
        view = _view(range_m, reflectivity=0.8, near=(8.0, 10.0))
        report = shoot(view, Weather(kind, amount), (), np.arange(16.0), np.random.default_rng(3))
        clear = shoot(view, Weather(), (), np.arange(16.0), np.random.default_rng(3))
        both = (report.kind == TARGET) & (clear.kind == TARGET)
        assert both.mean() > 0.5
        ratio.append(np.log(report.intensity[both]).mean() - np.log(clear.intensity[both]).mean())
    alpha = air_of(kind, amount, 865.0).extinction_per_m
    # Same draws in clear air, so the scales of the frames cancel; what is left is 2 % of reading noise over 30,000
    # returns, and targets that lose against a particle (snow), which are the weaker draws.
    assert ratio[0] - ratio[1] == pytest.approx(2.0 * alpha * (far - near), rel=0.01, abs=2e-3)


def test_extinctions_are_those_of_the_tables():
    # PHYSICS.md 3.2: full extinction at 25 mm/h 2.782e-3 /m, of which q_eff / 2 = 0.55 counts.
    assert air_of("rain", 25.0, 865.0).extinction_per_m == pytest.approx(0.55 * 2.782e-3, rel=5e-3)
    # 865 nm over 550 nm: 1.02 (gamma fog) to 1.07 (the measured fog of 50 m), PHYSICS.md 3.3 and 5.8.
    assert 1.02 < air_of("fog", 50.0, 865.0).extinction_per_m / (math.log(20.0) / 50.0) < 1.07


def test_the_number_of_drops_over_the_threshold_is_that_of_the_integral():
    """``int A_b(r) N(> D(r)) dr`` with Marshall-Palmer in closed form, against the list."""
    rate, beams, frames = 50.0, 4096, 40
    sensor = study_sensor(scan_pattern(32, 128), 1.0, 3.0)
    drops = draw_drops(
        air_of("rain", rate, 865.0),
        sensor,
        beams,
        np.ones(frames),
        sensor.threshold_per_m2_sr,
        1e-3 * sensor.divergence_mrad,
        np.random.default_rng(4),
    )
    r = np.arange(1.0 + 5e-5, 12.0, 1e-4)
    wide = 9.5e-3 + math.pi * 1e-3 * r
    xi = np.clip((r - 1.0) / 2.0, 0.0, 1.0)
    # D^2 Q_back / (4 pi D_b^2) xi / r^2 = 0.1 / (pi 40^2), Q_back 0.2 (PHYSICS.md 3.2, 5.3)
    smallest_mm = 1e3 * wide * np.sqrt(0.1 / math.pi / 40.0**2 * r**2 / np.maximum(xi, 1e-9) * 4.0 * math.pi / 0.2)
    slope = 4.1 * rate**-0.21
    low = np.clip(smallest_mm, 0.1, 8.0)
    tail = 8000.0 / slope * (np.exp(-slope * low) - math.exp(-slope * 8.0))
    tail = np.where(smallest_mm < 1e3 * wide, tail, 0.0)
    expected = float((0.25 * math.pi * wide**2 * tail).sum() * 1e-4) * beams * frames
    above = int((drops.signal >= sensor.threshold_per_m2_sr).sum())
    assert above > 2000
    assert above == pytest.approx(expected, abs=4.0 * math.sqrt(expected))


@pytest.mark.parametrize(("kind", "amount"), [("rain", 60.0), ("snow", 1.0)])
def test_a_pulse_adds_the_echoes_of_all_its_particles(kind, amount):
    """Against lists of nearly all of them, each with its echo; the weak ones of the short list are a mean."""
    beams, frames = 4096, 24
    sensor = study_sensor(scan_pattern(32, 128), 1.0, 3.0)
    seen = {}
    for share in (0.5, 0.02):
        for pulse_m in (0.0, sensor.pulse_length_m):
            threshold = sensor.threshold_per_m2_sr
            drops = draw_drops(
                air_of(kind, amount, 865.0), sensor, beams, np.ones(frames), share * threshold,
                1e-3 * sensor.divergence_mrad, np.random.default_rng(11), pulse_m,
            )  # fmt: skip
            bright = drops.signal >= threshold
            seen[share, bool(pulse_m)] = len(set(zip(drops.frame[bright], drops.beam[bright], strict=True)))
    few, all_of_them = seen[0.5, True], seen[0.02, True]
    assert all_of_them > 1.02 * seen[0.02, False]
    # Two draws of their numbers, and what the scatter of the weak echoes lifts over the threshold beside their mean.
    assert few == pytest.approx(all_of_them, rel=3.0 * math.sqrt(2.0 / few) + 0.02)


def test_the_share_of_beams_with_a_flake_is_that_of_a_poisson_number():
    view = _view(np.inf, near=(2.0, 10.0))
    report = shoot(view, Weather("snow", 1.0), (), np.arange(float(FRAMES)), np.random.default_rng(5))
    drops = draw_drops(
        air_of("snow", 1.0, 865.0), view.sensor, view.beams, np.ones(FRAMES), view.sensor.threshold_per_m2_sr,
        1e-3 * view.sensor.divergence_mrad, np.random.default_rng(6), view.sensor.pulse_length_m,
    )  # fmt: skip
    alpha = air_of("snow", 1.0, 865.0).extinction_per_m
    above = drops.signal * np.exp(-2.0 * alpha * drops.range_m) >= view.sensor.threshold_per_m2_sr
    mean = above.sum() / (FRAMES * view.beams)
    share = (report.kind == PARTICLE).mean()
    # Photon noise of 3 % at the threshold lifts a few more over it than it takes away.
    assert share == pytest.approx(1.0 - math.exp(-mean), rel=0.03)


def test_fog_shines_where_its_waveform_peaks():
    view = _view(np.inf, near=(2.0, 10.0))
    mor = 100.0
    report = shoot(view, Weather("fog", mor), (), np.arange(2.0), np.random.default_rng(7))
    quiet = replace(view, sensor=replace(view.sensor, photons_at_threshold=1e12))
    still = shoot(quiet, Weather("fog", mor), (), np.arange(2.0), np.random.default_rng(7))
    air = air_of("fog", mor, 865.0)
    fine = np.arange(2.0, 20.0, 0.01)
    local = air.backscatter_per_m_sr * (fine - 2.0) / 8.0 * (fine < 10.0) * np.exp(-2 * air.extinction_per_m * fine)
    local = local / fine**2
    best, peak = max(
        (float((local * np.sin(np.pi * np.clip((fine - r + 1.5) / 3.0, 0, 1)) ** 2).sum() * 0.01), r)
        for r in np.arange(3.0, 6.0, 0.02)
    )
    assert (report.kind == PARTICLE).mean() > 0.99
    signal = report.signal[report.kind == PARTICLE].mean()
    # The maximum of a noisy waveform lies above the maximum of its mean: by about one of its 3 %.
    assert signal == pytest.approx(best, rel=0.06)
    assert still.signal.mean() == pytest.approx(best, rel=4e-3)
    # Nodes are 0.25 m apart.
    assert np.median(still.range_m) == pytest.approx(peak, abs=0.13)


# ---- effects ---------------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def design():
    return draw_design(np.random.default_rng(8), "snow", replace(TINY, rings=32, columns=128), "common", 0.0)


@pytest.mark.parametrize("name", sorted(KINDS))
def test_a_strong_effect_changes_frames_and_the_same_seed_gives_the_same_ones(design, name):
    kind = KINDS[name]
    effect = kind.at(0.9, kind.fixed(np.random.default_rng(9)))
    view, weather = design.views[0], Weather("snow", 1.5)

    def frames(effects):
        return shoot(view, weather, effects, np.arange(3.0), np.random.default_rng(10))

    base, first, second = frames(()), frames((effect,)), frames((effect,))
    assert np.array_equal(first.range_m, second.range_m)
    assert np.array_equal(first.intensity, second.intensity)
    changed = (first.range_m != base.range_m) | (first.intensity != base.intensity)
    assert changed.mean() > 1e-3
    assert np.isfinite(first.range_m).all()
    assert (first.range_m >= 0).all()
    assert (first.intensity >= 0).all()


def test_a_third_of_the_effects_has_another_form():
    assert len(CATALOGUE) == 20
    assert sum(not kind.same_form for kind in CATALOGUE.values()) >= 7
    assert len(KINDS) - len(CATALOGUE) >= 12


def test_window_loss_of_three_decibels_halves_the_intensity():
    view = _view(12.0)
    effect = CATALOGUE["lidar.window_loss"]({"loss_db": 3.0103})
    base = shoot(view, Weather("rain", 80.0), (), np.arange(2.0), np.random.default_rng(11))
    wet = shoot(view, Weather("rain", 80.0), (effect,), np.arange(2.0), np.random.default_rng(11))
    ratio = np.log(wet.intensity.mean() / base.intensity.mean())
    # A film of 63 % at 4 mm/h is full at 80 mm/h.
    assert ratio == pytest.approx(-math.log(2.0), abs=0.01)


def test_detectability_grows_with_strength_and_a_rate_is_no_signature(design):
    detector = Detector(design, 12)
    loss = CATALOGUE["lidar.window_loss"]
    weak, strong = (detector.signature((loss({"loss_db": value}),)) for value in (0.3, 3.0))
    assert length(strong) > 3.0 * length(weak) > 0.0
    assert length(detector.signature(())) == 0.0
    assert cosine(strong, strong) == pytest.approx(1.0)
    noise = CATALOGUE["lidar.range_noise"]({"std_m": 0.1})
    assert abs(cosine(strong, detector.signature((noise,)))) < 0.5


def test_conditions_of_a_scene_share_the_noise_of_its_clear_frames():
    """Drawn as it is measured: frames of each condition against the mean of the clear frames of its scene."""
    rng, scenes, number = np.random.default_rng(21), [0, 0, 1, 0], 40_000
    own = rng.normal(size=(number, 4, 2))
    clear = rng.normal(size=(number, 2, 2)) * np.sqrt([0.75, 0.0])  # 6 frames against 8; of particles there is none
    found = independent(own - clear[:, scenes], scenes, np.array([0.75, 0.0])).reshape(number, -1)
    # 5 x sqrt(2 / 40,000) = 3.5 %.
    np.testing.assert_allclose(found.T @ found / number, np.eye(8), atol=0.036)
    # A change that is the same everywhere is worth less than it would be with clear frames for each condition.
    steady = np.ones((1, 4, 1))
    assert length_of(independent(steady, scenes, np.array([0.75]))) == pytest.approx(3 / 3.25 + 1 / 1.75)
    assert length_of(independent(steady, [0, 1, 2, 3], np.array([0.75]))) == pytest.approx(4 / 1.75)


def length_of(rows):
    return float((rows**2).sum())


def test_a_scale_that_the_clear_frames_leave_open_is_no_signature(design):
    """Eight frames know it to half a percent: of 10 % most is no noise, but no rate's error either."""
    view = brighter(design.views[0], 1.1)
    np.testing.assert_allclose(view.target.reflectivity, 1.1 * design.views[0].target.reflectivity)
    assert brighter(view, 1.0) is view
    detector = Detector(design, 12)
    base = detector._totals((), 0)
    moved = detector._apart(detector._totals((), 0, scales=(1.1,) * len(design.views)) - base).ravel()
    left, whole = np.linalg.norm(moved @ detector._free), np.linalg.norm(moved)
    # Of two scenes alike, each along one direction of s standard deviations, 1 / sqrt(1 + s^2) is left; what lies
    # in the noise of the direction's estimate stays.
    one_sd = whole / np.sqrt(2.0) * 0.015 / np.sqrt(design.size.clear_frames) / 0.1
    assert one_sd > 1.5
    assert 0.9 * whole / np.hypot(1.0, one_sd) < left < 0.75 * whole
    rates_alone = Detector.__new__(Detector)
    rates_alone.__dict__.update(detector.__dict__)
    rates_alone.scale_spread = 1e-9
    assert np.linalg.norm(moved @ rates_alone._projection()) > 0.85 * whole


def test_tally_counts_lost_beams(design):
    view = design.views[0]
    report = shoot(view, Weather(), (), np.arange(2.0), np.random.default_rng(13))
    before, floor = Tally(view)(report)
    dropped = np.isfinite(view.target.range_m) & (np.arange(view.beams) % 2 == 0)
    expected = (dropped & (report.range_m > 0)).mean()
    report.drop(dropped)
    after, _ = Tally(view)(report)
    lost = (np.sin(after[:, -3]) ** 2 - np.sin(before[:, -3]) ** 2).mean()
    assert expected > 0.2
    assert lost == pytest.approx(expected, rel=1e-9)
    assert floor.shape == before.shape[1:]


# ---- studies, seal, score --------------------------------------------------------------------------------------------


def test_a_study_is_written_and_read(tmp_path):
    rng = np.random.default_rng(14)
    design = draw_design(rng, "rain", TINY, record_sd=2.0)
    study = study_of(design, (), rng)
    study.write(tmp_path / "study")
    again = Study.read(tmp_path / "study")
    assert again.sha256 == study.sha256
    assert {one.split for one in again.conditions} == {"fit", "holdout"}
    assert all(one.rel_sd == 0.1 for one in again.conditions)
    off = [one.weather.amount / one.recorded for one in design.conditions]
    assert off[0] == pytest.approx(1.2, abs=1e-4) or off[0] == pytest.approx(0.8, abs=1e-4)
    each = with_record(design, rng, "each")
    assert len({round(one.weather.amount / one.recorded, 4) for one in each.conditions}) == len(each.conditions)


@pytest.mark.parametrize("name", sorted(DECOYS))
def test_decoys_are_studies(name):
    rng = np.random.default_rng(15)
    design = draw_design(rng, "rain", TINY, "common", 0.0)
    decoy = DECOYS[name](design, lambda effect, level: dict(CATALOGUE[effect].at(0.8, {}).parameters), rng)
    study = study_of(
        design, decoy.effects, rng, clear_effects=decoy.clear_effects, acts=decoy.acts, views=decoy.views,
        repeated=decoy.repeated,
    )  # fmt: skip
    first, second = study.conditions[0].frames[:2]
    assert np.array_equal(first["range_m"], second["range_m"]) is decoy.repeated
    assert decoy.verdicts


def test_wilson_interval_of_45_in_48():
    assert wilson(45, 48) == pytest.approx([0.8316, 0.9785], abs=1e-4)
    assert wilson(0, 0) is None


@pytest.mark.parametrize(("range_m", "mor_m"), [(25.0, 400.0), (math.inf, 60.0)], ids=["a wall", "fog alone"])
def test_in_fog_an_extinction_is_a_denser_record_with_fainter_particles(range_m, mor_m):
    """The same frames, beam by beam: no search can distinguish them where the record may be off."""
    view, factor = _view(range_m), 1.2
    stronger = CATALOGUE["lidar.extinction_scale"]({"factor": factor})
    fainter = CATALOGUE["lidar.particle_backscatter"]({"gain_db": -10.0 * math.log10(factor)})
    one, other, as_it_is = (
        shoot(view, Weather("fog", mor_m / density), effects, np.zeros(4), np.random.default_rng(3))
        for density, effects in ((1.0, (stronger,)), (factor, (fainter,)), (1.0, ()))
    )
    seen = (one.range_m > 0.0) & (other.range_m > 0.0) & (as_it_is.range_m > 0.0)
    assert seen.mean() > 0.2
    assert (one.kind == other.kind).mean() > 0.999
    # Fog is looked at in steps of depth, which are not those of the other density.
    apart, changed = (np.abs(np.log(each.signal / one.signal))[seen] for each in (other, as_it_is))
    assert np.median(apart) < 0.05 * np.median(changed)


def test_what_gives_the_same_frames_in_fog_is_sealed_as_alike():
    names = ("lidar.extinction_scale", "lidar.particle_backscatter")
    tables = {"asked for": {"lidar.window_loss": 0.97, names[1]: 0.4}, "not": None}
    for kind, alike in (("fog", {names[1]: 1.0}), ("snow", {})):
        design = draw_design(np.random.default_rng(2), kind, TINY, record="common", record_sd=0.0)
        asked, not_asked = (
            Street(design, {names[0]: {"10": {"cosine": cosines}}}).confusable(names[0], 10.0)
            for cosines in tables.values()
        )
        assert asked == {"lidar.window_loss": 0.97} | alike
        assert not_asked == (alike or None)


def _truth(name, level=30.0, confusable=None, options=None, family="single"):
    effects = []
    if name:
        effects = [
            {
                "name": name, "parameters": {"loss_db": 1.0}, "same_form": True, "level": level,
                "confusable_with": confusable or {}, "identifiable": not confusable, "axes": ("azimuth",),
            }
        ]  # fmt: skip
    return {"id": "c", "family": family, "weather": "rain", "effects": effects, "options": options or {}}


def _answer(verdict, names=(), interval=(0.5, 1.5), axis="azimuth_rad"):
    effects = [
        {"name": name, "parameters": {"loss_db": 1.0}, "interval": {"loss_db": list(interval)}, "confidence": 0.9}
        for name in names
    ]
    report = {
        "verdict": verdict,
        "effects": effects,
        "where": [{"axis": axis}],
        "gap": {"before": 5.0, "after": 1.1, "floor": 1.0},
    }
    return {"case": "c", "report": report, "seconds": 1.0}


def test_score_tells_right_wrong_and_unknown():
    truth = {"c": _truth("lidar.window_loss", confusable={"lidar.threshold_shift": 0.97})}
    exact = score(truth, [_answer("named", ["lidar.window_loss"])])["cases"][0]
    assert exact["exact"]
    assert exact["intervals"][0]["covers"]
    assert exact["gap_after_over_floor"] == pytest.approx(1.1)
    near = score(truth, [_answer("named", ["lidar.threshold_shift"])])["cases"][0]
    assert (near["exact"], near["in_confusion_set"], near["wrong"]) == (False, True, False)
    wrong = score(truth, [_answer("named", ["lidar.spray"])])["cases"][0]
    assert (wrong["in_confusion_set"], wrong["wrong"]) == (False, True)
    missed = score(truth, [_answer("named", ["lidar.window_loss"], interval=(2.0, 3.0))])["cases"][0]
    assert not missed["intervals"][0]["covers"]
    outside = {"c": _truth("outside.azimuth_ripple", family="outside")}
    assert score(outside, [_answer("unknown")])["cases"][0]["right_axis"]
    assert not score(outside, [_answer("unknown", axis="range_m")])["cases"][0]["right_axis"]
    null = {"c": _truth(None, family="null")}
    assert score(null, [_answer("named", ["lidar.spray"])])["table"]["nulls_alarm"]["hits"] == 1
    assert score(null, [_answer("none")])["table"]["nulls_alarm"]["hits"] == 0


def test_a_line_that_was_cut_off_is_answered_again_and_a_changed_truth_shows(tmp_path):
    lines = tmp_path / "answers.jsonl"
    append_line(lines, {"case": "a", "value": math.inf})
    with lines.open("a") as file:
        file.write('{"case": "b", "va')
    assert [one["case"] for one in read_lines(lines)] == ["a"]
    sealed = tmp_path / "truth.json"
    write_json(sealed, {"a": 1})
    before = sha256_of(sealed)
    write_json(sealed, {"a": 2})
    assert sha256_of(sealed) != before
