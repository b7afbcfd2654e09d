"""The demo's folder: frames in clear weather and in rain, fog and snow, their numbers, and the page about them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import torch
from tqdm import tqdm

from torchweather import __version__
from torchweather.atmosphere.weather import Fog, Mixture, Rain, Snow, Weather
from torchweather.camera.sensor import Camera
from torchweather.io import atomic_folder, atomic_write
from torchweather.lidar.sensor import Lidar
from torchweather.radar.sensor import Radar
from torchweather.report.demo_page import FrameChapter, Shown, demo_page
from torchweather.report.frames import Frame, embedded_frames, user_frames
from torchweather.report.lidar_section import lidar_part
from torchweather.report.lidar_views import lidar_scene
from torchweather.report.machine import machine
from torchweather.report.measure import weather_numbers
from torchweather.report.page import write_json, write_report
from torchweather.report.pictures import jpeg_bytes, shrunk
from torchweather.report.radar_section import RADAR_WEATHERS, WALKING, radar_part
from torchweather.report.radar_views import radar_scene
from torchweather.report.report import Section
from torchweather.scenes import test_track
from torchweather.sensors import DEFAULT_PRESETS

__all__ = ["write_demo"]

STRIP_PX = 480  # columns of each picture of the strip


@dataclass(frozen=True)
class WeatherKind:
    """One kind of weather at rising strength; ``best`` is its representative at the top of the page."""

    kind: str
    weathers: tuple[tuple[str, str, Weather], ...]  # name of the files, label, weather
    best: int


SECTIONS = (
    WeatherKind("rain", tuple((f"rain-{rate}", f"Rain {rate} mm/h", Rain(float(rate))) for rate in (10, 25, 50)), 2),
    WeatherKind("fog", tuple((f"fog-{mor}", f"Fog {mor} m", Fog(mor_m=float(mor))) for mor in (10, 20, 30, 50)), 2),
    WeatherKind(
        "snow",
        tuple((f"snow-{rate:g}", f"Snow {rate:g} mm/h", Snow(rate_mm_per_h=rate)) for rate in (0.5, 1.0, 3.0)),
        2,
    ),
    WeatherKind(
        "mixture", (("rain-25-fog-100", "Rain 25 mm/h in fog 100 m", Mixture(Rain(25.0), Fog(mor_m=100.0))),), 0
    ),
)
INDOOR_KINDS = ("fog",)
# Objects of the test track whose LiDAR points are counted.
COUNTED = ("car 28 m", "car 56 m", "pedestrian")


def write_demo(
    out_dir: Path,
    *,
    seed: int = 0,
    images: Sequence[Path] = (),
    depth: object = None,
    camera: Camera | None = None,
    lidar: str = DEFAULT_PRESETS["lidar"],
    radar: str = DEFAULT_PRESETS["radar"],
    progress: bool = True,
) -> dict[str, Any]:
    """Render frames in clear weather, rain, fog, snow and rain in fog, and write a page about them.

    Args:
        out_dir: gets ``index.html`` (self-contained), ``summary.json``, the frames as PNG (16 bits for raw ones) in
            ``frames/`` and point clouds and radar points of the embedded test track in ``clouds/``. What it held before
            stays, unless it has the same name. Nothing is written when anything fails.
        seed: of the weather, and of the sensor noise of the embedded scenes.
        images: a user's own frames, raw or RGB; none takes the embedded test track and fog tunnel.
        depth: of the images: a depth file, or what ``torchweather.image.as_depth_source`` takes, or a list with one
            for each; ``None`` is flat ground below a sky.
        camera: that took the images, or that looks at the embedded scenes; the default preset is ``lucid-triton``.
        lidar: preset of the LiDAR that looks at the embedded test track.
        radar: preset of the radar that looks at the embedded test track.
        progress: show a progress bar.

    Returns:
        What ``summary.json`` holds.

    Raises:
        TorchweatherError: an image cannot be read, or ``out_dir`` cannot be written.

    Example:
        >>> write_demo(Path("nowhere"), images=[Path("missing.png")], depth=30.0)
        Traceback (most recent call last):
        torchweather.core.errors.TorchweatherError: missing.png: no such file.
        >>> Path("nowhere").exists()
        False
    """
    out_dir = Path(out_dir)
    with atomic_folder(out_dir) as staging:
        (staging / "frames").mkdir()
        if images:
            frames = user_frames([Path(image) for image in images], depth, camera)
        else:
            camera = Camera.preset("lucid-triton") if camera is None else camera
            frames = embedded_frames(camera, seed)
        scanner = None if images else Lidar.preset(lidar)
        receiver = None if images else Radar.preset(radar)
        plans = [(frame, _sections_of(frame)) for frame in frames]
        total = sum(len(section.weathers) for _, sections in plans for section in sections)
        if scanner is not None:
            total += sum(len(section.weathers) for section in SECTIONS)
        if receiver is not None:
            total += len(RADAR_WEATHERS)
        subjects, chapters = [], []
        with tqdm(total=total, desc="weather", unit="frame", disable=not progress) as bar:
            for number, (frame, sections) in enumerate(plans):
                chapter = FrameChapter(frame)
                record = _rendered(chapter, sections, seed, staging, bar.update)
                more: list[Section] = []
                if number == 0 and scanner is not None:
                    record["lidar"], part = _lidar(scanner, lidar, frame, seed, staging, bar.update)
                    more.append(part)
                if number == 0 and receiver is not None:
                    moving = radar_scene(test_track(), receiver, WALKING)
                    record["radar"], part = radar_part(moving, f"radar:{radar}", seed, staging, frame.name, bar.update)
                    more.append(part)
                subjects.append(record)
                chapters.append(chapter.section(record["notes"], more))
        summary = {
            "torchweather": __version__,
            "seed": seed,
            "machine": machine(),
            "subjects": subjects,
        }
        found = write_json(staging / "summary.json", summary)
        write_report(demo_page(summary, chapters), staging / "index.html")
    return found


def _sections_of(frame: Frame) -> list[WeatherKind]:
    return [section for section in SECTIONS if not frame.indoors or section.kind in INDOOR_KINDS]


def _lidar(
    lidar: Lidar, preset: str, frame: Frame, seed: int, folder: Path, step: Callable[[int], object]
) -> tuple[dict[str, Any], Section]:
    """The test track as a LiDAR sees it, in the weathers of the camera."""
    weathers = [
        (name, label, section.kind, weather) for section in SECTIONS for name, label, weather in section.weathers
    ]
    shown = [section.weathers[section.best][0] for section in SECTIONS if section.kind != "mixture"]
    seen = lidar_scene(test_track(), lidar, seed, COUNTED)
    return lidar_part(seen, f"lidar:{preset}", weathers, shown, seed, folder, frame.name, step)


def _rendered(
    chapter: FrameChapter, kinds: Sequence[WeatherKind], seed: int, folder: Path, step: Callable[[int], object]
) -> dict[str, Any]:
    """Render a frame in its weathers, write the files, and add the kinds to its chapter: the summary's record."""
    frame = chapter.frame
    clear_file = f"frames/{frame.name}_clear.png"
    frame.write(folder / clear_file, frame.data)
    all_records: list[dict[str, Any]] = []
    said: list[str] = []
    strip = [chapter.clear]
    for kind in kinds:
        rendered, records = [], []
        for name, label, weather in kind.weathers:
            one = frame.render(weather, seed)
            file = f"frames/{frame.name}_{name}.png"
            frame.write(folder / file, one.data)
            records.append(
                {
                    "name": name,
                    "label": label,
                    "kind": kind.kind,
                    "weather": weather.to_dict(),
                    "file": file,
                    "numbers": weather_numbers(one.transform, frame.depth_m, one.transmission, one.particle_mask),
                    "times_s": {key: round(value, 6) for key, value in one.times_s.items()},
                }
            )
            rendered.append(one)
            said += one.warnings
            step(1)
        best = chapter.add(Shown(kind.kind, kind.best, records, rendered))
        if kind.kind != "mixture":
            strip.append(best)
        all_records += records
    record: dict[str, Any] = {
        "name": frame.name,
        "title": frame.title,
        "camera": frame.camera.to_dict(),
        "format": "rgb" if frame.is_rgb else "raw",
        "look": {"gains": list(frame.look.gains), "exposure": frame.look.exposure},
        "clear_file": clear_file,
        "notes": [*frame.notes, *dict.fromkeys(said)],
        "weathers": all_records,
    }
    if len(strip) == 4:
        record["strip_file"] = f"frames/{frame.name}_strip.jpg"
        with atomic_write(folder / record["strip_file"]) as unfinished:
            unfinished.write_bytes(jpeg_bytes(torch.cat([shrunk(picture, STRIP_PX) for picture in strip], -1)))
    return record
