"""Frames of a scanning LiDAR in weather: echoes of targets, of listed particles and of fog; the strongest one wins."""

from __future__ import annotations

import numpy as np

from torchweather.sensors import Lidar

from .lidar_shot import NO_ECHO, PARTICLE, TARGET, Echoes, Effect, Report, Shot, View, Weather
from .particles import NODE_M, Drops, draw_drops, fog_echo, near_response
from .rays import Scan
from .scene import FloatArray

__all__ = ["SCALE_SPREAD", "shoot", "study_sensor"]

# Fog's waveform is looked at up to here: its maximum lies within a few metres of full overlap.
FOG_TO_M = 14.0
# Relative standard deviation of a reported intensity, besides that of its photons (order of magnitude).
READING_SPREAD = 0.02
# From frame to frame: scale of the intensities and start of the clock of a whole frame (orders of magnitude; without
# them a mean over 10,000 beams would show a hundredth of a decibel). Detection does not know of them.
SCALE_SPREAD, CLOCK_SPREAD_M = 0.015, 0.004
# Particles that send back less than this share of the threshold are not listed.
FLOOR_SHARE = 0.5


def study_sensor(scan: Scan, near_start_m: float = 2.0, near_full_m: float = 10.0) -> Lidar:
    """An Ouster OS1-128 with rings and columns of its own, intensities as reflectivity, and little photon noise.

    Args:
        scan: pattern.
        near_start_m, near_full_m: near-range response; an early one is needed to see drops of rain at all.
    """
    return Lidar.preset(
        "ouster-os1-128",
        elevations_deg=tuple(float(value) for value in scan.elevation_deg),
        azimuth_offsets_deg=None,
        origin_heights_m=None,
        columns=scan.shape[1],
        intensity_unit="reflectivity",
        photons_at_threshold=1000.0,
        range_noise_m=0.02,
        near_start_m=near_start_m,
        near_full_m=near_full_m,
    )


def shoot(
    view: View,
    weather: Weather,
    effects: tuple[Effect, ...],
    time_s: FloatArray,
    rng: np.random.Generator,
) -> Report:
    """Frames in a weather with effects.

    Args:
        view: scene and sensor.
        weather: as it truly is.
        effects: in the order in which they act.
        time_s: ``(F,)`` of each frame.
        rng: draws.
    """
    for effect in effects:
        view = effect.on_view(view)
    shot = Shot(view, weather, np.asarray(time_s, dtype=np.float64), *rng.spawn(5))
    for effect in effects:
        effect.prepare(shot)
    echoes = _echoes(shot)
    for effect in effects:
        effect.on_echoes(shot, echoes)
    report = _detect(shot, echoes)
    for effect in effects:
        effect.on_report(shot, report)
    written = _finish(shot, report)
    for effect in effects:
        effect.on_output(written)
    return written


def _echoes(shot: Shot) -> Echoes:
    target, sensor = shot.view.target, shot.sensor
    frames, beams = shot.shape
    seen = np.isfinite(target.range_m)
    at = np.where(seen, target.range_m, 1.0)
    clear = np.where(seen, target.reflectivity * np.nan_to_num(target.cos_incidence), 0.0)
    clear = clear / np.pi * near_response(sensor, at) / at**2
    every = np.arange(frames)[:, None]
    signal = clear * shot.near_gain(at) * np.exp(-2.0 * shot.depth(every, at[None]))
    none = np.zeros(0, dtype=np.int64)
    echoes = Echoes(np.broadcast_to(at, (frames, beams)), signal, none, none, np.zeros(0), np.zeros(0), none)
    if shot.air.sizes is not None:
        drops = _drops(shot)
        echoes.add(drops.frame, drops.beam, drops.range_m, drops.signal, PARTICLE)
    elif shot.air.backscatter_per_m_sr > 0.0:
        range_m, power = _fog(shot)
        frame, beam = np.nonzero(power > _floor(shot))
        echoes.add(frame, beam, range_m[frame, beam], power[frame, beam], PARTICLE)
    return echoes


def _floor(shot: Shot) -> float:
    """Signal of the weakest particle that is listed."""
    lowest = shot.sensor.threshold_per_m2_sr * float(shot.threshold_gain.min())
    return FLOOR_SHARE * lowest / shot.highest_particle_gain


def _drops(shot: Shot) -> Drops:
    """Particles in front of each target, with the loss on the way."""
    sensor = shot.sensor
    divergence = 1e-3 * sensor.divergence_mrad + shot.extra_divergence_rad
    pulse_m = sensor.pulse_length_m
    drops = draw_drops(
        shot.air,
        sensor,
        shot.view.beams,
        shot.density,
        _floor(shot),
        divergence,
        shot.drops_rng,
        pulse_m,
        shot.beam_density,
    )
    keep = drops.range_m < shot.view.target.range_m[drops.beam]
    if np.isfinite(shot.extent_m):
        keep &= shot.drops_rng.random(len(keep)) < shot.density_at(drops.range_m)
    drops = drops.only(keep)
    loss = np.exp(-2.0 * shot.depth(drops.frame, drops.range_m, drops.beam))
    gain = shot.near_gain(drops.range_m) * shot.particle_gain(drops.range_m)
    return Drops(drops.frame, drops.beam, drops.range_m, drops.signal * loss * gain)


def _fog(shot: Shot) -> tuple[FloatArray, FloatArray]:
    nodes = np.arange(shot.sensor.near_start_m, FOG_TO_M, NODE_M)
    every = np.arange(shot.shape[0])[:, None]
    alike = np.ones(1) if shot.beam_density is None else shot.beam_density
    depth = shot.depth(every, nodes[None], slice(0, 1))[:, None, :] / alike[0] * alike[None, :, None]
    density = (shot.density[:, None] * shot.density_at(nodes[None]))[:, None, :] * alike[None, :, None]
    gain = (shot.near_gain(nodes) * shot.particle_gain(nodes))[None, None, :]
    return fog_echo(shot.air, shot.sensor, shot.view.target.range_m, depth, density, nodes, gain, shot.drops_rng)


def _detect(shot: Shot, echoes: Echoes) -> Report:
    """Photon noise, threshold, and the strongest echo of each beam (or the last one)."""
    sensor = shot.sensor
    photon = sensor.threshold_per_m2_sr / sensor.photons_at_threshold
    threshold = sensor.threshold_per_m2_sr * np.broadcast_to(shot.threshold_gain, shot.shape)

    signal = echoes.target + np.sqrt(echoes.target * photon) * shot.target_rng.standard_normal(shot.shape)
    found = (echoes.target > 0.0) & (signal >= threshold)
    best = np.where(found, signal, 0.0)
    range_m = np.where(found, echoes.target_m, 0.0)
    kind = np.where(found, TARGET, NO_ECHO)

    # The waveform of fog was read with the noise of its photons already.
    counted = (echoes.kind != PARTICLE) | (shot.air.sizes is not None)
    noise = np.where(counted, np.sqrt(echoes.signal * photon), 0.0)
    noisy = echoes.signal + noise * shot.echo_rng.standard_normal(len(echoes.signal))
    index = echoes.frame * shot.shape[1] + echoes.beam
    above = noisy >= threshold.reshape(-1)[index]
    index, noisy, at, kinds = index[above], noisy[above], echoes.range_m[above], echoes.kind[above]
    order = np.argsort(noisy, kind="stable")  # of repeated places the last assignment stands: the strongest
    strongest = np.zeros(best.size, dtype=np.int64)
    strongest[index[order]] = order + 1
    place = np.flatnonzero(strongest)
    chosen = strongest[place] - 1
    wins = noisy[chosen] > best.reshape(-1)[place]
    if shot.last_probability > 0.0:
        wins &= ~((kind.reshape(-1)[place] == TARGET) & (shot.rng.random(len(place)) < shot.last_probability))
    place, chosen = place[wins], chosen[wins]
    best.reshape(-1)[place] = noisy[chosen]
    range_m.reshape(-1)[place] = at[chosen]
    kind.reshape(-1)[place] = kinds[chosen]

    # A target's intensity is its reflectivity; a particle's is what it would be without the near-range response.
    with np.errstate(divide="ignore", invalid="ignore"):
        intensity = np.pi * best * range_m**2
        intensity = np.where(kind == TARGET, intensity / near_response(sensor, range_m), intensity)
    return Report(range_m, np.where(kind == NO_ECHO, 0.0, intensity), kind, best)


def _finish(shot: Shot, report: Report) -> Report:
    """Noise of the range and of the reading; millimetres and 1/1000 of the intensity's scale, as sensors round."""
    rng, step = shot.report_rng, shot.sensor.range_resolution_m
    seen = report.range_m > 0.0
    clock = CLOCK_SPREAD_M * rng.standard_normal((shot.shape[0], 1))
    noisy = report.range_m + clock + shot.sensor.range_noise_m * rng.standard_normal(shot.shape)
    range_m = np.maximum(np.rint(noisy / step) * step, step)
    scale = 1.0 + SCALE_SPREAD * rng.standard_normal((shot.shape[0], 1))
    read = report.intensity * scale * (1.0 + READING_SPREAD * rng.standard_normal(shot.shape))
    intensity = np.round(np.maximum(read, 0.0), 5)
    outside = range_m > shot.sensor.max_range_m
    seen &= ~outside
    return Report(
        np.where(seen, range_m, 0.0),
        np.where(seen, intensity, 0.0),
        np.where(seen, report.kind, NO_ECHO),
        report.signal,
    )
