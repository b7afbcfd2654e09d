"""Weather on the power maps of a radar: its part of ``torchweather apply``."""

from __future__ import annotations

import argparse
import sys
import time
import zipfile
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor
from tqdm import tqdm

from torchweather.atmosphere.weather import Weather
from torchweather.cli.detections import radar_fields
from torchweather.cli.frame_seeds import FrameSeeds
from torchweather.cli.outcome import Outcome
from torchweather.cli.output import note
from torchweather.cli.result_files import ResultFiles
from torchweather.core.errors import TorchweatherError
from torchweather.core.exceptions import InputTypeError, InputValueError
from torchweather.io import MAP_SUFFIXES, atomic_write, read_power_map, write_power_map
from torchweather.radar.map_transform import RadarMapResult, RadarMapWeather
from torchweather.radar.power_map import RadarPowerMap, map_cfar, map_detections, with_noise_scale
from torchweather.radar.sensor import Radar
from torchweather.recipes.transform import TransformRecipe, radar_of
from torchweather.sensors import DEFAULT_PRESETS

__all__ = ["has_maps", "line", "process"]

# Arguments of detection lists, and why a map has no use for them.
REFUSED = {
    "speed": "it says which velocity of a detection is read",
    "gain": "it says how a detection's power follows from its cross section",
    "lost": "a map keeps all of its cells",
    "clutter": "the echoes of rain and snow are always in a map; --map-clutter-share 0 leaves them out",
}
MODELS = ("rain_model", "fog_model", "snow_model", "radome_loss_db", "radome_film_db", "radome_film_exponent")
MAP_ONLY = (".png", ".npy")  # no detections have these endings
KEYS = ("map", "power", "values")  # of a .npz that holds a map


def has_maps(args: argparse.Namespace) -> bool:
    """Check whether the inputs are power maps, and not lists of detections."""
    if args.map is not None:
        return True
    return any(path.suffix.lower() in MAP_ONLY or _archived(path) for path in _files(args.inputs))


def process(
    args: argparse.Namespace, weather: Weather, recipe: TransformRecipe | None, preset: str, outcome: Outcome
) -> None:
    """Read, weather and write every map."""
    for argument, reason in REFUSED.items():
        if getattr(args, argument) not in (None, False):
            raise InputValueError(f"apply: --{argument.replace('_', '-')} has no meaning for a power map: {reason}.")
    if args.labels == "label":
        raise InputValueError("apply: --labels label is for a lidar; give --labels npz.")
    files = [path for path in _files(args.inputs) if path.suffix.lower() in MAP_SUFFIXES]
    others = [path for path in args.inputs if path.is_file() and path.suffix.lower() not in MAP_SUFFIXES]
    if others or not files:
        raise InputValueError(
            f"apply: {(others or args.inputs)[0]}: expected radar power maps ({', '.join(MAP_SUFFIXES)}). Run apply "
            "for maps and for lists of detections one after the other."
        )
    if recipe is None and not preset:
        note(f"no preset: the sensor is radar:{DEFAULT_PRESETS['radar']}.", quiet=args.quiet)
    plan = _Plan(weather, _sensor(args, recipe, preset), _options(args, recipe), args)
    results = ResultFiles(files, args.out)
    for file in files:
        for path in plan.outputs(file):
            results.free(path, str(file), keep=True)
    quiet = args.quiet or not sys.stderr.isatty()
    said: set[str] = set()
    outcome.begin(args.inputs, files)
    outcome.about["options"] = plan.options
    seeds = FrameSeeds(args.seed, args.seed_rule)
    for file in tqdm(files, unit="frame", file=sys.stderr, disable=quiet):
        seed = seeds.of(file.name)
        with outcome.file(file):
            outcome.add(plan.one(file, seed), plan.sensor.to_dict())
            for text in outcome.done[-1]["notes"]:
                if text not in said:
                    said.add(text)
                    note(f"{text}.", quiet=args.quiet)


def line(entry: Mapping[str, Any]) -> str:
    """Line of output on a map."""
    before, after = entry["detections_clear"], entry["detections"]
    counts = "" if before is None else f"  detections {before} clear, {after} in the weather"
    clutter = "" if entry["clutter_db"] is None else f", clutter up to {entry['clutter_db']:.1f} dB over the noise"
    return (
        f"{entry['input']} -> {entry['output']}  seed {entry['seed']}  noise floor {entry['noise_floor_db']:.2f} dB"
        f"{clutter}  attenuation {entry['attenuation_db_per_km']:.3g} dB/km, at most {entry['attenuation_db']:.3g} dB "
        f"two way{counts}  {entry['seconds']:.2f} s"
    )


@dataclass(frozen=True)
class _Plan:
    """Work to be done on each file."""

    weather: Weather
    sensor: Radar
    options: dict[str, Any]
    args: argparse.Namespace

    def outputs(self, file: Path) -> list[Path]:
        """Files that are written for an input, the map last."""
        found = [self.args.out / f"{file.stem}_labels.npz"] if self.args.labels is not None else []
        if self.args.preview:
            found.append(self.args.out / f"{file.stem}_preview.png")
        return [*found, self.args.out / file.name]

    def one(self, file: Path, seed: int) -> dict[str, Any]:
        """Weather on one file; what was done, as plain values."""
        started = time.perf_counter()
        clear = read_power_map(file, self.args.map)
        try:
            law = self.args.noise_law or ("measured" if clear.scale.kind == "db_steps" else "scale")
            if law == "measured":
                clear = with_noise_scale(clear, self._step_db(clear))
            transform = RadarMapWeather(self.weather, self.sensor, axes=clear.axes, scale=clear.scale, **self.options)
            with torch.no_grad():
                result = transform.run(clear.values, transform.draw(clear.values, seed=seed))
        except (InputValueError, InputTypeError) as error:
            raise TorchweatherError(f"{file}: {error}") from error
        wet = clear.with_values(result.values)
        self.args.out.mkdir(parents=True, exist_ok=True)
        written = self._company(file, clear, wet, result)
        write_power_map(self.args.out / file.name, wet)
        noise_db = float(result.noise_floor_db.double().mean())
        clutter_db = float(result.clutter_db.max())
        return {
            "input": str(file),
            "output": str(self.args.out / file.name),
            **written,
            "seed": seed,
            "weather": self.weather.to_dict(),
            "dims": dict(zip(clear.axes.dims, clear.axes.shape, strict=True)),
            "range_bin_m": clear.range_bin_m,
            "scale": clear.scale.kind,
            "noise_law": law,
            "noise_floor_db": noise_db,
            "attenuation_db_per_km": float(transform.attenuation_db_per_km.max()),
            "attenuation_db": float(result.attenuation_db.max()),
            "clutter_db": clutter_db if clutter_db > -np.inf else None,
            "detections_clear": self._detections(clear, noise_db),
            "detections": self._detections(wet, noise_db),
            "notes": list(clear.notes),
            "seconds": time.perf_counter() - started,
        }

    def _step_db(self, clear: RadarPowerMap) -> float:
        """Of the top of a byte's scale."""
        assert clear.scale.edges_db is not None
        return clear.scale.edges_db[-1] - clear.scale.edges_db[-2]

    def _detections(self, power_map: RadarPowerMap, noise_db: float) -> int | None:
        """Cells that a CFAR takes; ``None`` where its window does not fit the map."""
        if power_map.scale.kind == "complex" and power_map.values.dtype == torch.complex128:
            power_map = power_map.with_values(power_map.values.to(torch.complex64))
        looks = self.options.get("looks", 1)
        try:
            cfar = map_cfar(power_map, self.sensor, looks=looks)
            return len(map_detections(power_map, self.sensor, cfar, noise_db=noise_db, looks=looks))
        except ValueError:
            return None

    def _company(self, file: Path, clear: RadarPowerMap, wet: RadarPowerMap, result: RadarMapResult) -> dict[str, Any]:
        """The files beside the map."""
        written: dict[str, Any] = {}
        if self.args.labels is not None:
            target = self.args.out / f"{file.stem}_labels.npz"
            parts: dict[str, Tensor] = {
                name: getattr(result, name) for name in ("attenuation_db", "clutter_db", "noise_floor_db")
            }
            with atomic_write(target) as unfinished:
                np.savez_compressed(unfinished, **{name: one.numpy() for name, one in parts.items()})  # type: ignore[arg-type]
            written["labels"] = str(target)
        if self.args.preview:
            from torchweather.report.map_picture import map_picture

            target = self.args.out / f"{file.stem}_preview.png"
            noise_db = float(result.noise_floor_db.double().mean())
            picture = map_picture({"clear": clear, _words(self.weather): wet}, noise_db)
            with atomic_write(target) as unfinished:
                unfinished.write_bytes(picture)
            written["preview"] = str(target)
        return written


def _sensor(args: argparse.Namespace, recipe: TransformRecipe | None, preset: str) -> Radar:
    """From the recipe and the arguments, the arguments first; the noise floor is the maps' and no list's."""
    if args.sensor is None and recipe is not None:
        sensor = dict(recipe.sensor)
    else:
        sensor = {"kind": "radar", "preset": preset or DEFAULT_PRESETS["radar"]}
    fields = {name: value for name, value in radar_fields(args).items() if name != "noise_floor_db"}
    return radar_of({**sensor, **fields})


def _options(args: argparse.Namespace, recipe: TransformRecipe | None) -> dict[str, Any]:
    """Options of the transform: the recipe's that a map shares with a list, and the arguments."""
    given = {} if recipe is None else {name: one for name, one in recipe.options.items() if name in MODELS}
    variant = None if recipe is None else recipe.options.get("variant")
    if variant is not None:
        given |= dict.fromkeys(MODELS[:3], variant)
    named = {
        "radome_loss_db": args.radome_loss_db,
        "radome_film_db": args.radome_film_db,
        "noise_floor_db": args.noise_floor_db,
        "ego_speed_m_per_s": args.ego_speed_m_per_s,
        "clutter_share": args.map_clutter_share,
        "looks": args.looks,
    }
    return {**given, **{name: value for name, value in named.items() if value is not None}}


def _words(weather: Weather) -> str:
    """The weather, for a heading."""
    unit = {"rate_mm_per_h": "mm/h", "mor_m": "m"}
    words = [f"{part.kind} {float(part.intensity):g} {unit[part.intensity_name]}" for part in weather.parts]
    return ", ".join([*words, *(one.kind for one in weather.conditions)])


def _files(inputs: list[Path]) -> list[Path]:
    """Files as they are, of a folder all that may hold maps, by name."""
    found: list[Path] = []
    for path in inputs:
        if path.is_dir():
            found += sorted(one for one in path.iterdir() if one.suffix.lower() in MAP_SUFFIXES and one.name[0] != ".")
        else:
            found.append(path)
    return found


def _archived(path: Path) -> bool:
    """Check whether a ``.npz`` holds a map."""
    if path.suffix.lower() != ".npz" or not path.is_file():
        return False
    try:
        with zipfile.ZipFile(path) as archive:
            return any(name.removesuffix(".npy") in KEYS for name in archive.namelist())
    except (OSError, zipfile.BadZipFile):
        return False  # whoever reads it says what is wrong
