"""Inputs of ``torchweather sweep``: embedded scenes, files, and the files of a folder together."""

from __future__ import annotations

import argparse
from abc import ABC, abstractmethod
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from torchweather.camera.depth import AUTO, GUESSED, DepthSource, scene_of
from torchweather.camera.sensor import Camera
from torchweather.cli.clouds import (
    clouds_in,
    complete_scan_of,
    gathered_clouds,
    lidar_fields,
    refuse_wrong_unit,
    with_ones,
)
from torchweather.cli.detections import gathered_detections, radar_fields
from torchweather.cli.frames import camera_fields, camera_options, depth_source, fitted_camera, gathered
from torchweather.cli.ouster_product import refuse_other_product
from torchweather.cli.regions import parse_region
from torchweather.core.errors import TorchweatherError, check_one_of
from torchweather.core.exceptions import InputValueError
from torchweather.datasets.depth_sources import GROUND
from torchweather.evaluation.sweep import CameraSubject, LidarSubject, RadarSceneSubject, RadarSubject, Subject
from torchweather.io import read_image, read_radar
from torchweather.recipes.transform import camera_of, lidar_of, radar_of
from torchweather.report.radar_section import WALKING
from torchweather.scenes import SCENES, Scene, lidar_view, radar_view
from torchweather.scenes.raw_frame import DRY, raw_frame

__all__ = ["MAKERS", "Maker"]


class Maker(ABC):
    """Makes the subjects of one kind of sensor.

    Args:
        args: the command's.
        preset: of the sensor.
        notes: gets what a reader must know.
    """

    def __init__(self, args: argparse.Namespace, preset: str, notes: list[str]) -> None:
        self.args, self.preset, self.notes = args, preset, notes
        self.take_fields({})

    @staticmethod
    @abstractmethod
    def gathered(inputs: list[Path]) -> list[Path]:
        """Files of the sensor among files and folders."""

    @abstractmethod
    def take_fields(self, fields: Mapping[str, Any]) -> None:
        """Take the sensor: the preset, with the fields and, above them, those of the command line."""

    def scene(self, name: str) -> Subject:
        """An embedded scene by its name."""
        check_one_of("scene", name, SCENES, owner="sweep")
        return self._of_scene(SCENES[name](), indoors=name in DRY)

    def files(self, path: Path) -> list[Subject]:
        """A file, or the files of a folder, which are judged together."""
        scene = path.resolve().name if path.is_dir() else ""
        found = [subject for file in self.gathered([path]) for subject in self._of_file(file, scene)]
        if not found:
            raise TorchweatherError(f"{path}: no frames in it.")
        return found

    @abstractmethod
    def _of_scene(self, scene: Scene, *, indoors: bool) -> Subject: ...

    @abstractmethod
    def _of_file(self, file: Path, scene: str) -> Iterator[Subject]: ...

    @property
    def _region(self) -> Any:
        return None if self.args.region is None else parse_region(self.args.region)


class _Camera(Maker):
    def __init__(self, args: argparse.Namespace, preset: str, notes: list[str]) -> None:
        super().__init__(args, preset, notes)
        self.options = camera_options(args, args.ego_speed_m_per_s)

    @staticmethod
    def gathered(inputs: list[Path]) -> list[Path]:
        """Images."""
        return gathered(inputs)

    def take_fields(self, fields: Mapping[str, Any]) -> None:
        """Take the camera."""
        values = {**fields, **camera_fields(self.args)}
        self.camera = camera_of({**values, "kind": "camera", "preset": self.preset})

    def _of_scene(self, scene: Scene, *, indoors: bool) -> Subject:
        camera = self._sized()
        frame = raw_frame(scene, camera, seed=self.args.seed)
        options = self.options if frame.airlight is None else {"airlight": frame.airlight, **self.options}
        return CameraSubject(scene.name, frame.bayer, frame.depth_m, frame.camera, indoors=indoors, options=options)

    def _sized(self) -> Camera:
        """The camera in the size of the scene's frame."""
        if self.args.size is None:
            # Whole cells of the mosaic.
            width, height = (max(2, side // 4 * 2) for side in (self.camera.width, self.camera.height))
            self.notes.append(
                f"The frame of the scene has {width} x {height} px, half of the preset's in each direction; --size "
                "gives another."
            )
        else:
            width, height = _size(self.args.size)
        camera, _ = fitted_camera(self.camera, height, width, self.args)
        return camera

    def _of_file(self, file: Path, scene: str) -> Iterator[Subject]:
        data, info = read_image(file)
        if data.ndim != 3:
            raise TorchweatherError(f"{file}: expected a single frame (1 or 3, H, W); got {tuple(data.shape)}.")
        height, width = data.shape[-2:]
        camera, said = fitted_camera(self.camera, height, width, self.args, frame=file)
        if said:
            self.notes.append(f"{said[0].upper()}{said[1:]}")
        named = self.args.depth or (AUTO if info.kind == "rgb" else GROUND)
        source = depth_source(named, self.args.depth_encoding, file, args=self.args)
        _refuse_guess(source, file, self.args)
        depth = scene_of(source, camera, height, width, image=data)
        if depth.confidence == GUESSED:
            self.notes.append(
                "The depth of the frames is guessed, not measured: the scores tell of the weather in a guessed scene."
            )
        self.notes += [f"{file.name}: {sentence}." for sentence in depth.notes]
        yield CameraSubject(
            str(file),
            data,
            depth.depth_m,
            camera,
            scene=scene,
            options=self.options,
            scene_depth=depth,
            through_mosaic=self.args.through_mosaic,
        )


def _refuse_guess(source: DepthSource, file: Path, args: argparse.Namespace) -> None:
    """Raise where the depth is guessed and that was not allowed."""
    if source.confidence == GUESSED and not getattr(args, "allow_guessed_depth", False):
        raise TorchweatherError(
            f"sweep: the depth of {file} is guessed, not measured; the scores would be those of the guess. Give "
            '--depth FILE or DIR, or --allow-guessed-depth: the results are then headed "depth guessed".'
        )


class _Lidar(Maker):
    def __init__(self, args: argparse.Namespace, preset: str, notes: list[str]) -> None:
        super().__init__(args, preset, notes)
        self.options = {"complete_scan": complete_scan_of(args)} if args.complete_scan or args.sky_only else {}

    @staticmethod
    def gathered(inputs: list[Path]) -> list[Path]:
        """Clouds."""
        return gathered_clouds(inputs)

    def take_fields(self, fields: Mapping[str, Any]) -> None:
        """Take the LiDAR."""
        values = {**fields, **lidar_fields(self.args)}
        self.lidar = lidar_of({**values, "kind": "lidar", "preset": self.preset})

    def _of_scene(self, scene: Scene, *, indoors: bool) -> Subject:
        view = lidar_view(scene, self.lidar, range_noise_seed=self.args.seed)
        return LidarSubject(
            scene.name,
            indoors=indoors,
            region=self._region,
            points=view.points,
            lidar=self.lidar,
            beams=view.directions,
            options=self.options,
        )

    def _of_file(self, file: Path, scene: str) -> Iterator[Subject]:
        for frame in clouds_in(file, self.args, self.lidar):
            cloud = with_ones(frame.cloud) if self.args.intensity == "none" else frame.cloud
            refuse_other_product(str(frame.name), frame.product, self.lidar, self.args, "sweep")
            refuse_wrong_unit(str(frame.name), cloud.points, self.lidar, self.args, "sweep")
            yield LidarSubject(
                frame.name,
                # A recording's frames belong together as a folder's do.
                scene=scene or str(file),
                region=self._region,
                points=cloud.points,
                lidar=self.lidar,
                beams=frame.directions,
                options=self.options,
            )


class _Radar(Maker):
    @staticmethod
    def gathered(inputs: list[Path]) -> list[Path]:
        """Lists of detections."""
        return gathered_detections(inputs)

    def take_fields(self, fields: Mapping[str, Any]) -> None:
        """Take the radar."""
        values = {**fields, **radar_fields(self.args)}
        self.radar = radar_of({**values, "kind": "radar", "preset": self.preset})

    def _of_scene(self, scene: Scene, *, indoors: bool) -> Subject:
        walking = {thing.name: WALKING[thing.name] for thing in scene.objects if thing.name in WALKING}
        view = radar_view(scene, self.radar, velocity_m_per_s=walking)
        return RadarSceneSubject(
            scene.name,
            indoors=indoors,
            region=self._region,
            scatterers=view.scatterers,
            radar=self.radar,
            noise_seed=self.args.seed,
        )

    def _of_file(self, file: Path, scene: str) -> Iterator[Subject]:
        args = self.args
        clear = read_radar(file, self.radar, speed=args.speed or "relative", gain=args.gain or "boresight")
        yield RadarSubject(str(file), scene=scene, region=self._region, points=clear.points, radar=self.radar)


MAKERS: dict[str, type[Maker]] = {
    "camera": _Camera,
    "lidar": _Lidar,
    "radar": _Radar,
}
"""By the kind of the sensor."""


def _size(text: str) -> tuple[int, int]:
    width, x, height = text.lower().partition("x")
    try:
        found = int(width), int(height)
    except ValueError:
        found = (0, 0)
    if not x or min(found) < 2 or found[0] % 2 or found[1] % 2:
        raise InputValueError(
            f"sweep: --size must be WIDTHxHEIGHT in even numbers of pixels, such as 968x732; got {text!r}."
        )
    return found
