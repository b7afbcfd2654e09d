"""Frames of a radar in weather: amplitudes of known targets with receiver noise, a threshold, and a list.

A hidden effect changes a `Shot` at two places: `Effect.on_path` (powers, floor, threshold, further echoes) and
`Effect.on_report` (what the list says).

References:
    PHYSICS.md 6.2, 6.5-6.7.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import lru_cache

import numpy as np

from torchweather.physics import (
    default_fog,
    fog_attenuation_db_per_km,
    marshall_palmer,
    particle_attenuation_db_per_km,
    rain_attenuation_p838_db_per_km,
    reflectivity_weighted_fall_speed,
    sekhon_srivastava,
)
from torchweather.sensors import Radar

__all__ = ["Effect", "Report", "Shot", "Targets", "Weather", "draw_targets", "pattern_db", "shoot", "study_radar"]

Floats = np.ndarray

FLOOR_DBM = -125.0  # of a list that a CFAR made, far above the thermal one
SNR_DB = 12.0
# From frame to frame: transmit power and floor; least errors of a reading (orders of magnitude).
POWER_WOBBLE_DB, FLOOR_WOBBLE_DB, RANGE_READ_M, SPEED_READ_M_PER_S = 0.1, 0.04, 0.01, 0.02
FALSE_ALARMS = 1.5  # of a frame
# Cross section, dBsm, and its spread; whether its parts move against each other (Swerling's case 1).
CLASSES = ((12.0, 5.0, False), (0.0, 4.0, False), (-3.0, 3.0, True), (2.0, 5.0, True))
SHARES = (0.35, 0.35, 0.12, 0.18)
NEAR_M, FAR_M = 6.0, 130.0


def study_radar() -> Radar:
    """The radar of all studies."""
    return Radar.preset("imaging-77ghz", noise_floor_db=FLOOR_DBM, detection_snr_db=SNR_DB)


@dataclass(frozen=True)
class Weather:
    """``clear``, ``rain`` or ``snow`` of a rate in mm/h, or ``fog`` of a visibility in m."""

    kind: str = "clear"
    amount: float = 0.0


@lru_cache(maxsize=4096)
def attenuation_db_per_km(weather: Weather) -> float:
    """One way, at 77 GHz."""
    if weather.kind == "rain":
        return float(rain_attenuation_p838_db_per_km(weather.amount, 77.0, polarisation_tilt_rad=0.0))
    if weather.kind == "snow":
        return float(particle_attenuation_db_per_km(sekhon_srivastava(weather.amount), 77.0, temperature_c=-5.0))
    if weather.kind == "fog":
        water = default_fog(weather.amount).liquid_water_g_per_m3()
        return float(fog_attenuation_db_per_km(water, 77.0, temperature_c=10.0))
    return 0.0


@lru_cache(maxsize=4096)
def reflectivity(weather: Weather) -> tuple[float, float, float]:
    """Of rain or snow, m^2/m^3, and mean and standard deviation of the fall speed, m/s."""
    drops = marshall_palmer(weather.amount) if weather.kind == "rain" else sekhon_srivastava(weather.amount)
    temperature = 10.0 if weather.kind == "rain" else -5.0
    eta, mean, std = (float(one) for one in reflectivity_weighted_fall_speed(drops, 77.0, temperature_c=temperature))
    return eta, mean, std


def pattern_db(radar: Radar, azimuth_rad: Floats, elevation_rad: Floats) -> Floats:
    """One-way gain over that at boresight: Gaussian in both angles, 30 dB at most."""
    across = np.degrees(azimuth_rad) / radar.azimuth_beamwidth_deg
    up = np.degrees(elevation_rad) / radar.elevation_beamwidth_deg
    return -np.minimum(12.041 * (across**2 + up**2), 30.0)


@dataclass(frozen=True)
class Targets:
    """What stands there, ``(N,)`` each."""

    range_m: Floats
    azimuth_rad: Floats
    elevation_rad: Floats
    speed_m_per_s: Floats
    target_class: Floats
    rcs_dbsm: Floats

    @property
    def geometry(self) -> dict[str, Floats]:
        """As a study has it."""
        names = ("range_m", "azimuth_rad", "elevation_rad", "speed_m_per_s", "target_class")
        return {name: getattr(self, name) for name in names}


def draw_targets(rng: np.random.Generator, number: int) -> Targets:
    """Targets of four classes, those too weak to be seen in clear air left out."""
    radar = study_radar()
    kept: list[np.ndarray] = []
    while sum(len(one) for one in kept) < number:
        classes = rng.choice(len(CLASSES), p=SHARES, size=number)
        mean, spread = (np.array([row[k] for row in CLASSES])[classes] for k in (0, 1))
        rows = np.stack(
            [
                np.exp(rng.uniform(np.log(NEAR_M), np.log(FAR_M), number)),
                rng.uniform(-0.7, 0.7, number),
                rng.uniform(-0.1, 0.1, number),
                np.where(rng.random(number) < 0.5, 0.0, rng.uniform(-2.8, 2.8, number)),
                classes.astype(np.float64),
                mean + spread * rng.standard_normal(number),
            ],
            1,
        )
        snr = _power_dbm(radar, Targets(*rows.T)) - FLOOR_DBM
        kept.append(rows[snr > SNR_DB - 1.0])
    return Targets(*np.concatenate(kept)[:number].T)


def _power_dbm(radar: Radar, targets: Targets) -> Floats:
    """Of the radar equation, boresight gains squared and the wavelength in one constant (PHYSICS.md 6.2)."""
    wavelength_m = 299792458.0 / 77e9
    constant = 12.0 + 2.0 * 12.0 + 20.0 * np.log10(wavelength_m) - 30.0 * np.log10(4.0 * np.pi)
    two_way = 2.0 * pattern_db(radar, targets.azimuth_rad, targets.elevation_rad)
    return np.asarray(constant + targets.rcs_dbsm - 40.0 * np.log10(targets.range_m) + two_way)


@dataclass
class Report:
    """What is reported: ``(F, N)`` of targets, NaN where lost, and others, ``(M, 6)`` with their frames ``(M,)``."""

    power_db: Floats
    range_m: Floats
    speed_m_per_s: Floats
    floor_db: Floats
    clutter: Floats
    clutter_frame: Floats

    def drop(self, lost: Floats) -> None:
        """Take targets away."""
        for name in ("power_db", "range_m", "speed_m_per_s"):
            setattr(self, name, np.where(lost, np.nan, getattr(self, name)))

    def frames(self) -> list[dict[str, Floats]]:
        """As a study has them."""
        return [
            {
                "power_db": self.power_db[k],
                "range_m": self.range_m[k],
                "speed_m_per_s": self.speed_m_per_s[k],
                "noise_floor_db": np.array(self.floor_db[k]),
                "clutter": self.clutter[self.clutter_frame == k],
            }
            for k in range(len(self.floor_db))
        ]


@dataclass
class Shot:
    """Frames that are being taken: what an effect may change before the detection.

    Args:
        radar: of the study.
        targets: what stands there.
        weather: as it truly is.
        number: ``(F,)`` of each frame in its recording.
        rng: of the effects' draws.
    """

    radar: Radar
    targets: Targets
    weather: Weather
    number: Floats
    rng: np.random.Generator
    per_km: float = field(init=False)
    gain_db: Floats = field(init=False)
    floor_db: Floats = field(init=False)
    threshold_db: Floats = field(init=False)
    clutter: list[tuple[Floats, Floats]] = field(default_factory=list)

    def __post_init__(self) -> None:
        self.per_km = attenuation_db_per_km(self.weather)
        self.gain_db = np.zeros(self.shape)
        self.floor_db = np.full(len(self.number), FLOOR_DBM)
        self.threshold_db = np.full(self.shape, SNR_DB)

    @property
    def shape(self) -> tuple[int, int]:
        """Frames and targets."""
        return len(self.number), len(self.targets.range_m)


class Effect:
    """Something that the radar or the weather does and the base model does not."""

    def on_path(self, shot: Shot) -> None:
        """Change powers, floor or threshold, or list more echoes."""

    def on_report(self, shot: Shot, report: Report) -> None:
        """Change what is reported."""


def shoot(
    radar: Radar,
    targets: Targets,
    weather: Weather,
    effects: tuple[Effect, ...],
    number: Floats,
    rng: np.random.Generator,
) -> Report:
    """Frames in a weather with effects, which act in their order.

    Args:
        radar: of the study.
        targets: what stands there.
        weather: as it truly is.
        effects: hidden ones.
        number: ``(F,)`` of each frame in its recording.
        rng: draws.
    """
    own, target_rng, noise_rng, error_rng, false_rng = rng.spawn(5)
    shot = Shot(radar, targets, weather, np.asarray(number, dtype=np.float64), own)
    for effect in effects:
        effect.on_path(shot)
    moving = np.array([row[2] for row in CLASSES])[targets.target_class.astype(int)]
    swerling = np.where(moving, target_rng.standard_exponential(shot.shape), 1.0)
    wobble = POWER_WOBBLE_DB * target_rng.standard_normal((len(shot.number), 1))
    loss = 2e-3 * shot.per_km * targets.range_m
    mean_db = _power_dbm(radar, targets) - loss + wobble + shot.gain_db
    # Noise of unit power is the floor.
    amplitude = np.sqrt(10.0 ** (0.1 * (mean_db - shot.floor_db[:, None])) * swerling)
    noise = noise_rng.standard_normal((2, *shot.shape)) / np.sqrt(2.0)
    snr = (amplitude + noise[0]) ** 2 + noise[1] ** 2
    snr_db = 10.0 * np.log10(np.maximum(snr, 1e-12))
    error = error_rng.standard_normal((4, *shot.shape))
    blur = 1.0 / np.sqrt(2.0 * np.maximum(snr, 1.0))
    range_m = targets.range_m + radar.range_resolution_m * blur * error[0] + RANGE_READ_M * error[1]
    speed = targets.speed_m_per_s + radar.speed_resolution_m_per_s * blur * error[2] + SPEED_READ_M_PER_S * error[3]
    listed = [*shot.clutter, _false_alarms(shot, false_rng)]
    rows, frame = (np.concatenate([one[k] for one in listed]) for k in (0, 1))
    floor = shot.floor_db + FLOOR_WOBBLE_DB * false_rng.standard_normal(len(shot.number))
    report = Report(shot.floor_db[:, None] + snr_db, np.maximum(range_m, 0.0), speed, floor, rows, frame)
    report.drop(snr_db < shot.threshold_db)
    for effect in effects:
        effect.on_report(shot, report)
    return report


def _false_alarms(shot: Shot, rng: np.random.Generator) -> tuple[Floats, Floats]:
    """Noise above the threshold, anywhere."""
    count = rng.poisson(FALSE_ALARMS, len(shot.number))
    frame = np.repeat(np.arange(len(count)), count)
    total = len(frame)
    power = shot.floor_db[frame] + SNR_DB + rng.exponential(1.0, total)
    angle = [rng.uniform(-0.7, 0.7, total), rng.uniform(-0.1, 0.1, total)]
    speed = rng.uniform(-3.0, 3.0, total)
    rows = np.stack([rng.uniform(2.0, FAR_M, total), *angle, speed, power, np.zeros(total)], 1)
    return rows, frame
