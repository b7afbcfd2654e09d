"""LiDAR frames: what became of each beam against plain loops, clear frames left out, what the chain keeps."""

from __future__ import annotations

import math
from dataclasses import fields
from typing import Any

import numpy as np
import pytest
import torch

from tests.gap.tiny_study import EMPTY, INTENSITY_NOISE, RANGE_NOISE_M, SENSOR, tiny_study
from torchweather.atmosphere.weather import Fog, Rain, Snow
from torchweather.core.compiled import SWITCH
from torchweather.gap.inference.simulated_distribution import observations
from torchweather.gap.sensors.lidar.frames import LidarFrames
from torchweather.gap.sensors.lidar.scene import CLUSTER_M
from torchweather.gap.sensors.lidar.stable_beams import SAME_SURFACE_M
from torchweather.gap.sensors.lidar.systematics import WeakSignalNoise
from torchweather.gap.statistics.frame_statistics import Pool, Reduced
from torchweather.gap.study.study import Study
from torchweather.lidar.effects.all import EFFECTS
from torchweather.transforms import LidarWeather

ROWS, COLUMNS, CLEAR, FRAMES = 16, 16, 4, 3
WEATHERS = (Snow(2.0), Fog(60.0), Rain(40.0))
SEEDS = (11, 2**40 + 5, 17)
WINDOW, DRIFT = EFFECTS["lidar.window_loss"], EFFECTS["lidar.range_bias"]


@pytest.fixture(scope="module")
def study() -> Study:
    return tiny_study(seed=3, rows=ROWS, columns=COLUMNS, clear=CLEAR, frames=FRAMES, weathers=WEATHERS)


@pytest.fixture(scope="module")
def model(study: Study) -> LidarFrames:
    return LidarFrames(study)


def assert_same(found: Reduced, expected: Reduced, tolerance: float = 0.0) -> None:
    for field in fields(Reduced):
        np.testing.assert_allclose(
            getattr(found, field.name), getattr(expected, field.name), rtol=tolerance, atol=tolerance
        )


def stacked(frames: Any, name: str) -> Any:
    return np.stack([frame[name] for frame in frames]).reshape(len(frames), -1)


def group(model: LidarFrames, frames: Reduced, statistic: str, axis: str, what: str = "value") -> Any:
    """Sums ``(F, bins)`` of one group."""
    for one, part in zip(model.layout.binned, model.layout.slices, strict=False):
        if (one.statistic, one.axis) == (statistic, axis):
            return getattr(frames, what)[:, part]
    raise AssertionError(f"no {statistic} along {axis}")


def test_compiled_sums_are_those_of_torch(model: LidarFrames, study: Study, monkeypatch: pytest.MonkeyPatch) -> None:
    for condition in study.conditions:
        found = []
        for flag in ("1", "0"):
            monkeypatch.setenv(SWITCH, flag)
            found.append(model.measured(condition))
        # Sums of hundreds of values in single precision, and logarithms by polynomials.
        assert_same(*found, tolerance=2e-5)
        assert not np.array_equal(found[0].value, found[1].value)  # two paths indeed


def test_repeated_losses_are_those_of_a_plain_loop(model: LidarFrames, study: Study) -> None:
    rng, scene = np.random.default_rng(6), model.scenes["s0"]
    range_m = stacked(study.conditions[0].frames, "range_m")
    range_m[:, rng.random(range_m.shape[1]) < 0.1] = 0.0  # in every frame
    range_m[rng.random(range_m.shape) < 0.1] = 0.0  # in some
    found, partly = model._sums["s0"].repeated(torch.from_numpy(range_m), torch.arange(FRAMES) % CLEAR), 0
    for one, part in zip(model.layout.groups, model.layout.slices, strict=True):
        if not one.statistic.startswith("lost_share") or one.kind != "share":
            np.testing.assert_array_equal(found[part], 1.0)
            continue
        for place, value in enumerate(found[part]):
            times: dict[int, int] = {}
            for frame, values in enumerate(range_m):
                row = frame % CLEAR
                for beam in np.flatnonzero(scene.stable.numpy() & (values == 0)):
                    if scene.bins[one.axis][row, beam] == place:
                        times[beam] = times.get(beam, 0) + 1
            losses = [own for own in times.values() for _ in range(own)]
            expected = sum(losses) / len(losses) if losses else 1.0
            assert value == pytest.approx(expected), (one.statistic, one.axis, place)
            partly += 1.0 < expected < FRAMES
    assert partly > 20
    np.testing.assert_array_equal(model.repeated(study.conditions[0]), 1.0)  # next to nothing is lost in this snow


# ---- what a frame is compared with -----------------------------------------------------------------------------------


def test_references_leave_one_clear_frame_out(study: Study, model: LidarFrames) -> None:
    scene = model.scenes["s0"]
    range_m, intensity = (stacked(study.scenes["s0"].clear, name) for name in ("range_m", "intensity"))
    sky = np.arange(ROWS * COLUMNS) >= (ROWS - round(EMPTY * ROWS)) * COLUMNS
    np.testing.assert_array_equal(scene.empty[-1].numpy(), (range_m == 0).all(0) & sky)
    for row in range(CLEAR):
        np.testing.assert_array_equal(scene.empty[row].numpy(), (np.delete(range_m, row, 0) == 0).all(0) & sky)
    assert not (scene.stable.numpy() & ~(range_m > 0).all(0)).any()
    for row in range(CLEAR + 1):
        others = [k for k in range(CLEAR) if k != row]
        seen = (range_m > 0).all(0)
        for reference, values in (
            (scene.reference_range_m, range_m),
            (scene.reference_intensity, intensity),
        ):
            np.testing.assert_allclose(reference[row].numpy()[seen], values[others].mean(0)[seen], rtol=1e-6)


def test_a_beam_that_sees_two_surfaces_or_flickers_is_neither_stable_nor_empty() -> None:
    rng = np.random.default_rng(0)
    direction = tiny_study(rows=4, columns=4, clear=2, frames=1, weathers=WEATHERS[:2]).beams["direction"]

    def frame(first: float, second: float) -> dict[str, Any]:
        range_m = np.full((4, 4), 20.0) + 0.01 * rng.normal(size=(4, 4))
        range_m[0, 0], range_m[0, 1], range_m[0, 2] = first, second, 0.0
        return {"range_m": range_m, "intensity": np.where(range_m > 0, 0.4, 0.0)}

    made = Study.from_arrays(
        sensor=SENSOR,
        beams={"direction": direction},
        scenes=[{"id": "s0", "clear": [frame(*pair) for pair in ((9.0, 0.0), (14.0, 8.0), (9.0, 8.0))]}],
        conditions=[
            {"id": name, "scene": "s0", "weather": "snow:rate=1", "rel_sd": 0.1, "frames": [frame(9.0, 8.0)]}
            for name in ("c0", "c1")
        ],
    )
    scene = LidarFrames(made).scenes["s0"]
    stable, empty = scene.stable.numpy(), scene.empty[-1].numpy()
    assert not (stable | empty)[0]  # two surfaces
    assert not (stable | empty)[1]  # flickers
    assert empty[2]
    np.testing.assert_array_equal(stable, np.arange(16) > 2)


def test_measured_and_clear_frames_depart_from_their_references_by_the_same_noise(study: Study) -> None:
    """A frame against the mean of the others: sd sqrt(1 + 1 / (K - 1)) of one frame's, measured or clear."""
    made = tiny_study(seed=5, rows=32, columns=64, clear=CLEAR, frames=CLEAR, weathers=(Rain(0.1), Rain(0.1)))
    model = LidarFrames(made)
    beams = model.scenes["s0"].stable.sum().item() * CLEAR
    for frames in (model.measured(made.conditions[0]), model.clear("s0")):
        for statistic, noise in (("range_residual_m", RANGE_NOISE_M), ("log_intensity_ratio", INTENSITY_NOISE)):
            number, square = (group(model, frames, statistic, "range_m", what).sum() for what in ("weight", "square"))
            # About 7,000 departures, each clear frame in all of them: 4 x sqrt(0.5 / 7,000) x 2.
            assert number > 0.95 * beams
            assert math.sqrt(square / number) == pytest.approx(noise * math.sqrt(1.0 + 1.0 / (CLEAR - 1)), rel=0.06)


# ---- what became of each beam ----------------------------------------------------------------------------------------


def altered(study: Study) -> tuple[Any, Any]:
    """Two frames in which beams were lost, moved to the front, moved back, dimmed, read as 0 and lit."""
    range_m, intensity = (stacked(study.scenes["s0"].clear, name)[:2].copy() for name in ("range_m", "intensity"))
    rng = np.random.default_rng(7)
    what = rng.integers(0, 9, range_m.shape)
    seen = range_m > 0
    range_m = np.where(what == 0, 0.0, range_m)
    range_m = np.where((what == 1) & seen, 0.5 * range_m, range_m)
    range_m = np.where((what == 2) & seen, range_m + 3.0, range_m)
    # On either side of what still counts as the surface.
    range_m = np.where((what == 5) & seen, range_m - 1.2 * SAME_SURFACE_M, range_m)
    range_m = np.where((what == 6) & seen, range_m + 0.8 * SAME_SURFACE_M, range_m)
    intensity = np.where(what == 3, 0.7 * intensity, intensity)
    intensity = np.where(what == 8, 0.0, intensity)  # below the step of the file
    lit = (what == 4) & ~seen
    range_m = np.where(lit, 6.0, range_m)
    intensity = np.where(lit, 0.02, np.where(range_m > 0, intensity, 0.0))
    return range_m.astype(np.float32), intensity.astype(np.float32)


OF_EMPTY = ("azimuth_rad", "elevation_rad")


def looped(model: LidarFrames, range_m: Any, intensity: Any, row: int) -> dict[tuple[str, str], Any]:
    """Weight, value and square ``(3, bins)`` of every statistic of beams along each of its axes, beam by beam."""
    scene = model.scenes["s0"]
    edges = scene.edges["range_m"]
    groups = [one for one in model.layout.binned if one.axis != "particle_range_m"]
    sums = {(one.statistic, one.axis): np.zeros((3, one.bins)) for one in groups}
    reference, level = ([float(v) for v in of[row]] for of in (scene.reference_range_m, scene.reference_intensity))
    seen = [float(value) > 0 for value in range_m]
    apart = [float(range_m[beam]) - reference[beam] for beam in range(ROWS * COLUMNS)]
    stable = [beam for beam in range(ROWS * COLUMNS) if scene.stable[beam]]
    same = [beam for beam in stable if seen[beam] and abs(apart[beam]) < SAME_SURFACE_M]
    ratio = {beam: math.log(float(intensity[beam]) / level[beam]) for beam in same if intensity[beam] > 0}
    common_m = sum(apart[beam] for beam in same) / len(same)
    by_range: dict[int, list[float]] = {}
    for beam, value in ratio.items():
        by_range.setdefault(int(scene.bins["range_m"][row, beam]), []).append(value)
    middle = {place: sum(values) / len(values) for place, values in by_range.items()}
    for place, values in by_range.items():
        farthest = 3.0 * scene.reading_noise
        middle[place] += sum(min(max(one - middle[place], -farthest), farthest) for one in values) / len(values)

    def add(statistic: str, beam: int, value: float) -> None:
        for one in groups:
            place = int(scene.bins[one.axis][row, beam])
            if one.statistic == statistic and place >= 0:
                sums[statistic, one.axis][:, place] += (1.0, value, value**2)

    for beam in range(ROWS * COLUMNS):
        if scene.empty[row][beam]:
            add("new_share_of_empty_beams", beam, float(seen[beam]))
    for beam in stable:
        place = int(scene.bins["range_m"][row, beam])
        assert place < 0 or edges[place] <= reference[beam] < edges[place + 1]
        for statistic in ("lost_share", "lost_share_of_thin_targets"):
            add(statistic, beam, float(not seen[beam]))
        add("new_share", beam, float(seen[beam] and apart[beam] < -SAME_SURFACE_M))
        add("beyond_share", beam, float(seen[beam] and apart[beam] > SAME_SURFACE_M))
    for beam, value in ratio.items():
        add("log_intensity_ratio", beam, value)
        away = value - middle[int(scene.bins["range_m"][row, beam])]
        add("log_intensity_spread", beam, math.log1p((away / scene.reading_noise) ** 2))
    for beam in same:
        add("zero_intensity_share", beam, float(intensity[beam] == 0))
        add("range_residual_m", beam, apart[beam])
        add("range_residual_spread", beam, math.log1p(((apart[beam] - common_m) / scene.noise_m) ** 2))
    return sums


def test_sums_agree_with_a_loop_over_the_beams(study: Study, model: LidarFrames) -> None:
    """Along every axis, against one clear frame left out and against all: other beams stand in other bins."""
    range_m, intensity = altered(study)
    rows = [1, CLEAR]
    found = model.reduce("s0", torch.from_numpy(range_m), torch.from_numpy(intensity), torch.tensor(rows))
    bins = model.scenes["s0"].bins
    assert not torch.equal(bins["margin_db"][1], bins["margin_db"][CLEAR])
    for frame, row in enumerate(rows):
        expected = looped(model, range_m[frame], intensity[frame], row)
        assert len(expected) == len(model.layout.binned) - 6  # those of particles
        for (statistic, axis), sums in expected.items():
            for what, wanted in zip(("weight", "value", "square"), sums, strict=True):
                # Single precision of a residual of centimetres at 45 m: 4e-6 m each.
                np.testing.assert_allclose(
                    group(model, found, statistic, axis, what)[frame], wanted, rtol=1e-4, atol=2e-4
                )
            assert sums[2].sum() > 0.0  # each of them happens


def test_a_clock_and_a_scale_of_a_whole_frame_move_means_and_widen_no_spread(study: Study, model: LidarFrames) -> None:
    """Each frame off by its own: a range read later, a laser that is stronger."""
    range_m, intensity = (stacked(study.scenes["s0"].clear, name)[[0, 0, 1]] for name in ("range_m", "intensity"))
    shift_m, factor = np.array([[0.0], [0.06], [-0.04]]), np.array([[1.0], [1.3], [0.8]])
    moved = (np.where(range_m > 0, range_m + shift_m, 0.0), intensity * factor)
    row = torch.tensor([0, 0, 1])
    before, after = (
        model.reduce("s0", *(torch.from_numpy(one.astype(np.float32)) for one in pair), row)
        for pair in ((range_m, intensity), moved)
    )
    # Rounding of 45 m in single precision is 2e-6 m: 2e-4 of the noise of the range, and that of its logarithm.
    for statistic, axes in (
        ("log_intensity_spread", ["range_m"]),
        ("range_residual_spread", ["range_m", "margin_db"]),
    ):
        for axis in axes:
            for what in ("weight", "value", "square"):
                found, wanted = (group(model, one, statistic, axis, what) for one in (after, before))
                np.testing.assert_allclose(found, wanted, rtol=1e-3, atol=2e-3)
            assert (group(model, before, statistic, axis, "square").sum(1) > 0.1).all()
    for statistic, by in (("range_residual_m", shift_m), ("log_intensity_ratio", np.log(factor))):
        weight = group(model, before, statistic, "margin_db", "weight")
        assert weight.sum() > 0.9 * len(row) * int(model.scenes["s0"].stable.sum())
        found, wanted = (group(model, one, statistic, "margin_db") for one in (after, before))
        np.testing.assert_allclose(found - wanted, weight * by, atol=2e-4)


def test_a_flake_right_before_a_surface_hardly_widens_the_spread_of_intensities(
    study: Study, model: LidarFrames
) -> None:
    """One reading at a third of its own: by chance it happens in one condition and not in another."""
    range_m, intensity = (stacked(study.scenes["s0"].clear, name)[:1] for name in ("range_m", "intensity"))
    scene = model.scenes["s0"]
    beam = int((scene.stable & (scene.bins["range_m"][0] == 2)).nonzero()[0])
    dimmed = intensity.copy()
    dimmed[0, beam] /= 3.5
    before, after = (
        model.reduce("s0", *(torch.from_numpy(one.astype(np.float32)) for one in (range_m, level)), torch.tensor([0]))
        for level in (intensity, dimmed)
    )
    number, value, square = (
        group(model, before, "log_intensity_spread", "range_m", what)[0, 2] for what in ("weight", "value", "square")
    )
    moved = (group(model, after, "log_intensity_spread", "range_m")[0, 2] - value) / number
    chance = math.sqrt((square / number - (value / number) ** 2) / number)
    # A square would be moved by ln(3.5)^2 / (number sd^2): many times what chance does to it.
    far = (math.log(3.5) / scene.reading_noise) ** 2
    assert far / number > 3.0 * math.sqrt(2.0 / number)
    assert abs(moved) < 2.0 * chance


def test_particles_are_counted_by_range_and_by_whether_a_neighbour_shares_theirs(
    study: Study, model: LidarFrames
) -> None:
    range_m, intensity = altered(study)
    found = model.reduce("s0", torch.from_numpy(range_m), torch.from_numpy(intensity), torch.tensor([0, 1]))
    scene = model.scenes["s0"]
    for frame in range(2):
        image = range_m[frame].reshape(ROWS, COLUMNS)
        particles = clustered = 0
        for beam in range(ROWS * COLUMNS):
            reach = float(range_m[frame, beam])
            before = bool(scene.stable[beam]) and reach > 0
            before = before and reach - float(scene.reference_range_m[frame, beam]) < -SAME_SURFACE_M
            if not (before or (bool(scene.empty[-1][beam]) and reach > 0)):
                continue
            particles += 1
            down, aside = divmod(beam, COLUMNS)
            clustered += any(
                0 <= down + i < ROWS
                and (i or j)
                and image[down + i, (aside + j) % COLUMNS] > 0
                and abs(image[down + i, (aside + j) % COLUMNS] - image[down, aside]) < CLUSTER_M
                for i in (-1, 0, 1)
                for j in (-1, 0, 1)
            )
        weight, value = (
            group(model, found, "clustered_share", "particle_range_m", what)[frame] for what in ("weight", "value")
        )
        assert (weight.sum(), value.sum()) == (particles, clustered)
        assert particles > clustered > 0
        counts = sum(
            group(model, found, name, "particle_range_m")[frame].sum()
            for name in ("particles_before_objects", "particles_of_empty_beams")
        )
        assert counts == particles
        assert found.maps[frame].sum() == particles


def test_scalars_of_a_frame_are_those_of_its_beams(study: Study, model: LidarFrames) -> None:
    range_m, intensity = altered(study)
    found = model.reduce("s0", torch.from_numpy(range_m), torch.from_numpy(intensity), torch.tensor([0, 1])).scalar
    scene = model.scenes["s0"]
    stable, empty = scene.stable.numpy(), scene.empty[-1].numpy()
    for frame in range(2):
        seen, apart = range_m[frame] > 0, range_m[frame] - scene.reference_range_m[frame].numpy()
        lost, same = (stable & ~seen).sum(), stable & seen & (np.abs(apart) < SAME_SURFACE_M)
        particle = seen & (empty | (stable & (apart < -SAME_SURFACE_M)))
        near = particle & (range_m[frame] < 3.0)
        bright = same & (intensity[frame] > 0)
        ratio = np.log(intensity[frame, bright] / scene.reference_intensity[frame].numpy()[bright])
        expected = [
            math.asin(math.sqrt((lost + 0.375) / (stable.sum() + 0.75))),
            math.sqrt(particle.sum() + 0.375),
            ratio.mean(),
            math.sqrt(near.sum() + 0.375),
        ]
        np.testing.assert_allclose(found[frame], expected, rtol=1e-4, atol=1e-6)
        assert min(lost, particle.sum(), near.sum()) > 0


def test_portions_add_up_to_the_whole(model: LidarFrames, study: Study) -> None:
    condition, portions = study.conditions[0], 8
    whole = model.simulated(condition, (), 0.0, SEEDS)
    parts = model.simulated(condition, (), 0.0, SEEDS, portions)
    for name in ("weight", "value", "square", "maps"):
        part = getattr(parts, name)
        total = part.reshape(len(SEEDS), portions, *part.shape[1:]).sum(1)
        if name == "weight":  # a count is of frames, not of beams
            counts = [
                place
                for one, where in zip(model.layout.binned, model.layout.slices, strict=False)
                if one.kind == "count"
                for place in range(where.start, where.stop)
            ]
            total[:, counts] /= portions
        # Sums of single precision, in another order.
        np.testing.assert_allclose(total, getattr(whole, name), rtol=1e-4, atol=1e-4)


# ---- simulated frames ------------------------------------------------------------------------------------------------


def test_a_frame_starts_from_the_clear_frame_that_its_seed_is_modulo_their_number(
    study: Study, model: LidarFrames, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Ranges tell the clear frames apart: their noise is 1 cm, that of rounding far less."""
    given: list[Any] = []
    monkeypatch.setattr(model, "reduce", lambda *parts: given.append(parts) or plain(*parts))
    plain = LidarFrames(study).reduce
    seeds = [3, 8 * CLEAR, 2**40 + 1, 17, 6, *range(5 * CLEAR, 6 * CLEAR)]  # more than are simulated together
    model.simulated(study.conditions[2], (), 0.0, seeds)
    rows = np.concatenate([parts[3].numpy() for parts in given])
    np.testing.assert_array_equal(rows, [seed % CLEAR for seed in seeds])
    clear = stacked(study.scenes["s0"].clear, "range_m")
    for range_m, row in zip(torch.cat([parts[1] for parts in given]).numpy(), rows, strict=True):
        seen = (clear > 0).all(0) & (range_m > 0)
        alike = (np.abs(clear - range_m)[:, seen] < 1e-4).mean(1)
        assert alike[row] > 0.8
        assert np.delete(alike, row).max() < 0.1


def test_same_seeds_give_the_same_bits_and_others_do_not(study: Study) -> None:
    condition = study.conditions[0]
    first, again = (LidarFrames(study).simulated(condition, (WINDOW(loss_db=1.0),), 0.02, SEEDS) for _ in range(2))
    assert_same(first, again)
    other = LidarFrames(study).simulated(condition, (WINDOW(loss_db=1.0),), 0.02, [seed + 1 for seed in SEEDS])
    assert not np.array_equal(first.value, other.value)


def test_a_frame_depends_on_its_own_seed_alone(model: LidarFrames, study: Study) -> None:
    for condition in study.conditions:
        together = model.simulated(condition, (), 0.0, SEEDS)
        alone = Reduced.joined([model.simulated(condition, (), 0.0, [seed]) for seed in SEEDS])
        # Tables of particles are made per frame; sums of single precision.
        assert_same(together, alone, 1e-5)


@pytest.mark.parametrize("name", ["lidar.window_loss", "lidar.extinction_scale", "lidar.range_bias"])
def test_what_is_kept_of_the_chain_gives_the_bits_of_the_whole_chain(study: Study, name: str) -> None:
    points = {
        "lidar.window_loss": ({"loss_db": 0.5}, {"loss_db": 3.0}),
        "lidar.extinction_scale": ({"factor": 0.7}, {"factor": 1.5}),
        "lidar.range_bias": ({"offset_m": 0.05}, {"offset_m": -0.1}),
    }[name]
    condition = study.conditions[0]
    keeping = LidarFrames(study)
    for values in points:  # the second starts from what the first kept
        effects = [EFFECTS["lidar.wet_target"](share=0.2), EFFECTS[name](**values)]
        found = keeping.simulated(condition, effects, 0.05, SEEDS)
        assert_same(found, LidarFrames(study).simulated(condition, effects, 0.05, SEEDS))
    # Another setting of what comes before must not be taken for it.
    effects = [EFFECTS["lidar.wet_target"](share=0.6), EFFECTS[name](**points[1])]
    found = keeping.simulated(condition, effects, 0.05, SEEDS)
    assert_same(found, LidarFrames(study).simulated(condition, effects, 0.05, SEEDS))


def test_what_is_kept_depends_on_what_is_open_before_the_effect(study: Study) -> None:
    """Noise of weak signals comes before detection, a bias of the range after: the first is in what is kept."""
    condition, keeping = study.conditions[0], LidarFrames(study)
    values = []
    for variance in (0.001, 0.2, 0.001):
        effects = [DRIFT(offset_m=0.05), WeakSignalNoise(variance_at_threshold=variance)]
        found = keeping.simulated(condition, effects, 0.0, SEEDS)
        assert_same(found, LidarFrames(study).simulated(condition, effects, 0.0, SEEDS))
        values.append(found.value)
    assert not np.array_equal(values[0], values[1])


def test_what_is_kept_depends_on_the_intensity_and_on_the_condition(study: Study) -> None:
    keeping = LidarFrames(study)
    for condition in study.conditions:
        for log_intensity in (0.0, 0.3):
            effects = [WINDOW(loss_db=1.0)]
            found = keeping.simulated(condition, effects, log_intensity, SEEDS)
            assert_same(found, LidarFrames(study).simulated(condition, effects, log_intensity, SEEDS))


def test_effects_of_the_model_are_those_of_the_call(study: Study) -> None:
    condition = study.conditions[0]
    window, drift = WINDOW(loss_db=2.0), DRIFT(offset_m=0.04)
    inside = LidarFrames(study, effects=[window]).simulated(condition, [drift], 0.0, SEEDS)
    assert_same(inside, LidarFrames(study).simulated(condition, [window, drift], 0.0, SEEDS))
    assert not np.array_equal(inside.value, LidarFrames(study).simulated(condition, [drift], 0.0, SEEDS).value)


def test_an_effect_at_its_identity_changes_no_bit(study: Study, model: LidarFrames) -> None:
    condition = study.conditions[0]
    without = model.simulated(condition, (), 0.0, SEEDS)
    for name in ("lidar.window_loss", "lidar.crosstalk", "lidar.limited_extent"):
        assert_same(model.simulated(condition, [EFFECTS[name]()], 0.0, SEEDS), without)


@pytest.mark.parametrize("place", [0, 1, 2])
def test_the_intensity_is_that_of_the_weather_and_is_put_back(study: Study, place: int) -> None:
    condition = study.conditions[place]
    model = LidarFrames(study)
    plain = model.simulated(condition, (), 0.0, SEEDS)
    moved = model.simulated(condition, (), math.log(1.25), SEEDS)
    assert_same(LidarFrames(study).simulated(condition, (), 0.0, SEEDS), plain)
    swapped = LidarFrames(study)
    other = [Snow(2.5), Fog(75.0), Rain(50.0)][place]
    swapped.transforms[condition.id] = LidarWeather(other, swapped.sensor, beam_ends="max_range")
    # exp(log 1.25) is 1.25 to the last bit of single precision: a beam at the threshold may differ, no more.
    expected = swapped.simulated(condition, (), 0.0, SEEDS)
    for statistic in ("particles_before_objects", "particles_of_empty_beams"):
        found, wanted = (group(model, one, statistic, "particle_range_m").sum() for one in (moved, expected))
        assert found == pytest.approx(wanted, abs=2)
    ratio, wanted = (group(model, one, "log_intensity_ratio", "range_m").sum() for one in (moved, expected))
    assert ratio == pytest.approx(wanted, rel=1e-3, abs=0.05)
    assert not np.array_equal(moved.value, plain.value)


def test_one_thread_and_two_agree(study: Study) -> None:
    condition, before = study.conditions[0], torch.get_num_threads()
    try:
        found = []
        for threads in (1, 2):
            torch.set_num_threads(threads)
            found.append(LidarFrames(study).simulated(condition, [WINDOW(loss_db=1.0)], 0.1, SEEDS))
    finally:
        torch.set_num_threads(before)
    # Which beam became what is the same to the bit; values are summed in single precision, in another order.
    for name in ("weight", "maps"):
        np.testing.assert_array_equal(getattr(found[0], name), getattr(found[1], name))
    assert_same(found[0], found[1], 3e-6)


def test_intensities_of_a_bin_that_fog_hides_do_not_count(model: LidarFrames, study: Study) -> None:
    """Of the mean of far surfaces few are left; how many are lost does count there."""
    fog = next(one for one in observations(model, model.fit) if one.condition.weather.parts[0].kind == "fog")
    frames, clear = model.measured(fog.condition), model.clear(fog.condition.scene)
    enough = Pool(model.layout, frames).enough(fog.frames)
    hidden = 0
    for one, part in zip(model.layout.binned, model.layout.slices, strict=False):
        expected = enough[part]
        if (one.statistic, one.kind) == ("log_intensity_ratio", "mean"):
            left = frames.weight[:, part].sum(0) / FRAMES < 0.5 * clear.weight[:, part].sum(0) / CLEAR
            hidden += int((expected & left).sum())
            expected = expected & ~left
        np.testing.assert_array_equal(fog.enough[part], expected)
    assert hidden >= 3
