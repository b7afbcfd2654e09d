"""Weather on point cloud files: the LiDAR's part of ``torchweather apply``."""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Mapping, Sequence
from dataclasses import asdict, replace
from functools import partial
from pathlib import Path
from typing import Any

import torch
from torch import Tensor
from tqdm import tqdm

from torchweather.atmosphere.weather import Weather
from torchweather.cli.cloud_files import CloudFiles
from torchweather.cli.clouds import (
    CloudFrame,
    clouds_in,
    complete_scan_of,
    gathered_clouds,
    lidar_fields,
    refuse_wrong_unit,
    with_ones,
)
from torchweather.cli.frame_seeds import FrameSeeds, frame_name
from torchweather.cli.ouster_product import refuse_other_product
from torchweather.cli.outcome import Outcome
from torchweather.cli.output import note
from torchweather.cli.own_vehicle import own_vehicle_of, words_of
from torchweather.core.errors import TorchweatherError
from torchweather.core.exceptions import InputTypeError, InputValueError
from torchweather.explain import explain
from torchweather.io import PointCloud, with_labels_of
from torchweather.lidar.open_air import OpenAirReturns, open_air_returns
from torchweather.lidar.sensor import Lidar
from torchweather.lidar.transform import LidarResult, LidarWeather
from torchweather.pipeline.point_kind import PointKind
from torchweather.recipes.transform import TransformRecipe, lidar_of, transform_class
from torchweather.report.cloud_counts import cloud_counts, has_return
from torchweather.sensors import DEFAULT_PRESETS

__all__ = ["line", "process"]

RING = "ring"
# Share of a cloud's points on the detection floor from which on a wrong unit is likely.
MANY_FLOORED = 0.5


def process(
    args: argparse.Namespace, weather: Weather, recipe: TransformRecipe | None, preset: str, outcome: Outcome
) -> None:
    """Read, weather and write every cloud."""
    if args.labels_in is not None and args.labels != "label":
        raise InputValueError("apply: --labels-in carries labels on into new ones; give --labels label too.")
    sensor, build = builder(args, weather, recipe, preset)
    if recipe is None and not preset:
        note(f"no preset: the sensor is lidar:{DEFAULT_PRESETS['lidar']}.", quiet=args.quiet)
    files = gathered_clouds(args.inputs)
    complete = bool(build.keywords.get("complete_scan"))
    mask = None
    if args.own_vehicle is not None or "own_vehicle" not in build.keywords:
        mask = own_vehicle_of(args, files, sensor, complete_scan=complete)
        build = partial(build, own_vehicle=mask)
    out = CloudFiles(files, args.out, labels=args.labels, labels_in=args.labels_in)
    numbers = {"mor_m": explain(weather, sensor)["mor_m"]}
    if mask is not None:
        numbers["own_vehicle"] = words_of(mask)
    work = _Work(sensor, build, args, out, numbers)
    quiet = args.quiet or not sys.stderr.isatty()
    outcome.begin(args.inputs, files)
    outcome.about["options"] = {name: value for name, value in build.keywords.items() if name != "own_vehicle"}
    # Recordings hold many frames: the bar counts frames, and knows their total where each file is one.
    total = None if any(file.suffix.lower() == ".pcap" for file in files) else len(files)
    with tqdm(total=total, unit="frame", file=sys.stderr, disable=quiet) as bar:
        for file in files:
            with outcome.file(file):
                for frame in clouds_in(file, args, sensor):
                    outcome.add(work.process(frame), sensor.to_dict())
                    if "open_air_returns" not in outcome.about:
                        outcome.about["open_air_returns"] = asdict(work.open_air_returns())
                    bar.update()


def builder(
    args: argparse.Namespace, weather: Weather, recipe: TransformRecipe | None, preset: str
) -> tuple[Lidar, partial[LidarWeather]]:
    """The sensor, and what makes the transform for it, from the recipe and the arguments, the arguments first."""
    if args.sensor is None and recipe is not None:
        sensor = dict(recipe.sensor)
    else:
        sensor = {"kind": "lidar", "preset": preset or DEFAULT_PRESETS["lidar"]}
    options = {} if recipe is None else dict(recipe.options)
    if args.lost is not None:
        options["lost"] = args.lost
    if getattr(args, "q_back", None) is not None:  # `view` has no such argument
        options["q_back"] = args.q_back
    if args.complete_scan or args.sky_only:
        options["complete_scan"] = complete_scan_of(args)
    kind: Any = LidarWeather if recipe is None else transform_class(recipe, weather)
    return lidar_of({**sensor, **lidar_fields(args)}), partial(kind, weather, **options)


class _Work:
    """The transform, where the results go, and the seeds."""

    def __init__(
        self,
        sensor: Lidar,
        build: partial[LidarWeather],
        args: argparse.Namespace,
        files: CloudFiles,
        numbers: Mapping[str, Any],
    ) -> None:
        self.build, self.args, self.files, self.numbers = build, args, files, numbers
        self.transform = build(sensor)
        self.seeds = FrameSeeds(args.seed, args.seed_rule)
        self.by_file_kind: dict[tuple[int | None, bool], LidarWeather] = {}
        self.said: set[str] = set()

    def process(self, frame: CloudFrame) -> dict[str, Any]:
        """One cloud: weather and write; what was done, as plain values."""
        started = time.perf_counter()
        seed = self.seeds.of(frame_name(frame.path.name, frame.number))
        without_intensity = self.args.intensity == "none"
        clear = with_ones(frame.cloud) if without_intensity else frame.cloud
        hit = has_return(clear.points, self.transform.sensor)
        transform = self._transform(clear.columns, returns_only=frame.directions is None and bool(hit.all()))
        refuse_other_product(str(frame.name), frame.product, transform.sensor, self.args, "apply")
        refuse_wrong_unit(str(frame.name), clear.points, transform.sensor, self.args, "apply")
        try:
            with torch.no_grad():
                noise = transform.draw(clear.points, seed=seed)
                result = transform.run(clear.points, noise, directions=frame.directions)
        except (InputValueError, InputTypeError) as error:
            raise TorchweatherError(f"{frame.name}: {error}") from error
        self._say_what_stands_out(frame, hit, result)
        assert isinstance(result.points, Tensor)
        first = self._outgoing(frame.cloud, result.points, result.kind, without_intensity)
        second = None
        if isinstance(result.second, Tensor):
            second = self._outgoing(frame.cloud, result.second, result.second_kind, without_intensity)
        written = self.files.write(frame, first, second, result)
        if self.args.preview:
            written["preview"] = self._preview(Path(str(written["output"])), clear.points, result, transform, seed)
        return {
            "input": str(frame.path),
            **({} if frame.number is None else {"frame": frame.number}),
            **written,
            "seed": seed,
            "weather": self.transform.weather.to_dict(),
            **cloud_counts(hit, result),
            "extinction_per_m": float(self.transform.extinction_per_m),
            **self.numbers,
            "scan": result.scan,
            "seconds": time.perf_counter() - started,
        }

    def _preview(self, target: Path, points: Tensor, result: LidarResult, transform: LidarWeather, seed: int) -> str:
        """The page of a cloud in clear air and in weather, beside the result."""
        from torchweather.report.cloud_view import write_cloud_view

        page = target.with_name(f"{target.name}.html")
        name = f"lidar ({transform.sensor.wavelength_nm:g} nm, {transform.sensor.intensity_unit})"
        write_cloud_view(
            page,
            points,
            result,
            transform.sensor,
            weather=transform.weather,
            seed=seed,
            name=target.name,
            sensor_name=name,
        )
        return str(page)

    def _transform(self, columns: Sequence[str], *, returns_only: bool) -> LidarWeather:
        """The transform for a file: it is told which column holds the ring, where beams are to be inferred, and leaves
        lost points out of a file that holds returns only, unless something else was asked for. The two files of a
        dual-return sensor belong together row by row: they keep theirs."""
        sensor = self.transform.sensor
        known = not self.transform.complete_scan or sensor.ring_column is not None or RING not in columns[4:]
        ring_column = None if known else columns.index(RING)
        drops = returns_only and "lost" not in self.build.keywords and sensor.return_mode != "dual"
        if ring_column is None and not drops:
            return self.transform
        kind = ring_column, drops
        if kind not in self.by_file_kind:
            own = sensor if ring_column is None else replace(sensor, ring_column=ring_column)
            self.by_file_kind[kind] = self.build(own, **({"lost": "drop"} if drops else {}))
        return self.by_file_kind[kind]

    def _outgoing(self, cloud: PointCloud, points: Tensor, kind: Any, without_intensity: bool) -> PointCloud:
        """A result in the columns of its input; a file that marks lost beams by NaN gets the new ones so too."""
        if without_intensity:
            points = torch.cat([points[:, :3], points[:, 4:]], -1)
        points = with_labels_of(cloud, points, kind)
        found = cloud.with_points(points)
        if found.missing is not None and self.args.lost is None and self.transform.lost == "zero":
            lost = (kind == PointKind.LOST)[:, None] & found.missing.any(0)
            found = replace(found, missing=found.missing | lost)
        return found

    def _say_what_stands_out(self, frame: CloudFrame, hit: Tensor, result: LidarResult) -> None:
        """Once in a run: beams that are left out, and intensities that do not fit the sensor."""
        empty, floored, points = int(result.empty_beams), int(result.floored_points), int(hit.sum())
        if empty and frame.directions is None and not self.transform.complete_scan:
            self._say_once(
                "empty",
                f"{frame.name}: {empty} rows without a return have no direction and stay empty; rain, snow and fog "
                "can return light there too (--complete-scan infers such beams from the sensor's pattern).",
            )
        if floored > MANY_FLOORED * points:
            self._say_once(
                "floored",
                f"{frame.name}: {floored} of {points} points are, by their intensity, fainter than the sensor can "
                "detect; little weather removes them. Check --intensity-unit and --range-at-10-percent-m.",
            )

    def open_air_returns(self) -> OpenAirReturns:
        """Share of beams into open air that return from particles; said where there is any."""
        found = open_air_returns(self.transform)
        if max(found.share, found.fast or 0.0) > 0.0:
            note(found.text(), quiet=self.args.quiet)
        return found

    def _say_once(self, what: str, text: str) -> None:
        if what not in self.said:
            self.said.add(what)
            note(text, quiet=self.args.quiet)


def line(entry: Mapping[str, Any]) -> str:
    """Line of output on a cloud."""
    frame = f" frame {entry['frame']}" if "frame" in entry else ""
    second = ""
    if "second_objects" in entry:
        second = f"  second: objects {entry['second_objects']}, particles {entry['second_particles']}"
    return (
        f"{entry['input']}{frame} -> {entry['output']}  seed {entry['seed']}  points {entry['points']}: "
        f"objects {entry['objects']}, particles {entry['particles']}, lost {entry['lost']}{second}  "
        f"empty beams {entry['empty_beams']}  on the detection floor {entry['floored_points']}  "
        f"extinction {entry['extinction_per_m']:.3g} 1/m  visibility {_metres(entry['mor_m'])}  "
        f"{entry['seconds']:.2f} s"
    )


def _metres(value: float) -> str:
    return f"{value:.0f} m" if value < 1e6 else "unlimited"
