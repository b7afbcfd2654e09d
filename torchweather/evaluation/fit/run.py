"""Rate or visibility of every condition of a study."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from torchweather.atmosphere.weather import Weather
from torchweather.core.arguments import check_arguments
from torchweather.core.errors import InputValueError, check_at_least, check_one_of
from torchweather.evaluation.fit import camera_light, path_line
from torchweather.evaluation.fit.laws import PathLaw
from torchweather.evaluation.fit.least_squares import fitted
from torchweather.evaluation.fit.result import ConditionFit, Estimate, WeatherFit
from torchweather.gap.sensors.camera.scene_change import with_parts_ignored
from torchweather.gap.study.study import Condition, Study

__all__ = ["fit_weather"]

Masks = Mapping[str, NDArray[np.bool_]]
Build = Callable[[Study, Condition, Any], Any]
# By the kind of a study: the models of a condition, the loss of a weather on the path, its name, the estimators, and
# the weathers whose loss alone makes the frames.
KINDS: Mapping[str, tuple[Build, Callable[[Weather, Any], float], str, tuple[str, ...], tuple[str, ...]]] = {
    "camera": (
        camera_light.camera_models,
        camera_light.camera_loss_per_m,
        "extinction_per_m",
        camera_light.ESTIMATORS,
        ("fog",),
    ),
    "lidar": (
        path_line.lidar_models,
        path_line.lidar_loss_per_m,
        "extinction_per_m",
        path_line.ESTIMATORS,
        ("fog", "rain", "snow"),
    ),
    "radar": (
        path_line.radar_models,
        path_line.radar_loss_db_per_km,
        "attenuation_db_per_km",
        path_line.ESTIMATORS,
        ("fog", "rain", "snow"),
    ),
}


def fit_weather(
    study: Study,
    *,
    estimators: Sequence[str] | None = None,
    mask: NDArray[np.bool_] | Masks | None = None,
    bootstrap: int = 400,
    seed: int = 0,
    ignore_parts: Sequence[str] = (),
) -> WeatherFit:
    """Fit the rate or visibility of every condition to its frames.

    The recorded value is used for the laws of the weather (kind, sizes) and as a start alone. Several estimators stand
    side by side, since recordings differ from any of their models; where they disagree, the spread between them tells
    more than the interval of one.

    Args:
        study: of a camera in fog, a LiDAR with intensities or a radar with targets such as corner reflectors.
        estimators: names; ``None``: all of the study's kind.

            - LiDAR, radar: ``slope`` (loss over the range, with an offset alike at all ranges such as a wet window) and
              ``no_offset`` (the same without).
            - Camera: ``contrast`` (differences of dark and bright at one depth: airlight cancels), ``all_light``
              (airlight of each colour fitted), ``sky_airlight`` (that of the clear frames' sky) and
              ``measured_airlight`` (that of the condition, at the exposure of its own frames). All fit a gain of the
              exposure, unless the condition states its ``exposure_gain``.
        mask: True for pixels (beams, targets) that do not count, for all scenes or by scene; beside the ``mask`` that a
            scene's geometry has.
        bootstrap: samples of the frames; 50 or more.
        seed: of the samples.
        ignore_parts: parts of a camera's picture that do not count, ``SCENE:ROW,COLUMN`` as ``changed`` of the result
            names them; as if they were in the scene's mask.

    Returns:
        Estimates with central 90 % intervals over frames, the misfit of the residuals, and parts of a camera's scenes
        that changed.

    Raises:
        TorchweatherError: a study of links, an unknown estimator, a mask of another shape.

    Note:
        Frames count as independent. Systematic errors that all frames share (depth, dirty glass, another kind of fog)
        are not in the interval; a misfit well above 1 shows some of them.

    References:
        Koschmieder 1924; Narasimhan and Nayar, Int. J. Computer Vision 48 (2002); Klett, Applied Optics 20 (1981): the
        slope method; Efron and Tibshirani, An Introduction to the Bootstrap (1993).

    Example:
        >>> from torchweather.gap.study.embedded import embedded_study
        >>> found = fit_weather(embedded_study("radar", clear_frames=6, frames=6), bootstrap=50)
        >>> heavy = found.conditions[3]
        >>> heavy.recorded, [each.name for each in heavy.estimates]
        (50.0, ['slope', 'no_offset'])
    """
    check_arguments(
        "fit_weather(study: Study, estimators: Sequence[str] | None, bootstrap: int, seed: int, "
        "ignore_parts: Sequence[str])",
        study,
        estimators,
        bootstrap,
        seed,
        ignore_parts,
    )
    check_at_least("bootstrap", bootstrap, 50, owner="fit_weather")
    if study.kind not in KINDS:
        raise InputValueError(
            f"fit_weather: expected a study of a camera, a LiDAR or a radar; got kind {study.kind}. The rain of links "
            "is in their record; torchweather gap fits its error."
        )
    study = with_parts_ignored(study, ignore_parts, "fit_weather")
    build, loss, loss_name, known, weathers = KINDS[study.kind]
    for name in estimators or ():
        check_one_of("estimator", name, known, owner="fit_weather")
    chosen = known if estimators is None else tuple(dict.fromkeys(estimators))
    masks = _masks(study, mask)
    changed = study.study_kind.scene_changes(_with_masks(study, masks))
    conditions, left_out = [], {}
    for condition in study.conditions:
        weather = condition.weather
        if weather is None or weather.kind not in weathers:
            kind = "clear air" if weather is None else weather.kind
            left_out[condition.id] = f"{kind}; a {study.kind} fits {', '.join(weathers)}"
            continue
        if len(study.scene_of(condition).clear) < 2:
            left_out[condition.id] = "its scene has fewer than 2 clear frames"
            continue
        law = PathLaw.of(weather, lambda each: loss(each, study.sensor))
        models, why = build(study, condition, masks.get(condition.scene))
        estimates = []
        for name in chosen:
            if name not in models:
                continue
            rows, model = models[name]
            if np.isfinite(rows.measured).any(0).sum() < len(model.start) + 2:
                why[name] = f"{int(np.isfinite(rows.measured).any(0).sum())} cells for {len(model.start)} parameters"
                continue
            found = fitted(rows, model, bootstrap=bootstrap, seed=seed)
            estimates.append(
                Estimate(
                    name,
                    law.inverse(found.values[loss_name]),
                    found.values[loss_name],
                    loss_name,
                    {key: value for key, value in found.values.items() if key != loss_name},
                    found.cells,
                    found.misfit,
                    found.fits,
                )
            )
        conditions.append(
            ConditionFit(
                condition.id,
                weather.kind,
                weather.intensity_name,
                float(weather.intensity),
                len(condition.frames),
                tuple(estimates),
                {name: why[name] for name in chosen if name in why},
            )
        )
    return WeatherFit(study.kind, tuple(conditions), left_out, tuple(f"{one.what} {one.advice}" for one in changed))


def _with_masks(study: Study, masks: Masks) -> Study:
    """The study with masks in the geometry of its scenes."""
    scenes = {
        name: replace(scene, geometry={**scene.geometry, "mask": masks[name]}) if name in masks else scene
        for name, scene in study.scenes.items()
    }
    return replace(study, scenes=scenes)


def _masks(study: Study, mask: NDArray[np.bool_] | Masks | None) -> dict[str, NDArray[np.bool_]]:
    own = {name: scene.geometry["mask"] for name, scene in study.scenes.items() if "mask" in scene.geometry}
    found = {name: np.asarray(values) != 0 for name, values in own.items()}
    if mask is None:
        return found
    by_scene = dict(mask) if isinstance(mask, Mapping) else dict.fromkeys(study.scenes, mask)
    for name, values in by_scene.items():
        check_one_of("scene of the mask", name, study.scenes, owner="fit_weather")
        frame = study.scenes[name].clear[0]
        wanted = np.shape(frame[study.study_kind.signal])
        if np.shape(values) != wanted:
            raise InputValueError(
                f"fit_weather: mask of scene {name}: expected shape {wanted}, True for what does not count; got "
                f"{np.shape(values)}."
            )
        found[name] = np.asarray(values, dtype=bool) | found.get(name, np.zeros(wanted, dtype=bool))
    return found
