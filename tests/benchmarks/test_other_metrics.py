"""The held-out gap on metrics that no search uses."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from scipy.stats import wasserstein_distance

from benchmarks.gap_bench.generator.lidar.design import Size, draw_design, study_of
from benchmarks.gap_bench.generator.lidar.effects import CATALOGUE
from benchmarks.gap_bench.generator.lidar.other_metrics import METRICS, _Clear, _Facts, _Side, distances, other_metrics
from torchweather.metrics.double_validation import double_validation
from torchweather.stages import effect_from_dict
from torchweather.transforms import LidarWeather

SIZE = Size(rings=24, columns=128, scenes=1, clear_frames=4, rates=3, frames=4)
LOSS_DB = 1.2


class _Found:
    """Stands for a report: what it applies."""

    def __init__(self, *effects):
        self.effects = [effect_from_dict(effect) for effect in effects]

    def apply(self, model):
        return LidarWeather(model.weather, model.sensor, effects=self.effects)


def _side(range_m, intensity):
    return _Side([_Facts(np.full(len(range_m), 500.0), range_m, intensity)])


def test_distances_are_those_of_wasserstein_and_of_the_double_validation_metric():
    rng = np.random.default_rng(1)
    one, other = rng.gamma(3.0, 5.0, (2, 6000)) + np.array([[1.0], [2.5]])
    dim, bright = rng.gamma(2.0, 0.1, (2, 6000)) * np.array([[1.0], [1.3]])
    found = dict(zip(METRICS, distances(_side(one, dim), _side(other, bright)), strict=True))
    for name, pair in (("range", (one, other)), ("intensity", (dim, bright))):
        wanted = double_validation(*(torch.from_numpy(values) for values in pair))
        unit = "_m" if name == "range" else ""
        # 1000 levels of 6000 values: the tails beyond the last level are cut.
        assert found[f"{name}_wasserstein{unit}"] == pytest.approx(wasserstein_distance(*pair), rel=0.01)
        assert found[f"{name}_bias{unit}"] == pytest.approx(abs(float(wanted.bias)), rel=0.01)
        assert found[f"{name}_scatter{unit}"] == pytest.approx(float(wanted.scatter), rel=0.02)


def test_numbers_of_returns_particles_and_lost_surfaces():
    surface_m = np.array([20.0, 20.0, 20.0, 20.0, 0.0, 0.0])
    # kept, lost, a particle in front, a surface that is a little nearer, a particle before the sky, nothing
    facts = _Facts(surface_m, np.array([20.0, 0.0, 5.0, 19.5, 7.0, 0.0]), np.ones(6))
    assert facts.numbers.tolist() == [4.0, 2.0, 1.0]


def test_the_true_effect_brings_the_gap_to_its_floor_and_nothing_added_leaves_it():
    rng = np.random.default_rng(2)
    design = draw_design(rng, "rain", SIZE, "common", 1.0)
    loss = CATALOGUE["lidar.window_loss"]({"loss_db": LOSS_DB})
    loss.film = {"rain": 1e-6}  # the same loss at any rate, as the library's
    study = study_of(design, (loss,), rng)
    found = other_metrics(study, _Found({"effect": "lidar.window_loss", "loss_db": LOSS_DB}), 3)
    assert list(found["before"]) == list(METRICS)
    # The mean intensity is off by 24 %; the scale of a frame scatters by 1.5 %, here over 4 frames.
    assert found["before"]["intensity_wasserstein"] > 8.0
    assert found["after"]["intensity_wasserstein"] < 2.0
    assert np.sqrt(np.mean(np.square(list(found["after"].values())))) < 2.0
    same = other_metrics(study, _Found(), 3)
    assert same["after"] == same["before"] == found["before"]


def test_frames_of_a_sensor_without_margin_are_kept_nearer_to_the_threshold():
    rng = np.random.default_rng(4)
    study = study_of(draw_design(rng, "snow", replace(SIZE, frames=1), "common", 0.0), (), rng)
    surely = replace(study, sensor=replace(study.sensor, margin_db=1e-3))
    assert _Clear(surely, "s0").kept.sum() > _Clear(study, "s0").kept.sum() > 0
