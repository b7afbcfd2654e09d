"""Weather on files of radar detections: the radar's part of ``torchweather apply``."""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor
from tqdm import tqdm

from torchweather.atmosphere.weather import Weather
from torchweather.cli.detections import gathered_detections, radar_fields, radar_options
from torchweather.cli.frame_seeds import FrameSeeds
from torchweather.cli.outcome import Outcome
from torchweather.cli.output import note
from torchweather.cli.result_files import ResultFiles
from torchweather.core.errors import TorchweatherError
from torchweather.core.exceptions import InputTypeError, InputValueError
from torchweather.io import atomic_write, read_radar, write_radar
from torchweather.pipeline.point_kind import PointKind
from torchweather.radar.transform import RadarAttenuation, RadarResult
from torchweather.recipes.transform import TransformRecipe, radar_of
from torchweather.sensors import DEFAULT_PRESETS

__all__ = ["line", "process", "transform_of"]

TRUTH = ("kind", "source", "snr_db", "attenuation_db")
SOURCES = {
    "power_source": "The files hold no power: it is that of clear air by the radar equation, from their cross sections "
    "and the link budget of the sensor (see --sensor).",
    "rcs_source": "The files hold no cross section: it is that of clear air by the radar equation, from their powers "
    "and the link budget of the sensor (see --sensor).",
}


def process(
    args: argparse.Namespace, weather: Weather, recipe: TransformRecipe | None, preset: str, outcome: Outcome
) -> None:
    """Read, weather and write every list of detections."""
    if args.labels == "label":
        raise InputValueError("apply: --labels label is for a lidar; give --labels npz.")
    transform = transform_of(args, weather, recipe, preset)
    if recipe is None and not preset:
        note(f"no preset: the sensor is radar:{DEFAULT_PRESETS['radar']}.", quiet=args.quiet)
    files = gathered_detections(args.inputs)
    results = ResultFiles(files, args.out)
    for file in files:
        results.free(args.out / file.name, str(file), keep=True)
        if args.labels is not None:
            results.free(_labels_path(args.out, file), str(file), keep=True)
    quiet = args.quiet or not sys.stderr.isatty()
    said: set[str] = set()
    outcome.begin(args.inputs, files)
    outcome.about["options"] = radar_options(args)
    seeds = FrameSeeds(args.seed, args.seed_rule)
    for file in tqdm(files, unit="frame", file=sys.stderr, disable=quiet):
        seed = seeds.of(file.name)
        with outcome.file(file):
            outcome.add(_one(transform, file, args, seed), transform.sensor.to_dict())
            for key, text in SOURCES.items():
                if outcome.done[-1][key] != "file" and key not in said:
                    said.add(key)
                    note(text, quiet=args.quiet)


def transform_of(
    args: argparse.Namespace, weather: Weather, recipe: TransformRecipe | None, preset: str
) -> RadarAttenuation:
    """From the recipe and the arguments, the arguments first."""
    if args.sensor is None and recipe is not None:
        sensor = dict(recipe.sensor)
    else:
        sensor = {"kind": "radar", "preset": preset or DEFAULT_PRESETS["radar"]}
    options = {**({} if recipe is None else recipe.options), **radar_options(args)}
    return RadarAttenuation(weather, radar_of({**sensor, **radar_fields(args)}), **options)


def _one(transform: RadarAttenuation, file: Path, args: argparse.Namespace, seed: int) -> dict[str, Any]:
    """One list of detections: weather and write; what was done, as plain values."""
    started = time.perf_counter()
    clear = read_radar(file, transform.sensor, speed=args.speed or "relative", gain=args.gain or "boresight")
    try:
        with torch.no_grad():
            result = transform.run(clear.points, transform.draw(clear.points, seed=seed))
    except (InputValueError, InputTypeError) as error:
        raise TorchweatherError(f"{file}: {error}") from error
    assert isinstance(result.points, Tensor)
    args.out.mkdir(parents=True, exist_ok=True)
    written = {"output": str(args.out / file.name)}
    # The detections last: where they stand, their company stands too.
    if args.labels is not None:
        written["labels"] = str(_labels_path(args.out, file))
        with atomic_write(Path(written["labels"])) as unfinished:
            np.savez_compressed(unfinished, **dict(_truth(result)))
    write_radar(args.out / file.name, clear.with_points(result.points))
    return {
        "input": str(file),
        **written,
        "seed": seed,
        "weather": transform.weather.to_dict(),
        **_counts(clear.points, result),
        "attenuation_db_per_km": float(transform.attenuation_db_per_km.max()),
        "power_source": clear.power_source,
        "rcs_source": clear.rcs_source,
        "speed_source": clear.speed_source,
        "seconds": time.perf_counter() - started,
    }


def _labels_path(out: Path, file: Path) -> Path:
    return out / f"{file.stem}_labels.npz"


def _truth(result: RadarResult) -> Iterator[tuple[str, Any]]:
    for name in TRUTH:
        values = getattr(result, name)
        assert isinstance(values, Tensor)
        yield name, values.numpy()


def _counts(points: Tensor, result: RadarResult) -> dict[str, Any]:
    """Counts of a file's rows: detections kept and lost, the weather's own, and the mean two-way loss."""
    assert isinstance(result.kind, Tensor)
    assert isinstance(result.source, Tensor)
    assert isinstance(result.attenuation_db, Tensor)
    there = (points[:, :3] != 0).any(-1)
    objects = int((result.kind == PointKind.OBJECT).sum())
    # Of rows that had a detection; there are others where lost ones were left out.
    of_detection = (result.source >= 0) & torch.cat([there, there.new_zeros(1)])[result.source]
    losses = result.attenuation_db[of_detection].double()
    return {
        "points": len(points),
        "objects": objects,
        "particles": int((result.kind == PointKind.PARTICLE).sum()),
        "lost": int(there.sum()) - objects,
        "empty_rows": int((~there).sum()),
        "floored_points": int(result.floored_points),
        "attenuation_db_mean": float(losses.mean()) if len(losses) else None,
    }


def line(entry: Mapping[str, Any]) -> str:
    """Line of output on a list of detections."""
    mean = entry["attenuation_db_mean"]
    loss = "" if mean is None else f", {mean:.3g} dB two way in the mean"
    return (
        f"{entry['input']} -> {entry['output']}  seed {entry['seed']}  rows {entry['points']}: "
        f"objects {entry['objects']}, particles {entry['particles']}, lost {entry['lost']}, "
        f"empty {entry['empty_rows']}  below the detection threshold {entry['floored_points']}  "
        f"attenuation {entry['attenuation_db_per_km']:.3g} dB/km{loss}  {entry['seconds']:.2f} s"
    )
