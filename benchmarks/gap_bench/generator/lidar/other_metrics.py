"""The gap on metrics that no search uses: distributions of ranges and intensities, and numbers of returns.

The measured frames of each held-out condition against simulated ones, before and after what was found is added, in
units of the simulator's distance from itself. Code of its own, with nothing of the search's statistics; of the library
it takes the study and the transform. It knows no truth.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import torch
from numpy.typing import NDArray

from torchweather.gap import GapReport
from torchweather.gap.study.study import Condition, Study
from torchweather.sensors import Lidar
from torchweather.stages import ToEnergy
from torchweather.transforms import LidarWeather

__all__ = ["METRICS", "distances", "other_metrics"]

Floats = NDArray[np.float64]

METRICS = (
    *("range_wasserstein_m", "range_bias_m", "range_scatter_m"),
    *("intensity_wasserstein", "intensity_bias", "intensity_scatter"),
    *("returns", "particles", "lost"),
)
"""Wasserstein distance, bias and scatter of the double validation metric, and differences of mean numbers."""

# A floor is not below these: one of the sensor's own steps of range, m, and of intensity, and one beam.
LEAST = np.array([1e-3] * 3 + [1e-4] * 3 + [1.0] * 3)
# Share of frames in which the margin's law may lift the signal of a beam that is kept.
LIFTED = 0.02
# Levels at which two distributions are compared.
LEVELS = (np.arange(1000) + 0.5) / 1000
# A return this much nearer than the surface is a particle's, m.
NEARER_M = 1.0
# Frames simulated from each clear frame, and draws of as many of them as there are clear frames.
FROM_EACH, DRAWS = 4, 16
# Errors of the weather's record that are tried, in its stated standard deviations.
RECORD_ERRORS = (-2.0, -1.5, -1.0, -0.5, 0.0, 0.5, 1.0, 1.5, 2.0)
# Ranges, intensities and numbers: of the metrics about so many tell something of their own.
INDEPENDENT = 3
# Seeds of the frames to which the record is fitted, and of those that are compared.
FITTED, COMPARED = 0, 1


def other_metrics(study: Study, report: GapReport, seed: int) -> dict[str, dict[str, float]]:
    """The held-out gap on ``METRICS``, before and after the effects of a report are added.

    The error of the weather's record is fitted on each side, condition by condition, to these same metrics with its
    stated standard deviation as prior, on frames of other seeds than those that are compared.

    Args:
        study: of a LiDAR.
        report: of the study.
        seed: of the simulation.

    Returns:
        ``before`` and ``after``, the same where nothing was found: metric to its root mean square over the held-out
        conditions, in units of the simulator's distance from itself. A perfect model has about 1.
    """
    scenes = {name: _Clear(study, name) for name in study.scenes}
    held = [one for one in study.holdout if one.weather is not None]
    found = {}
    for side in ("before", "after"):
        if side == "after" and not report.effects:
            found[side] = found["before"]
            break
        gaps = [
            _against(study, condition, scenes[condition.scene], report, side, [seed, number])
            for number, condition in enumerate(held)
        ]
        values = np.sqrt((np.stack(gaps) ** 2).mean(0))
        found[side] = {name: float(f"{value:.4g}") for name, value in zip(METRICS, values, strict=True)}
    return found


class _Clear:
    """The clear frames of a scene, flat, and what stands there.

    A clear point has at least the signal of the threshold and a margin drawn from an exponential law (``PHYSICS.md``
    5.3): near the threshold that law lifts the signal that the intensity tells. Beams that it would lift in more than
    ``LIFTED`` of frames are left out, of simulated and of measured frames, and so are those that flicker.
    """

    def __init__(self, study: Study, scene: str) -> None:
        assert isinstance(study.sensor, Lidar)
        clear = study.scenes[scene].clear
        frames = [clear[number] for number in range(len(clear))]
        self.range_m, self.intensity = (
            torch.stack([torch.from_numpy(np.asarray(frame[name], dtype=np.float32)).reshape(-1) for frame in frames])
            for name in ("range_m", "intensity")
        )
        seen = self.range_m > 0
        to_energy = ToEnergy(replace(study.sensor, directions=None))
        signal = to_energy.signal_of_intensity(self.intensity, self.range_m).mean(0)
        least = study.sensor.threshold_per_m2_sr * 10.0 ** (-0.1 * study.sensor.margin_db * np.log(LIFTED))
        surface, empty = seen.all(0) & (signal > least), ~seen.any(0)
        self.kept = (surface | empty).numpy()
        self.surface_m = torch.where(surface, self.range_m.median(0).values, 0.0).numpy()[self.kept]
        geometry = study.scenes[scene].geometry
        self.geometry = {
            name: torch.from_numpy(np.asarray(geometry[name], dtype=np.float32)).reshape(1, -1)
            for name in ("cos_incidence", "up")
            if name in geometry
        }

    def __len__(self) -> int:
        return len(self.range_m)

    def facts(self, range_m: Floats, intensity: Floats) -> list[_Facts]:
        """Of frames ``(F, N)`` each."""
        return [
            _Facts(self.surface_m, one[self.kept], other[self.kept])
            for one, other in zip(range_m, intensity, strict=True)
        ]


class _Facts:
    """What the metrics look at in a frame: its returns, and the numbers of returns, particles and lost surfaces.

    Args:
        surface_m: ``(B,)`` of the beams that are kept, 0 where nothing stands.
        range_m, intensity: ``(B,)`` of the frame.
    """

    def __init__(self, surface_m: Floats, range_m: Floats, intensity: Floats) -> None:
        seen, there = range_m > 0, surface_m > 0
        particle = seen & (~there | (range_m < surface_m - NEARER_M))
        self.range_m, self.intensity = range_m[seen], intensity[seen]
        self.numbers = np.array([seen.sum(), particle.sum(), (there & ~seen).sum()], dtype=np.float64)


class _Side:
    """Levels of the distributions of some frames together, and their mean numbers."""

    def __init__(self, frames: Sequence[_Facts]) -> None:
        self.range_m, self.intensity = (
            _levels(np.concatenate([getattr(frame, name) for frame in frames])) for name in ("range_m", "intensity")
        )
        self.numbers = np.mean([frame.numbers for frame in frames], axis=0)


def _levels(values: Floats) -> Floats:
    """The values at ``LEVELS`` of their distribution; 0 without any."""
    if not len(values):
        return np.zeros(len(LEVELS))
    ascending = np.sort(values.astype(np.float32)).astype(np.float64)  # single precision sorts faster
    return np.asarray(ascending[(LEVELS * len(ascending)).astype(np.int64)])


def distances(one: _Side, other: _Side) -> Floats:
    """``METRICS`` between two sides, ``(M,)``, none negative.

    The area between two distribution functions is the mean distance of their levels (the Wasserstein distance); with
    the difference of the medians taken off first it is the scatter of the double validation metric.
    """
    found: list[float] = []
    for name in ("range_m", "intensity"):
        apart = getattr(one, name) - getattr(other, name)
        middle = len(LEVELS) // 2
        bias = 0.5 * (apart[middle - 1] + apart[middle])
        found += [np.abs(apart).mean(), abs(bias), np.abs(apart - bias).mean()]
    return np.array([*found, *np.abs(one.numbers - other.numbers)])


def _against(
    study: Study, condition: Condition, clear: _Clear, report: GapReport, side: str, key: Sequence[int]
) -> Floats:
    """Distances of a condition's frames from simulated ones, over those of simulated ones from themselves, ``(M,)``."""
    frames = [condition.frames[number] for number in range(len(condition.frames))]
    arrays = [np.stack([np.asarray(frame[name]).reshape(-1) for frame in frames]) for name in ("range_m", "intensity")]
    measured = _Side(clear.facts(*arrays))
    rng = np.random.default_rng([*key, 2])
    # The record's error: the least mean square, with one frame from each clear frame at each error that is tried.
    pools = {
        error: _pool(study, condition, clear, report, side, error, 1, [*key, FITTED])
        for error in (RECORD_ERRORS if condition.rel_sd else (0.0,))
    }
    unit = _unit(_from_itself(pools[0.0], clear, len(frames), rng))

    def cost(error: float) -> float:
        apart = distances(_Side([from_one[0] for from_one in pools[error]]), measured)
        return float(INDEPENDENT * ((apart / unit) ** 2).mean() + error**2)

    best = min(pools, key=cost)
    pool = _pool(study, condition, clear, report, side, best, FROM_EACH, [*key, COMPARED])
    unit = _unit(_from_itself(pool, clear, len(frames), rng))
    each = [[from_one[rng.integers(FROM_EACH)] for from_one in pool] for _ in range(DRAWS)]
    apart = np.stack([distances(_Side(chosen), measured) for chosen in each])
    return np.asarray(np.sqrt((apart**2).mean(0)) / unit)


def _unit(own: Floats) -> Floats:
    """Root mean square of each metric."""
    return np.asarray(np.maximum(np.sqrt((own**2).mean(0)), LEAST))


def _from_itself(pool: Sequence[Sequence[_Facts]], clear: _Clear, frames: int, rng: np.random.Generator) -> Floats:
    """Distances ``(DRAWS, M)`` of as many frames as were measured from as many as there are clear ones.

    Both start from clear frames drawn with replacement. A sample of K drawn so scatters by (K - 1) / K less in square
    than what it was drawn from.
    """
    count = len(clear)

    def drawn(number: int) -> _Side:
        chosen = [pool[k] for k in rng.integers(count, size=number)]
        return _Side([from_one[rng.integers(len(from_one))] for from_one in chosen])

    found = np.stack([distances(drawn(count), drawn(frames)) for _ in range(DRAWS)])
    return np.asarray(found * np.sqrt(count / max(count - 1, 1)))


def _pool(
    study: Study,
    condition: Condition,
    clear: _Clear,
    report: GapReport,
    side: str,
    error: float,
    from_each: int,
    key: Sequence[int],
) -> list[list[_Facts]]:
    """Simulated frames from each clear frame, with the record off by so many of its standard deviations."""
    assert isinstance(study.sensor, Lidar)
    assert condition.weather is not None
    weather_intensity = condition.weather.intensity_name
    amount = float(getattr(condition.weather, weather_intensity)) * (1.0 + error * condition.rel_sd)
    weather = replace(condition.weather, **{weather_intensity: amount})
    transform = LidarWeather(weather, replace(study.sensor, directions=None))
    if side == "after":
        transform = report.apply(transform)
    direction = torch.from_numpy(np.asarray(study.beams["direction"], dtype=np.float32))
    beams = direction.reshape(-1, 3)
    start = torch.arange(len(clear)).repeat_interleave(from_each)
    points = torch.cat([clear.range_m[start, :, None] * beams, clear.intensity[start, :, None]], -1)
    seeds = torch.from_numpy(np.random.default_rng(list(key)).integers(0, 2**62, len(start)))
    with torch.no_grad():
        state = transform.state_of(points, beams).changed(grid=tuple(direction.shape[:2]), **clear.geometry)
        out = transform.chain(state, transform.chain.draw(state, seed=seeds)).returns.points
    range_m = out[..., :3].norm(dim=-1)
    intensity = torch.where(range_m > 0, out[..., 3], 0.0)
    facts = clear.facts(range_m.numpy(), intensity.numpy())
    return [facts[first : first + from_each] for first in range(0, len(facts), from_each)]
