"""An embedded scene as a radar sees it, clear and in the weather: ``torchweather apply scene:NAME --sensor radar``."""

from __future__ import annotations

import argparse
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from torchweather.atmosphere.weather import Fog, Rain, Snow, Weather
from torchweather.cli.apply_radar import transform_of
from torchweather.cli.detections import radar_options
from torchweather.cli.frame_seeds import FrameSeeds
from torchweather.cli.outcome import Outcome
from torchweather.cli.output import note
from torchweather.cli.result_files import ResultFiles
from torchweather.core.errors import check_one_of
from torchweather.core.exceptions import InputValueError
from torchweather.core.threads import one_thread_an_operation
from torchweather.io import RADAR_COLUMNS, RadarPoints, atomic_write, write_radar
from torchweather.pipeline.point_kind import PointKind
from torchweather.radar import FmcwRadar, range_doppler
from torchweather.radar.fmcw.detection import beam_amplitude
from torchweather.radar.sensor import Radar
from torchweather.recipes.transform import TransformRecipe
from torchweather.report.radar_picture import radar_picture
from torchweather.report.radar_section import WALKING
from torchweather.report.radar_views import RadarFrame
from torchweather.scenes import SCENES, RadarView, radar_view
from torchweather.sensors import DEFAULT_PRESETS

__all__ = ["line", "process"]

# Arguments of detection lists, and why a simulated frame has no use for them.
REFUSED = {
    "clutter": "the echoes of rain and snow are always in the samples of a simulated frame",
    "lost": "a simulated frame lists what was detected, and nothing else",
    "labels": "the column kind of the points says which of them are the scene's",
    "speed": "it says how a file is read",
    "gain": "it says how a file is read",
    "noise_floor_db": "the noise of a simulated frame is that of the receiver",
}
ONLY_LISTS = ("clutter", "clutter_points", "lost")
MODELS = ("rain_model", "fog_model", "snow_model")
COLUMNS = (*RADAR_COLUMNS, "kind")


def process(
    args: argparse.Namespace,
    weather: Weather,
    recipe: TransformRecipe | None,
    preset: str,
    outcome: Outcome,
    names: list[str],
) -> None:
    """Simulate the frames of every scene in clear air and in the weather, and write them."""
    for name in names:
        check_one_of("scene", name, SCENES, owner="apply")
    for argument, reason in REFUSED.items():
        if getattr(args, argument) not in (None, False):
            raise InputValueError(f"apply: --{argument.replace('_', '-')} has no meaning for a scene: {reason}.")
    radar = transform_of(args, weather, recipe, preset).sensor
    options = _options(args, recipe)
    sensor = f"radar:{preset or DEFAULT_PRESETS['radar']}"
    if args.sensor is None and recipe is not None:
        sensor = recipe.sensor_name
    elif recipe is None and not preset:
        note(f"no preset: the sensor is {sensor}.", quiet=args.quiet)
    results = ResultFiles([], args.out)
    for name in names:
        for path in _paths(args.out, name):
            results.free(path, f"scene:{name}", keep=True)
    seeds = FrameSeeds(args.seed, args.seed_rule)
    outcome.about["options"] = dict(options)
    for name in names:
        outcome.add(_one(name, radar, sensor, weather, options, seeds.of(name), args.out), radar.to_dict())


def _options(args: argparse.Namespace, recipe: TransformRecipe | None) -> dict[str, Any]:
    """Options of the simulator: the recipe's and the arguments', the arguments first."""
    given = {} if recipe is None else recipe.options
    unused = [name for name in ("clutter_points", "lost") if name in given]
    if unused:
        note(f"the recipe's {' and '.join(unused)}: of detection lists, not of a simulated frame.", quiet=args.quiet)
    options = {name: value for name, value in {**given, **radar_options(args)}.items() if name not in ONLY_LISTS}
    variant = options.pop("variant", None)
    return options if variant is None else {**options, **dict.fromkeys(MODELS, variant)}


def _one(
    name: str, radar: Radar, sensor: str, weather: Weather, options: Mapping[str, Any], seed: int, out: Path
) -> dict[str, Any]:
    """One scene: simulate and write; what was done, as plain values."""
    started = time.perf_counter()
    scene, ego_speed_m_per_s = SCENES[name](), float(options.get("ego_speed_m_per_s", 0.0))
    # The road users of the test track walk, as on the demo page.
    walking = {thing.name: WALKING[thing.name] for thing in scene.objects if thing.name in WALKING}
    view = radar_view(scene, radar, ego_speed_m_per_s=ego_speed_m_per_s, velocity_m_per_s=walking)
    clear = _frame(FmcwRadar(radar), FmcwRadar(radar, noise=False), view, seed)
    simulator = FmcwRadar(radar, weather, **options)
    frame = _frame(simulator, FmcwRadar(radar, weather, noise=False, clutter=False, **options), view, seed)
    title = f"{name}, {sensor}, {radar.frequency_ghz:g} GHz, polarisation {radar.polarisation}"
    if ego_speed_m_per_s:
        title += f", vehicle at {ego_speed_m_per_s:g} m/s"
    frames = (("Clear air", clear), (_weather_text(weather), frame))
    picture = radar_picture(title, frames, view.boxes, radar)
    paths = _paths(out, name)
    out.mkdir(parents=True, exist_ok=True)
    # The points in the weather last: where they stand, their company stands too.
    with atomic_write(paths[1]) as unfinished:
        unfinished.write_bytes(picture)
    write_radar(paths[2], _labelled(clear))
    write_radar(paths[0], _labelled(frame))
    return {
        "input": f"scene:{name}",
        **{key: str(path) for key, path in zip(("output", "picture", "clear"), paths, strict=True)},
        "seed": seed,
        "sensor": sensor,
        "weather": weather.to_dict(),
        "ego_speed_m_per_s": ego_speed_m_per_s,
        "scatterers": len(view.object_id),
        "points_clear": len(clear.points),
        "points_clear_scene": int(clear.of_scene.sum()),
        "points": len(frame.points),
        "points_scene": int(frame.of_scene.sum()),
        "attenuation_db_per_km": 0.0 if simulator.path is None else float(simulator.path.attenuation_db_per_km(1)),
        "radome_db": float(simulator.radome.two_way_db(1)),
        "seconds": time.perf_counter() - started,
    }


def _paths(out: Path, name: str) -> tuple[Path, Path, Path]:
    """Points in the weather, picture, points in clear air."""
    return out / f"{name}.npz", out / f"{name}.png", out / f"{name}_clear.npz"


def _weather_text(weather: Weather) -> str:
    """The weather's strength, as a heading."""
    parts = [
        f"{part.kind} {part.mor_m:g} m" if isinstance(part, Fog) else f"{part.kind} {part.rate_mm_per_h:g} mm/h"
        for part in weather.parts
        if isinstance(part, (Rain, Snow, Fog))
    ]
    return ", ".join(parts).capitalize()


def _frame(simulator: FmcwRadar, of_scene: FmcwRadar, view: RadarView, seed: int) -> RadarFrame:
    """A frame; ``of_scene`` gives the scene's part of its samples."""
    # One thread: on a busy machine torch's pool waits longer than it works.
    with torch.no_grad(), one_thread_an_operation():
        cube = simulator.cube(view.scatterers, simulator.draw(view.scatterers, seed=seed))
        result = simulator.process(cube)
        alone = of_scene.cube(view.scatterers, {})
        points, cell = result.points, result.cell
        assert isinstance(points, Tensor)
        assert isinstance(cell, Tensor)
        scene, rest = (
            beam_amplitude(
                range_doppler(samples, simulator.radar, simulator.window_name), points, cell, simulator.radar
            )
            for samples in (alone, cube - alone)
        )
        stronger = scene.abs() > rest.abs()
    return RadarFrame(simulator.weather, points, stronger, cell, result.power_dbm, {}, {}, ())


def _labelled(frame: RadarFrame) -> RadarPoints:
    """The points with what they are: of the scene, or of weather and noise."""
    kind = torch.where(frame.of_scene, PointKind.OBJECT.value, PointKind.PARTICLE.value)
    return RadarPoints(torch.cat([frame.points, kind[:, None].to(frame.points)], -1), COLUMNS)


def line(entry: Mapping[str, Any]) -> str:
    """Line of output on a scene."""
    radome = f", cover {entry['radome_db']:.3g} dB two way" if entry["radome_db"] else ""
    return (
        f"{entry['input']} -> {entry['output']}, {entry['clear']}, {entry['picture']}  seed {entry['seed']}  "
        f"points clear {entry['points_clear']} (scene {entry['points_clear_scene']}), in the weather "
        f"{entry['points']} (scene {entry['points_scene']})  "
        f"attenuation {entry['attenuation_db_per_km']:.3g} dB/km{radome}  {entry['seconds']:.2f} s"
    )
