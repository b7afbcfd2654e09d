"""Paths that have moved: they work for one release, with a warning that gives the new one."""

from __future__ import annotations

import importlib

import pytest

from torchweather import Compose, Lidar, LidarRain, physics
from torchweather.atmosphere.weather import Rain

MOVED = [
    ("torchweather.errors", "TorchweatherError", "torchweather.core.errors"),
    ("torchweather.random", "keyed_stream", "torchweather.core.random"),
    ("torchweather.distributions", "Choice", "torchweather.core.distributions"),
    ("torchweather.weather", "parse_weather", "torchweather.atmosphere.weather"),
    ("torchweather.sweep", "parse_levels", "torchweather.evaluation.sweep"),
    ("torchweather.robustness", "run_robustness", "torchweather.evaluation.robustness"),
    ("torchweather.augment", "augment", "torchweather.datasets.augment"),
    ("torchweather.transforms.recipes", "load_recipe", "torchweather.recipes"),
    ("torchweather.stages.effects_lidar", "LidarWindowLoss", "torchweather.lidar.effects.all"),
    ("torchweather.stages.effects_camera", "CameraExposureGain", "torchweather.camera.effects.all"),
    ("torchweather.stages.effects_radar", "RadarWetRadome", "torchweather.radar.effects.all"),
    ("torchweather.stages.patchy_air", "PatchField", "torchweather.atmosphere.density_field"),
    ("torchweather.stages.particle_veil", "ParticleVeil", "torchweather.camera.particles.veil"),
    ("torchweather.stages.empirical", "Empirical", "torchweather.lidar.effects.empirical"),
    ("torchweather.stages.effects", "Effect", "torchweather.pipeline.effect"),
    ("torchweather.sensors.scan", "recover_ring", "torchweather.lidar.scan"),
    ("torchweather.robustness.decoders", "decode_boxes", "torchweather.evaluation.robustness.decoders"),
    ("torchweather.gap.study", "Study", "torchweather.gap.study.study"),
    ("torchweather.gap.embedded_study", "embedded_study", "torchweather.gap.study.embedded"),
    ("torchweather.gap.hidden_study", "hidden_study", "torchweather.gap.study.hidden"),
    ("torchweather.gap.scan_grid", "scan_frame", "torchweather.gap.study.scan_grid"),
    ("torchweather.gap.simulation", "simulate", "torchweather.gap.study.simulation"),
    ("torchweather.gap.adapters", "study_from_folders", "torchweather.gap.study.folders"),
    ("torchweather.gap.validation", "validate", "torchweather.evaluation.validation.run"),
    ("torchweather.io", "Boxes", "torchweather.datasets"),
    ("torchweather.io", "read_kitti_points", "torchweather.datasets"),
    ("torchweather.io", "CarlaRig", "torchweather.datasets"),
    ("torchweather.io", "Collate", "torchweather.compose"),
    ("torchweather.gap", "validate", "torchweather.evaluation.validation"),
    ("torchweather.transforms", "Compose", "torchweather.compose"),
]


@pytest.mark.parametrize(("old", "name", "new"), MOVED)
def test_an_old_path_works_and_says_the_new_one(old: str, name: str, new: str) -> None:
    module = importlib.import_module(old)
    with pytest.warns(DeprecationWarning, match=rf"{old}.{name} has moved to {new}.{name}; the old path goes"):
        found = getattr(module, name)
    assert found is getattr(importlib.import_module(new), name)


def test_a_name_that_never_was_is_no_name() -> None:
    for old in ("torchweather.errors", "torchweather.transforms"):
        with pytest.raises(AttributeError, match="has no attribute 'nothing'"):
            importlib.import_module(old).nothing  # noqa: B018


def test_old_names_of_the_intensity_work_with_a_warning() -> None:
    with pytest.warns(DeprecationWarning, match="Weather.knob is Weather.intensity now"):
        assert Rain(rate_mm_per_h=10).knob == 10
    with pytest.warns(DeprecationWarning, match="KnobTable is torchweather.physics.InterpolationTable now"):
        assert physics.KnobTable is physics.InterpolationTable
    with pytest.raises(AttributeError, match="nothing"):
        physics.nothing  # noqa: B018


def test_the_old_name_of_the_specifications_of_a_sample_works_with_a_warning() -> None:
    compose = Compose({"points": LidarRain(Rain(10.0), Lidar.preset("velodyne-hdl-32e"))})
    with pytest.warns(DeprecationWarning, match="Compose.plans is Compose.specs now"):
        assert compose.plans is compose.specs
