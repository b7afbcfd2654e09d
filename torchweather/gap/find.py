"""find_gap: the workflow on a study, from its frames to a report."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from typing import Any

from torchweather.core.errors import TorchweatherError, check_at_least
from torchweather.core.threads import one_thread_an_operation
from torchweather.gap.diagnosis import diagnose
from torchweather.gap.gap_report import GapReport, gap_report
from torchweather.gap.inference.forward_selection import find_gap_with
from torchweather.gap.inference.simulated_distribution import FrameModel
from torchweather.gap.places import CellValues, places_of
from torchweather.gap.sensors.camera.frames import CameraFrames
from torchweather.gap.sensors.camera.places import camera_cells
from torchweather.gap.sensors.camera.scene_change import with_parts_ignored
from torchweather.gap.sensors.lidar.frames import LidarFrames
from torchweather.gap.sensors.lidar.places import lidar_cells
from torchweather.gap.sensors.link.frames import LinkFrames
from torchweather.gap.sensors.link.places import link_cells
from torchweather.gap.sensors.radar.frames import RadarFrames
from torchweather.gap.sensors.radar.places import radar_cells
from torchweather.gap.study.study import Study
from torchweather.pipeline.effect import Effect

__all__ = ["find_gap"]

Model = Callable[[Study, Mapping[str, Any] | None, Sequence[Effect], Sequence[str]], FrameModel]
# By the kind of a study: simulates and reduces its frames.
MODELS: dict[str, Model] = {"lidar": LidarFrames, "camera": CameraFrames, "radar": RadarFrames, "link": LinkFrames}
# By the kind of a study: values in the cells of a frame, for the picture of where it departs.
CELLS: dict[str, Callable[..., CellValues]] = {
    "lidar": lidar_cells,
    "camera": camera_cells,
    "radar": radar_cells,
    "link": link_cells,
}


def find_gap(
    study: Study,
    *,
    options: Mapping[str, Any] | None = None,
    model_effects: Sequence[Effect] = (),
    effects: Sequence[str] | None = None,
    seed: int = 0,
    ignore_parts: Sequence[str] = (),
    max_frames: int | None = None,
    progress: Callable[[str], None] | None = None,
    say: Callable[[str], None] | None = None,
) -> GapReport:
    """Find where a simulation and measured frames disagree, and which effect of the catalogue explains it.

    Args:
        study: of a LiDAR, a camera or a radar, with clear frames and measured ones in weather, some conditions held
            out; or of microwave links, some of them held out.
        options: of ``LidarWeather``, ``BayerWeather`` or ``RadarAttenuation``, the model that is put to the test; links
            have none.
        model_effects: effects that the model has already.
        effects: ids that may be named, such as ``lidar.window_loss``; ``None`` is the whole catalogue of the sensor.
            Effects of lying snow, spray and drops that refract (``searched`` is False) are tried only where named.
        seed: of the simulation; the same seed gives the same answer but for ``seconds``.
        ignore_parts: parts of a camera's picture that are no change of the scene, ``SCENE:ROW,COLUMN`` as the error
            "scene changed" names them. Only that check leaves them out; the search counts them, and
            ``to_dict()["ignored_parts"]`` has them.
        max_frames: number of simulated frames from which the search tries no further effect: what was begun is ended,
            so that some thousand more may be simulated. ``to_dict()["max_frames"]`` then has ``limit`` and ``reached``.
            ``None`` is no limit.
        progress: called with a line of text at every step.
        say: the old name of ``progress``; goes with the next release.

    Returns:
        The report: ``verdict`` is ``none``, ``named``, ``named_and_rest`` or ``unknown``.

    Raises:
        TorchweatherError: the study is of another sensor, or lacks what an answer needs.

    Note:
        The error of the weather's record (its stated relative standard deviation) and of the mean of the clear frames
        are fitted beside every effect. Intervals are those of least squares, widened, and hold what another form of
        an effect needs; the confidence is that of development studies. docs/gap-bench.md has what became of both on a
        blind bench.

    References:
        GAP.md 3, 4.
    """
    if say is not None:
        warnings.warn(
            "find_gap: the argument is progress= now; its old name goes with the next release.",
            DeprecationWarning,
            2,
        )
        progress = progress or say
    if max_frames is not None:
        check_at_least("max_frames", max_frames, 1, unit="frames", owner="find_gap")
    broken = [finding for finding in diagnose(study) if finding.level == "error"]
    if broken:
        raise TorchweatherError(f"find_gap: not enough data to decide: {broken[0].what} {broken[0].advice}")
    # Sums must not depend on the number of threads.
    with one_thread_an_operation():
        model = MODELS[study.kind](with_parts_ignored(study, ignore_parts), options, model_effects, effects or ())
        result = find_gap_with(model, effects, seed, progress or (lambda text: None), max_frames)
        report = gap_report(result, study.sha256, seed)
        loudest = report.answer["where"][0]["statistic"] if report.answer["where"] else None
        places = places_of(result, partial(CELLS[study.kind], model), loudest)
    asked: dict[str, Any] = {}
    if ignore_parts:
        asked["ignored_parts"] = list(ignore_parts)
    if max_frames is not None:
        asked["max_frames"] = {"limit": max_frames, "reached": result.search.exhausted}
    return replace(report, answer={**report.answer, **asked}, places=places)
