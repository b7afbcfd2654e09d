"""Pictures of a validation: clear, measured and simulated frame side by side, for the strongest of each weather."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence

import numpy as np
import torch

from torchweather.camera.sensor import Camera
from torchweather.evaluation.validation.run import Validation
from torchweather.gap.study.simulation import simulate
from torchweather.gap.study.splits import severity
from torchweather.gap.study.study import Condition, Frame, Study
from torchweather.report import parts
from torchweather.report.lidar_figures import COLOURS
from torchweather.report.pictures import jpeg_uri, look_of, shrunk
from torchweather.report.radar_figures import bar_uri, power_scale
from torchweather.report.validation_figures import DIFFERS, NEARER_M, lidar_above_uri, link_series_uri, radar_above_uri

__all__ = ["link_pictures", "side_by_side"]

PICTURE_PX = 640


def link_pictures(study: Study, validation: Validation) -> list[parts.Part]:
    """Introduction and pictures of links."""
    text = """Simulated: the loss of the recorded rain on the way (ITU-R P.838), over dry samples of the same
            link."""
    return [parts.Paragraph(text), *_link_series(study, validation)]


def side_by_side(study: Study, validation: Validation) -> list[parts.Part]:
    """Introduction, legend and pictures of frames."""
    text = "The strongest of each weather. The simulated frame starts from a clear frame of the same scene."
    text += DEVELOPED.get(study.kind, "")
    return [parts.Paragraph(text), *LEGENDS[study.kind](study), *_rows(study, validation)]


def _scan_legend(study: Study) -> list[parts.Part]:
    nearer = f"nearer than in clear air by {NEARER_M:g} m or more, or where clear air gave none"
    keys = [
        parts.Key("return", COLOURS["object"]),
        parts.Key(nearer, COLOURS["particle"]),
        parts.Key("lost: where the clear frame has a return", COLOURS["lost"]),
    ]
    return [parts.Legend(keys)]


def _detection_legend(study: Study) -> list[parts.Part]:
    keys = [parts.Key("dots: detections, coloured by power"), parts.Key("in the clear frame, not here", DIFFERS, "×")]
    bar = bar_uri("points", _radar_scale(study)[0], "power of the detections, dB")
    return [parts.Legend(keys), parts.Figure(bar, "Colours of the powers, dB", look="bar plain")]


def _link_series(study: Study, validation: Validation) -> Iterator[parts.Figure]:
    """Attenuation over time of the link with the most rain, for each series."""
    for condition in study.conditions:
        measured = condition.frames[0]
        simulated = simulate(study, condition, seed=validation.seed)
        rain = np.nanmean(np.nan_to_num(np.asarray(measured["rain_mm_per_h"], dtype=np.float64)), axis=(0, 2))
        link = int(rain.argmax())
        about = f"{condition.id}, link {link}: the one with the most rain"
        picture = link_series_uri(measured, simulated, link)
        yield parts.Figure(picture, f"Attenuation over time, {about}", title=about, look="chart wide")


def _rows(study: Study, validation: Validation) -> Iterator[parts.Part]:
    """Clear, measured and simulated frame side by side, for the strongest of each weather of each scene."""
    strongest: dict[tuple[str, str], Condition] = {}
    for condition in study.conditions:
        if condition.weather is not None:
            key = (condition.scene, condition.weather.kind)
            held = strongest.get(key)
            if held is None or held.weather is None or severity(condition.weather) > severity(held.weather):
                strongest[key] = condition
    look, row_look = LOOKS.get(study.kind, ("plain", "keep"))
    labels = {result.id: result.label for result in validation.conditions}
    for condition in strongest.values():
        scene = study.scene_of(condition)
        clear = scene.clear[0]
        simulated = simulate(study, condition, seed=validation.seed)
        where = f"{condition.scene}: " if len(study.scenes) > 1 else ""
        title = f"{where}{labels[condition.id]}"
        drawn = DRAWN[study.kind](study, clear, [clear, condition.frames[0], simulated], scene.geometry)
        figures = [
            parts.Figure(picture, f"{title}, {label}", caption=label, look=look)
            for label, picture in zip(("clear", "measured", "simulated"), drawn, strict=True)
        ]
        yield parts.Heading(title)
        yield parts.Pictures(figures, across=3, look=row_look)


def _images(study: Study, clear: Frame, frames: Sequence[Frame], geometry: Frame) -> list[str]:
    camera = Camera.of(study.sensor)
    linear = [torch.from_numpy(np.array(frame["bayer"], dtype=np.float32))[None] for frame in (clear, *frames)]
    depth_m = torch.from_numpy(np.array(geometry["depth_m"], dtype=np.float32))[None]
    look = look_of(linear[0], depth_m, camera)
    return [jpeg_uri(shrunk(look.develop(each, camera.bayer_pattern), PICTURE_PX), quality=90) for each in linear[1:]]


def _scans(study: Study, clear: Frame, frames: Sequence[Frame], geometry: Frame) -> list[str]:
    return [lidar_above_uri(frame, clear, study.beams["direction"]) for frame in frames]


def _detections(study: Study, clear: Frame, frames: Sequence[Frame], geometry: Frame) -> list[str]:
    scale, far_m = _radar_scale(study)
    return [radar_above_uri(frame, clear, geometry, scale, far_m) for frame in frames]


def _radar_scale(study: Study) -> tuple[tuple[float, float], float]:
    """Ends of the scale of powers, dB, and of the pictures ahead, m."""
    powers = [np.asarray(scene.clear[0]["power_db"], dtype=np.float64) for scene in study.scenes.values()]
    known = np.concatenate([power[np.isfinite(power)] for power in powers])
    farthest = max(float(np.max(scene.geometry["range_m"])) for scene in study.scenes.values())
    scale = power_scale(torch.from_numpy(known), 0.05, 0.95) if len(known) else (-10.0, 0.0)
    return scale, 10.0 * math.ceil(farthest / 10.0)


# By the kind of a study.
DRAWN = {"camera": _images, "lidar": _scans, "radar": _detections}
LEGENDS = {"camera": lambda study: [], "lidar": _scan_legend, "radar": _detection_legend}
LOOKS = {"camera": ("", "")}  # of a figure, and of a row of them
DEVELOPED = {"camera": " All are developed with the white balance and exposure of the clear frame."}
