"""What a LiDAR study leaves open: stages that do what they say, on what they say, and nothing at their identity."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import torch
from torch import Tensor

from tests.gap.tiny_study import SENSOR, tiny_study
from torchweather.atmosphere.weather import Fog, Rain, Snow
from torchweather.gap.sensors.lidar.frames import FOG_GAIN_SD, FOG_RANGE_SHARE, GAIN_SD, LidarFrames
from torchweather.gap.sensors.lidar.systematics import (
    ClearScale,
    EchoGain,
    FogEchoRange,
    FrameClock,
    ParticleReading,
    ParticleReadingScale,
    WeakSignalNoise,
)
from torchweather.gap.statistics.frame_random_effects import widened
from torchweather.gap.study.study import Study
from torchweather.lidar.effects.all import EFFECTS
from torchweather.pipeline.effect import Effect, with_effects
from torchweather.pipeline.point_kind import PointKind
from torchweather.stages import LidarState

N = 100_000
THRESHOLD = 1e-5
OBJECT, PARTICLE, LOST = (int(kind) for kind in (PointKind.OBJECT, PointKind.PARTICLE, PointKind.LOST))
# A standard deviation from 100,000 draws is known to sqrt(0.5 / 100,000) = 0.22 %: five times that.
TOLERANCE = 0.012


def state(clear: float = 10.0, here: float = 2.0, echoes: int = 1) -> LidarState:
    """Beams whose object stood so many times over the threshold, and does now; particles of 3 thresholds at 5 m."""
    range_m, signal, kind = (torch.full((1, N, 1), value) for value in (20.0, here * THRESHOLD, float(OBJECT)))
    more = echoes - 1
    return LidarState.of(
        points_in=torch.tensor([20.0, 0.0, 0.0, 0.3]).expand(1, N, 4),
        empty_direction=None,
        clear_range_m=range_m[..., 0],
        clear_signal=torch.full((1, N), clear * THRESHOLD),
        range_m=torch.cat([range_m, torch.full((1, N, more), 5.0)], -1),
        signal=torch.cat([signal, torch.full((1, N, more), 3.0 * THRESHOLD)], -1),
        kind=torch.cat([kind, torch.full((1, N, more), float(PARTICLE))], -1).to(torch.int8),
        reach_m=range_m[..., 0],
        threshold=torch.tensor(THRESHOLD),
        integral=torch.zeros(1, N, dtype=torch.bool),
    )


def reported() -> LidarState:
    """What was detected: an object, a particle and nothing in turn."""
    plain = state()
    kind = (torch.arange(N) % 3)[None, :, None].to(torch.int8)
    return plain.changed(kind=kind, range_m=torch.where(kind == LOST, 0.0, plain.returns.range_m))


def after(stage: Effect, before: LidarState) -> LidarState:
    found: LidarState = stage(before, stage.draw(before, seed=torch.tensor([3])))
    return found


def relative(found: Tensor, before: Tensor) -> Any:
    return (found / before - 1.0).double()


# ---- each by itself --------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("clear", "here"), [(10.0, 2.0), (100.0, 1.0), (3.0, 2.9)])
def test_a_weaker_signal_gains_the_variance_that_it_lacks(clear: float, here: float) -> None:
    v = 0.01
    before = state(clear, here, echoes=2)
    found = after(WeakSignalNoise(variance_at_threshold=v), before)
    change = relative(found.returns.signal[..., 0], before.returns.signal[..., 0])
    assert float(change.std()) == pytest.approx(math.sqrt(v * (1.0 / here - 1.0 / clear)), rel=TOLERANCE)
    assert abs(float(change.mean())) < 5.0 * float(change.std()) / math.sqrt(N)
    assert torch.equal(found.returns.signal[..., 1], before.returns.signal[..., 1])  # particles lack nothing


def test_a_signal_that_did_not_grow_weaker_keeps_its_bits() -> None:
    for here in (10.0, 30.0):
        before = state(10.0, here)
        assert torch.equal(
            after(WeakSignalNoise(variance_at_threshold=0.5), before).returns.signal, before.returns.signal
        )


def test_particles_are_read_with_noise_and_objects_as_they_were() -> None:
    before = reported()
    found = after(ParticleReading(std=0.05), before)
    particle = before.returns.kind == PARTICLE
    change = relative(found.returns.signal, before.returns.signal)[particle]
    # A third of the beams.
    assert float(change.std()) == pytest.approx(0.05, rel=2.0 * TOLERANCE)
    assert abs(float(change.mean())) < 5.0 * 0.05 / math.sqrt(N / 3)
    assert torch.equal(found.returns.signal[~particle], before.returns.signal[~particle])
    assert torch.equal(found.returns.range_m, before.returns.range_m)


@pytest.mark.parametrize("share", [0.3, -0.4])
def test_particles_are_brighter_by_a_share(share: float) -> None:
    before = state(echoes=3)
    found = after(EchoGain(share=share), before)
    # Single precision.
    torch.testing.assert_close(
        found.returns.signal[..., 1:], before.returns.signal[..., 1:] * (1.0 + share), rtol=1e-6, atol=0.0
    )
    assert torch.equal(found.returns.signal[..., :1], before.returns.signal[..., :1])


@pytest.mark.parametrize("log_scale", [0.02, -0.3])
def test_objects_are_brighter_by_a_scale(log_scale: float) -> None:
    before = state(echoes=3)
    found = after(ClearScale(log_scale=log_scale), before)
    torch.testing.assert_close(
        found.returns.signal[..., 0], before.returns.signal[..., 0] * math.exp(log_scale), rtol=1e-6, atol=0.0
    )
    assert torch.equal(found.returns.signal[..., 1:], before.returns.signal[..., 1:])
    assert torch.equal(found.scene.clear_signal, before.scene.clear_signal)


def test_fog_is_reported_nearer_and_scattered() -> None:
    before = reported().changed(range_m=torch.where(reported().returns.kind == PARTICLE, 5.0, 20.0))
    found = after(FogEchoRange(shift_m=-0.3, spread_m=0.2), before)
    particle = before.returns.kind == PARTICLE
    change = (found.returns.range_m - before.returns.range_m)[particle].double()
    assert float(change.mean()) == pytest.approx(-0.3, abs=5.0 * 0.2 / math.sqrt(N / 3))
    assert float(change.std()) == pytest.approx(0.2, rel=2.0 * TOLERANCE)
    assert torch.equal(found.returns.range_m[~particle], before.returns.range_m[~particle])
    assert torch.equal(found.returns.signal, before.returns.signal)
    near = after(FogEchoRange(shift_m=-5.0), before.changed(range_m=before.returns.range_m * 0.1))
    assert bool((near.returns.range_m[particle] == 0.1).all())  # not behind the sensor


def test_particles_are_read_on_a_scale_of_their_own() -> None:
    before = reported()
    found = after(ParticleReadingScale(log_scale=0.3), before)
    particle = before.returns.kind == PARTICLE
    torch.testing.assert_close(found.returns.signal[particle], math.exp(0.3) * before.returns.signal[particle])
    assert torch.equal(found.returns.signal[~particle], before.returns.signal[~particle])
    assert torch.equal(found.returns.range_m, before.returns.range_m)


def test_a_late_clock_moves_the_particles_of_its_frame() -> None:
    before = reported()
    found = after(FrameClock(late_m=[0.25]), before)
    particle = before.returns.kind == PARTICLE
    torch.testing.assert_close(found.returns.range_m[particle], before.returns.range_m[particle] + 0.25)
    assert torch.equal(found.returns.range_m[~particle], before.returns.range_m[~particle])


IDENTITIES = [
    *(WeakSignalNoise(), ClearScale(), ParticleReading(), ParticleReadingScale(), EchoGain(), FogEchoRange()),
    FrameClock(),
]


@pytest.mark.parametrize("stage", IDENTITIES, ids=lambda stage: stage.id)
def test_at_its_identity_a_stage_changes_no_bit(stage: Effect) -> None:
    assert bool(stage.at_identity)
    for before in (state(echoes=2), reported()):
        found = after(stage, before)
        for field in LidarState.part_of:
            one, other = before.field(field), found.field(field)
            assert torch.equal(one, other) if isinstance(one, Tensor) else one == other, field
    assert stage.id not in EFFECTS  # never an answer


# ---- in the frames of a study ----------------------------------------------------------------------------------------

WEATHERS = (Snow(2.0), Fog(40.0), Rain(30.0))
SEEDS = [11, 2**40 + 5, 17]


@pytest.fixture(scope="module")
def study() -> Study:
    return tiny_study(seed=3, rows=16, columns=32, clear=4, frames=3, weathers=WEATHERS)


@pytest.fixture(scope="module")
def model(study: Study) -> LidarFrames:
    found = LidarFrames(study)
    found.scenes["s0"] = replace(found.scenes["s0"], variance_at_threshold=2e-3)
    return found


def test_what_is_open_depends_on_the_weather(study: Study, model: LidarFrames) -> None:
    snow, fog, rain = study.conditions
    always = {"noise": 0.0, **dict.fromkeys(("clear scale s0", "particle reading", "particle gain"), -math.inf)}
    assert model.open(snow) == model.open(rain) == always
    assert model.open(fog) == {**always, "fog shift": -math.inf, "fog spread": 0.0}
    assert model.misplaced(snow) == 0.0 < model.misplaced(fog) < 0.1


def test_strengths_are_standard_deviations(study: Study, model: LidarFrames) -> None:
    snow, fog, _ = study.conditions
    strengths = {"noise": 1.5, "fog shift": -2.0, "fog spread": 0.5, "particle gain": 3.0}
    strengths |= {"clear scale s0": -1.0, "particle reading": 2.0}
    of_snow = {one.id: one.to_dict() for one in model.systematics(snow, strengths)}
    assert of_snow == {
        "gap.weak_signal_noise": {"effect": "gap.weak_signal_noise", "variance_at_threshold": pytest.approx(3e-3)},
        "gap.echo_gain": {"effect": "gap.echo_gain", "share": pytest.approx(3.0 * GAIN_SD)},
        "gap.particle_reading_scale": {
            "effect": "gap.particle_reading_scale",
            "log_scale": pytest.approx(2.0 * GAIN_SD),
        },
        "gap.clear_scale": {"effect": "gap.clear_scale", "log_scale": pytest.approx(-model.clear_scale_sd["s0"])},
    }
    of_fog = {one.id: one.to_dict() for one in model.systematics(fog, strengths)}
    metres = FOG_RANGE_SHARE * SENSOR.pulse_length_m
    assert of_fog["gap.echo_gain"]["share"] == pytest.approx(3.0 * FOG_GAIN_SD / math.sqrt(SENSOR.photons_at_threshold))
    assert of_fog["gap.fog_echo_range"] == {
        "effect": "gap.fog_echo_range",
        "shift_m": pytest.approx(-2.0 * metres),
        "spread_m": pytest.approx(0.5 * metres),
    }
    for condition in (snow, fog):
        assert model.systematics(condition, {}) == []
        assert model.systematics(condition, {"noise": -1.0, "fog spread": -1.0}) == []  # no less than none


def through(model: LidarFrames, condition: Any, effects: list[Effect]) -> Any:
    scene = model.scenes["s0"]
    row = torch.tensor([0, 1, 2])
    with torch.no_grad():
        return model._through(condition, scene, row, effects, 0.0, SEEDS)


@pytest.mark.parametrize("place", [0, 1])
def test_frames_with_open_stages_are_those_of_the_whole_chain(study: Study, model: LidarFrames, place: int) -> None:
    """Kept states and random numbers against a chain that runs from end to end."""
    condition, scene = study.conditions[place], model.scenes["s0"]
    strengths = {"noise": 2.0, "fog shift": 1.0, "fog spread": 1.0, "particle gain": 5.0, "clear scale s0": 2.0}
    opened = model.systematics(condition, strengths)
    transform = model.transform(condition)
    gain = scene.gain[:3, None]
    points = torch.cat([model.direction * scene.range_m[:3, :, None], (scene.intensity[:3] / gain)[..., None]], -1)
    begin = transform.state_of(points, model.direction)
    begin = begin.changed(grid=model.grid, cos_incidence=scene.cos_incidence[None], up=scene.up[None])  # type: ignore[index]
    for loss_db in (0.5, 3.0, 0.5):  # the second and third start from what the first kept
        effects = [EFFECTS["lidar.wet_target"](share=0.2), EFFECTS["lidar.window_loss"](loss_db=loss_db), *opened]
        chain = with_effects(transform.chain, effects[:2])
        late = FrameClock(late_m=scene.clock_m[:3])
        for one in [*opened, ParticleReading(std=scene.reading_std), late]:
            chain = chain.insert(one, before="detection" if one.after == "particle_returns" else "to_points")
        with torch.no_grad():
            out = chain(begin, chain.draw(begin, seed=torch.tensor(SEEDS)))
        found_range_m, found_intensity = through(model, condition, effects)
        range_m = out.returns.points[..., :3].norm(dim=-1)
        torch.testing.assert_close(found_range_m, range_m, rtol=3e-6, atol=1e-6)
        ours = (out.returns.kind[..., 0] == PARTICLE) & (range_m > 0)
        assert torch.equal(found_intensity, torch.where(range_m > 0, out.returns.points[..., 3] * gain, 0.0))
        assert bool(ours.any())


@pytest.mark.parametrize("name", ["noise", "particle gain", "particle reading", "fog shift", "fog spread"])
def test_each_open_stage_changes_the_frames_of_fog_and_can_be_taken_back(
    study: Study, model: LidarFrames, name: str
) -> None:
    condition = study.conditions[1]
    plain, moved, again = (
        through(model, condition, model.systematics(condition, {name: strength})) for strength in (0.0, 3.0, 0.0)
    )
    assert any(not torch.equal(one, other) for one, other in zip(plain, moved, strict=True))
    assert all(torch.equal(one, other) for one, other in zip(plain, again, strict=True))


def test_the_scale_of_a_frame_is_one_of_the_reading(study: Study) -> None:
    """Intensities 10 % larger in the second clear frame: so are those of its particles, and nothing else changes."""
    condition = study.conditions[1]
    one, other = LidarFrames(study), LidarFrames(study)
    scene = one.scenes["s0"]
    gain = torch.tensor([1.0, 1.1, 1.0, 1.0])
    one.scenes["s0"] = replace(scene, gain=torch.ones(4))
    other.scenes["s0"] = replace(scene, gain=gain, intensity=scene.intensity * gain[:, None])
    (plain_m, plain), (range_m, scaled) = (through(each, condition, []) for each in (one, other))
    assert ((range_m > 0) & scene.empty[-1]).sum() > 15
    assert ((range_m > 0) & scene.stable).sum() > 15
    torch.testing.assert_close(range_m, plain_m, rtol=3e-6, atol=1e-6)
    torch.testing.assert_close(scaled, plain * gain[:3, None], rtol=1e-5, atol=0.0)


def test_the_clock_of_a_frame_moves_its_particles(study: Study) -> None:
    """The second clear frame is late by 10 cm: so are its particles, on the millimetre, and none of another frame."""
    condition = study.conditions[1]
    late_m = torch.tensor([0.0, 0.1, 0.0, 0.0])
    one, other = LidarFrames(study), LidarFrames(study)
    one.scenes["s0"], other.scenes["s0"] = (
        replace(one.scenes["s0"], clock_m=clock_m) for clock_m in (torch.zeros(4), late_m)
    )
    (plain_m, _), (range_m, _) = (through(each, condition, []) for each in (one, other))
    particle = (plain_m > 0) & one.scenes["s0"].empty[-1]
    assert (particle.sum(1) > 10).all()
    moved = torch.where(particle, range_m - plain_m, 0.0)
    torch.testing.assert_close(moved, late_m[:3, None] * particle, rtol=0.0, atol=2e-5)
    assert torch.equal(range_m[plain_m == 0], plain_m[plain_m == 0])


def test_the_scale_of_a_clear_mean_is_known_as_well_as_frames_agree() -> None:
    """Frames of two scenes whose scales scatter by 1 %; more than Student's widening is no part of it."""
    study = tiny_study(seed=3, rows=16, columns=32, clear=16)
    scale = 1.0 + 0.01 * np.random.default_rng(4).normal(size=16)
    (name, scene), *_ = study.scenes.items()
    clear = [{**frame, "intensity": one * frame["intensity"]} for one, frame in zip(scale, scene.clear, strict=True)]
    model = LidarFrames(replace(study, scenes={name: replace(scene, clear=clear)}))
    expected = np.log(scale).std(ddof=1) / math.sqrt(16.0) * math.sqrt(widened(15))
    # The frames' own noise of 2 % over about 300 beams.
    assert model.clear_scale_sd[name] == pytest.approx(expected, rel=0.2)
    assert LidarFrames(tiny_study(clear=1)).clear_scale_sd == {"s0": 0.0}
    assert "clear scale s0" not in LidarFrames(tiny_study(clear=1)).open(study.conditions[0])


def test_readings_in_steps_have_a_scale_and_stay_on_them() -> None:
    study = tiny_study(clear=4)
    scenes = [
        replace(
            scene, clear=[{**frame, "intensity": 0.01 * np.floor(100.0 * frame["intensity"])} for frame in scene.clear]
        )
        for scene in study.scenes.values()
    ]
    stepped = replace(study, scenes={scene.id: scene for scene in scenes})
    model = LidarFrames(stepped)
    assert (model.scenes["s0"].gain != 1.0).all()
    _, intensity = model.simulated_scans(model.fit[0], [], 0.0, range(4))
    torch.testing.assert_close(100.0 * intensity, (100.0 * intensity).round(), atol=1e-3, rtol=0.0)
