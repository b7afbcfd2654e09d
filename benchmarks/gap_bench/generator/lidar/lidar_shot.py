"""What one frame of a scanning LiDAR is made of, and where a hidden effect may change it.

A hidden effect changes a `Shot` at three places: `Effect.prepare` (air, optics, receiver), `Effect.on_echoes` (each
echo's power), `Effect.on_report` (what the firmware gives out).
`Effect.on_output` changes what is written in the end, with its noise.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from torchweather.sensors import Lidar

from .particles import Air, air_of
from .rays import Scan, Target
from .scene import FloatArray, Scene

NO_ECHO, TARGET, PARTICLE, OTHER = 0, 1, 2, 3


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
        beam_density: ``(N,)`` number of particles in a beam over that of the weather; ``None`` is 1.
        near_full_m, near_power: of the share of the light of particles that the receiver takes (`particle_gain`).
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
    near_full_m: float = 1.0
    near_power: float = 0.0
    beam_density: FloatArray | None = None

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

    def particle_gain(self, range_m: FloatArray) -> FloatArray:
        """Share of the light of particles that the receiver takes, beside the near-range response of the sensor."""
        return np.asarray(np.minimum(range_m / self.near_full_m, 1.0) ** self.near_power)

    def path_m(self, range_m: FloatArray) -> FloatArray:
        """Length of the path through full weather: the integral of `density_at`."""
        if not np.isfinite(self.extent_m):
            return range_m
        if self.extent_edge_m == 0.0:
            return np.minimum(range_m, self.extent_m)
        edge = self.extent_edge_m
        beyond = np.logaddexp(0.0, (range_m - self.extent_m) / edge) - np.logaddexp(0.0, -self.extent_m / edge)
        return np.asarray(range_m - edge * beyond)

    def depth(self, frame: np.ndarray, range_m: FloatArray, beam: np.ndarray | slice = slice(None)) -> FloatArray:
        """One-way optical depth in a frame to a range, in some beams."""
        alpha = self.air.extinction_per_m * self.extinction_factor * self.density[frame]
        if self.beam_density is not None:
            alpha = alpha * self.beam_density[beam]
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

    def on_output(self, report: Report) -> None:
        """Change what is written, with its noise."""
