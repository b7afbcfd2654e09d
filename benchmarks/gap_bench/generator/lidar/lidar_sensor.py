"""Frames of a scanning LiDAR in weather: echoes of targets, of listed particles and of fog; the strongest one wins.

A hidden effect changes a `Shot` at three places: `Effect.prepare` (air, optics, receiver), `Effect.on_echoes` (each
echo's power), `Effect.on_report` (what the firmware gives out).
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from torchweather.sensors import Lidar

from .particles import NODE_M, Air, Drops, air_of, draw_drops, fog_echo, near_response
from .rays import Scan, Target
from .scene import FloatArray, Scene

__all__ = ["Effect", "Report", "Shot", "View", "Weather", "shoot", "study_sensor"]

# Fog's waveform is looked at up to here: its maximum lies within a few metres of full overlap.
FOG_TO_M = 14.0
# Relative standard deviation of a reported intensity, besides that of its photons (order of magnitude).
READING_SPREAD = 0.02
# From frame to frame: scale of the intensities and start of the clock of a whole frame (orders of magnitude; without
# them a mean over 10,000 beams would show a hundredth of a decibel). Detection does not know of them.
SCALE_SPREAD, CLOCK_SPREAD_M = 0.015, 0.004
# Particles that send back less than this share of the threshold are not listed.
FLOOR_SHARE = 0.5
NO_ECHO, TARGET, PARTICLE, OTHER = 0, 1, 2, 3


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


@dataclass(frozen=True)
class Weather:
    """``clear``, ``rain`` or ``snow`` of a rate in mm/h, or ``fog`` of a visibility in m."""

    kind: str = "clear"
    amount: float = 0.0


@dataclass(frozen=True)
class View:
    """What each beam of a scan meets, with the sensor.

    Args:
        scan: directions.
        target: first surfaces.
        sensor: link budget.
        scene: what stands there.
    """

    scan: Scan
    target: Target
    sensor: Lidar
    scene: Scene

    @property
    def beams(self) -> int:
        """Number of beams."""
        return len(self.target.range_m)


@dataclass
class Shot:
    """Frames that are being taken: what an effect may change before the echoes are computed.

    Args:
        view: scene and sensor.
        weather: as it truly is.
        time_s: ``(F,)``.
        rng: of the effects' draws.
        drops_rng, target_rng, echo_rng, report_rng: of the particles, and of the noise of targets, of other echoes and
            of what is reported: apart, so that an effect leaves the draws of the others where they were.
    """

    view: View
    weather: Weather
    time_s: FloatArray
    rng: np.random.Generator
    drops_rng: np.random.Generator
    target_rng: np.random.Generator
    echo_rng: np.random.Generator
    report_rng: np.random.Generator
    extra_divergence_rad: float = 0.0
    extinction_factor: float = 1.0
    density: FloatArray = field(init=False)
    extent_m: float = np.inf
    extent_edge_m: float = 0.0
    highest_particle_gain: float = 1.0
    threshold_gain: FloatArray = field(init=False)
    last_probability: float = 0.0
    blind_m: float = 0.0
    blind_edge_m: float = 0.3

    def __post_init__(self) -> None:
        self.density = np.ones(len(self.time_s))
        self.threshold_gain = np.ones((1, 1))

    @property
    def sensor(self) -> Lidar:
        """The sensor."""
        return self.view.sensor

    @cached_property
    def air(self) -> Air:
        """Optics of the weather."""
        return air_of(self.weather.kind, self.weather.amount, self.sensor.wavelength_nm)

    @property
    def shape(self) -> tuple[int, int]:
        """Frames and beams."""
        return len(self.time_s), self.view.beams

    def density_at(self, range_m: FloatArray) -> FloatArray:
        """Share of the weather that fills the space at a range: falls around the extent."""
        if not np.isfinite(self.extent_m):
            return np.ones_like(range_m)
        if self.extent_edge_m == 0.0:
            return (range_m <= self.extent_m).astype(np.float64)
        return 0.5 - 0.5 * np.tanh(0.5 * (range_m - self.extent_m) / self.extent_edge_m)

    def near_gain(self, range_m: FloatArray) -> FloatArray:
        """Power gain of a receiver that wakes up late: -30 dB inside the blind zone, with a soft edge in dB."""
        if self.blind_m == 0.0:
            return np.ones_like(range_m)
        return np.asarray(10.0 ** (-1.5 * (1.0 - np.tanh((range_m - self.blind_m) / self.blind_edge_m))))

    def path_m(self, range_m: FloatArray) -> FloatArray:
        """Length of the path through full weather: the integral of `density_at`."""
        if not np.isfinite(self.extent_m):
            return range_m
        if self.extent_edge_m == 0.0:
            return np.minimum(range_m, self.extent_m)
        edge = self.extent_edge_m
        beyond = np.logaddexp(0.0, (range_m - self.extent_m) / edge) - np.logaddexp(0.0, -self.extent_m / edge)
        return np.asarray(range_m - edge * beyond)

    def depth(self, frame: np.ndarray, range_m: FloatArray) -> FloatArray:
        """One-way optical depth in a frame to a range."""
        alpha = self.air.extinction_per_m * self.extinction_factor * self.density[frame]
        return np.asarray(alpha * self.path_m(range_m))


@dataclass
class Echoes:
    """Echoes before detection; ``target`` is dense ``(F, N)``, ``others`` is a list, ``gain`` of each.

    Args:
        target_m, target: range and signal over the system constant, 1/(m^2 sr), 0 where there is none.
        frame, beam, range_m, signal, kind: of all other echoes, ``(K,)``.
    """

    target_m: FloatArray
    target: FloatArray
    frame: np.ndarray
    beam: np.ndarray
    range_m: FloatArray
    signal: FloatArray
    kind: np.ndarray

    def add(self, frame: np.ndarray, beam: np.ndarray, range_m: FloatArray, signal: FloatArray, kind: int) -> None:
        """Further echoes."""
        self.frame = np.concatenate([self.frame, frame])
        self.beam = np.concatenate([self.beam, beam])
        self.range_m = np.concatenate([self.range_m, range_m])
        self.signal = np.concatenate([self.signal, signal])
        self.kind = np.concatenate([self.kind, np.full(len(frame), kind)])


@dataclass
class Report:
    """What is reported, ``(F, N)`` each: range (0 without return), intensity, kind of the echo and its signal."""

    range_m: FloatArray
    intensity: FloatArray
    kind: np.ndarray
    signal: FloatArray

    def drop(self, lost: np.ndarray) -> None:
        """Take returns away."""
        self.range_m = np.where(lost, 0.0, self.range_m)
        self.intensity = np.where(lost, 0.0, self.intensity)
        self.kind = np.where(lost, NO_ECHO, self.kind)


class Effect:
    """Something that the sensor or the weather does and the base model does not."""

    def prepare(self, shot: Shot) -> None:
        """Change air, optics or receiver."""

    def on_view(self, view: View) -> View:
        """Change what the beams meet."""
        return view

    def on_echoes(self, shot: Shot, echoes: Echoes) -> None:
        """Change or add echoes."""

    def on_report(self, shot: Shot, report: Report) -> None:
        """Change what is reported."""


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
    return _finish(shot, report)


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
    drops = draw_drops(shot.air, sensor, shot.view.beams, shot.density, _floor(shot), divergence, shot.drops_rng)
    keep = drops.range_m < shot.view.target.range_m[drops.beam]
    if np.isfinite(shot.extent_m):
        keep &= shot.drops_rng.random(len(keep)) < shot.density_at(drops.range_m)
    drops = drops.only(keep)
    loss = np.exp(-2.0 * shot.depth(drops.frame, drops.range_m))
    return Drops(drops.frame, drops.beam, drops.range_m, drops.signal * loss * shot.near_gain(drops.range_m))


def _fog(shot: Shot) -> tuple[FloatArray, FloatArray]:
    nodes = np.arange(shot.sensor.near_start_m, FOG_TO_M, NODE_M)
    every = np.arange(shot.shape[0])[:, None]
    depth = shot.depth(every, nodes[None])[:, None, :]
    density = (shot.density[:, None] * shot.density_at(nodes[None]))[:, None, :]
    gain = shot.near_gain(nodes)[None, None, :]
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
