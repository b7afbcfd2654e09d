"""The demo page: frames in clear weather and in rain, fog and snow, with the numbers that say why they look so."""

from __future__ import annotations

import json
import os
import platform
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from tqdm import tqdm

from torchweather import __version__
from torchweather.atmosphere.weather import Fog, Mixture, Rain, Snow, Weather
from torchweather.camera.bayer import cfa_index
from torchweather.camera.sensor import Camera
from torchweather.camera.tone import srgb_encode
from torchweather.io import atomic_folder, atomic_write
from torchweather.lidar.sensor import Lidar
from torchweather.radar.sensor import Radar
from torchweather.report.figures import Curve, histogram_uri, map_uri, transmission_uri
from torchweather.report.frames import Frame, Rendered, embedded_frames, user_frames
from torchweather.report.lidar_section import lidar_part
from torchweather.report.lidar_views import lidar_scene
from torchweather.report.measure import light_path, mean_over_bins, populations, ray_length_m, weather_numbers
from torchweather.report.page import html_page
from torchweather.report.pictures import (
    Window,
    brightened,
    brightening,
    centred_window,
    cropped,
    jpeg_bytes,
    jpeg_uri,
    liveliest_window,
    png_uri,
    shrunk,
    tinted_raw,
)
from torchweather.report.radar_section import RADAR_WEATHERS, WALKING, radar_part
from torchweather.report.radar_views import radar_scene
from torchweather.report.tables import number_text, rows_of
from torchweather.scenes import test_track
from torchweather.sensors import DEFAULT_PRESETS

__all__ = ["write_demo"]

WIDE_PX, NARROW_PX = 1000, 640  # columns of the pictures on the page: large, in a row of several
CLOSE_UP_PX = (120, 160)  # height, width of a close-up
RAW_PX = (54, 72)  # height, width of a raw crop
STRIP_PX = 480  # columns of each picture of the strip
BINS, FINE_BINS = 15, 40
NEAREST_M, FARTHEST_M = 2.0, 200.0  # of the transmission figure
MAP_LOW = 1e-3  # lower end of the particle map's colour bar


@dataclass(frozen=True)
class Section:
    """One kind of weather at rising strength; ``best`` is the one that stands for it at the top of the page."""

    kind: str
    weathers: tuple[tuple[str, str, Weather], ...]  # name of the files, label, weather
    best: int


SECTIONS = (
    Section("rain", tuple((f"rain-{rate}", f"Rain {rate} mm/h", Rain(float(rate))) for rate in (10, 25, 50)), 2),
    Section("fog", tuple((f"fog-{mor}", f"Fog {mor} m", Fog(mor_m=float(mor))) for mor in (10, 20, 30, 50)), 2),
    Section(
        "snow",
        tuple((f"snow-{rate:g}", f"Snow {rate:g} mm/h", Snow(rate_mm_per_h=rate)) for rate in (0.5, 1.0, 3.0)),
        2,
    ),
    Section("mixture", (("rain-25-fog-100", "Rain 25 mm/h in fog 100 m", Mixture(Rain(25.0), Fog(mor_m=100.0))),), 0),
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
        subjects, pages = [], []
        with tqdm(total=total, desc="weather", unit="frame", disable=not progress) as bar:
            for frame, sections in plans:
                record, page = _subject(frame, sections, seed, staging, bar.update)
                subjects.append(record)
                pages.append(page)
            if scanner is not None:
                subjects[0]["lidar"], pages[0]["lidar"] = _lidar(scanner, lidar, frames[0], seed, staging, bar.update)
            if receiver is not None:
                moving = radar_scene(test_track(), receiver, WALKING)
                subjects[0]["radar"], pages[0]["radar"] = radar_part(
                    moving, f"radar:{radar}", seed, staging, frames[0].name, bar.update
                )
        summary = {
            "torchweather": __version__,
            "seed": seed,
            "machine": {
                "torch": torch.__version__,
                "processor": platform.machine(),
                "cores": os.cpu_count(),
                "threads": torch.get_num_threads(),
                "device": "cpu",
            },
            "subjects": subjects,
        }
        text = json.dumps(summary, indent=1, allow_nan=False) + "\n"
        with atomic_write(staging / "summary.json") as unfinished:
            unfinished.write_text(text, encoding="utf-8")
        with atomic_write(staging / "index.html") as unfinished:
            unfinished.write_text(html_page("demo.html", summary=summary, subjects=pages), encoding="utf-8")
    found: dict[str, Any] = json.loads(text)
    return found


def _sections_of(frame: Frame) -> list[Section]:
    return [section for section in SECTIONS if not frame.indoors or section.kind in INDOOR_KINDS]


def _lidar(
    lidar: Lidar, preset: str, frame: Frame, seed: int, folder: Path, step: Callable[[int], object]
) -> tuple[dict[str, Any], dict[str, Any]]:
    """The test track as a LiDAR sees it, in the weathers of the camera."""
    weathers = [
        (name, label, section.kind, weather) for section in SECTIONS for name, label, weather in section.weathers
    ]
    shown = [section.weathers[section.best][0] for section in SECTIONS if section.kind != "mixture"]
    seen = lidar_scene(test_track(), lidar, seed, COUNTED)
    return lidar_part(seen, f"lidar:{preset}", weathers, shown, seed, folder, frame.name, step)


# ---- one frame ------------------------------------------------------------------------------------------------------


def _subject(
    frame: Frame, sections: Sequence[Section], seed: int, folder: Path, step: Callable[[int], object]
) -> tuple[dict[str, Any], dict[str, Any]]:
    """Everything about one frame: its record for the summary and its part of the page."""
    clear = frame.picture(frame.data)
    clear_file = f"frames/{frame.name}_clear.png"
    frame.write(folder / clear_file, frame.data)
    facts = [f"{frame.camera.width} × {frame.camera.height} px", f"exposure {frame.camera.exposure_s * 1e3:g} ms"]
    hero: list[dict[str, Any]] = [{"label": "Clear", "picture": jpeg_uri(shrunk(clear, NARROW_PX)), "facts": facts}]
    records: list[dict[str, Any]] = []
    parts: list[dict[str, Any]] = []
    strip = [clear]
    raw = [("Clear", frame.linear)]
    said: list[str] = []
    for section in sections:
        rendered: list[tuple[dict[str, Any], Rendered]] = []
        for name, label, weather in section.weathers:
            one = frame.render(weather, seed)
            file = f"frames/{frame.name}_{name}.png"
            frame.write(folder / file, one.data)
            numbers = weather_numbers(one.transform, frame.depth_m, one.transmission, one.particle_mask)
            record = {
                "name": name,
                "label": label,
                "kind": section.kind,
                "weather": weather.to_dict(),
                "file": file,
                "numbers": numbers,
                "times_s": {key: round(value, 6) for key, value in one.times_s.items()},
            }
            said += one.warnings
            rendered.append((record, one))
            step(1)
        records += [record for record, _ in rendered]
        part, best = _section(frame, clear, section, rendered)
        parts.append(part)
        if section.kind != "mixture":
            hero.append(
                {
                    "label": section.weathers[section.best][1],
                    "picture": jpeg_uri(shrunk(best, NARROW_PX)),
                    "facts": _facts(section.kind, rendered[section.best][0]["numbers"]),
                }
            )
            strip.append(best)
            raw.append((section.weathers[section.best][1], rendered[section.best][1].linear))
    notes = [*frame.notes, *dict.fromkeys(said)]
    subject: dict[str, Any] = {
        "name": frame.name,
        "title": frame.title,
        "camera": frame.camera.to_dict(),
        "format": "rgb" if frame.is_rgb else "raw",
        "look": {"gains": list(frame.look.gains), "exposure": frame.look.exposure},
        "clear_file": clear_file,
        "notes": notes,
        "weathers": records,
    }
    page = {
        **subject,
        "hero": hero if len(hero) > 2 else [],
        "raw": _raw_part(frame, raw),
        "depth": map_uri(
            np.where(np.isfinite(frame.depth_m[0].numpy()), frame.depth_m[0].double().numpy(), np.nan),
            "depth along the optical axis, m",
            low=2.0,
            high=200.0,
            log=True,
            beyond="sky" if bool(torch.isinf(frame.depth_m).any()) else None,
        ),
        "sections": parts,
    }
    if len(strip) == 4:
        with atomic_write(folder / "frames" / f"{frame.name}_strip.jpg") as unfinished:
            unfinished.write_bytes(jpeg_bytes(torch.cat([shrunk(picture, STRIP_PX) for picture in strip], -1)))
        subject["strip_file"] = f"frames/{frame.name}_strip.jpg"
    return subject, page


def _facts(kind: str, numbers: dict[str, Any]) -> list[str]:
    """What stands under a picture at the top."""
    left = f"{number_text(100 * numbers['transmission_28_m'])} % of the light from 28 m arrives"
    if kind == "fog":
        return [left, f"{number_text(numbers['liquid_water_g_per_m3'])} g of water per m³"]
    return [left, f"{number_text(numbers['particles_per_m3'])} {'drops' if kind == 'rain' else 'flakes'} per m³"]


def _raw_part(frame: Frame, raw: Sequence[tuple[str, torch.Tensor]]) -> dict[str, Any]:
    """Magnified crops of the mosaics, every pixel in the colour of its filter."""
    window = centred_window(frame.camera, *RAW_PX)
    pattern, exposure = frame.camera.bayer_pattern, 1.4 * frame.look.exposure
    crops = [
        {"label": label, "picture": png_uri(tinted_raw(cropped(linear, window), pattern, exposure))}
        for label, linear in raw
    ]
    # One grey value per pixel is all that the sensor delivers.
    grey = srgb_encode((frame.linear * frame.look.exposure).clamp(0, 1)).expand(3, -1, -1)
    return {"pattern": pattern, "crops": crops, "window": window, "whole": jpeg_uri(shrunk(grey, NARROW_PX))}


# ---- one kind of weather --------------------------------------------------------------------------------------------


def _section(
    frame: Frame, clear: torch.Tensor, section: Section, rendered: Sequence[tuple[dict[str, Any], Rendered]]
) -> tuple[dict[str, Any], torch.Tensor]:
    pictures = [frame.picture(one.data) for _, one in rendered]
    window = _window(frame, clear, section, pictures[-1], rendered[-1][1].particle_mask)
    labels = [record["label"] for record, _ in rendered]
    crops = [cropped(picture, window) for picture in (clear, *pictures)]
    factor = 1.0 if section.kind == "fog" else brightening(crops[-1])
    close_ups = [
        {"label": label, "picture": png_uri(brightened(crop, factor))}
        for label, crop in zip(("Clear", *labels), crops, strict=True)
    ]
    width = NARROW_PX if len(pictures) > 1 else WIDE_PX
    part = {
        "kind": section.kind,
        "frames": [
            {"label": label, "picture": jpeg_uri(shrunk(picture, width)), "file": record["file"]}
            for label, picture, (record, _) in zip(labels, pictures, rendered, strict=True)
        ],
        "close_ups": close_ups,
        "window": window,
        "brightened": factor,
        "map": _map(frame, section, rendered),
        "transmission": _transmission(frame, section, rendered),
        "histogram": _histogram(frame, section, rendered),
        "rows": rows_of([record for record, _ in rendered]),
        "labels": labels,
    }
    return part, pictures[section.best]


def _window(
    frame: Frame, clear: torch.Tensor, section: Section, heaviest: torch.Tensor, particle_mask: torch.Tensor
) -> Window:
    if section.kind == "fog":
        return centred_window(frame.camera, *CLOSE_UP_PX)
    return liveliest_window(clear, heaviest, particle_mask, frame.depth_m, *CLOSE_UP_PX)


def _map(frame: Frame, section: Section, rendered: Sequence[tuple[dict[str, Any], Rendered]]) -> dict[str, str]:
    record, one = rendered[section.best]
    if populations(one.transform):
        values = one.particle_mask[0].double().numpy()
        title = f"Particle mask, {record['label']}"
        picture = map_uri(
            values, "share of the exposure in which particles cover the pixel", low=MAP_LOW, high=1.0, log=True
        )
    else:
        values = one.transmission[0].double().numpy()
        title = f"Transmission, {record['label']}"
        picture = map_uri(values, "share of the scene's light that arrives", low=0.0, high=1.0, log=False)
    return {"title": title, "picture": picture}


def _transmission(frame: Frame, section: Section, rendered: Sequence[tuple[dict[str, Any], Rendered]]) -> str:
    """Fog dims along the ray; particles are counted in slabs along the axis. Each is drawn over its own distance."""
    ray = ray_length_m(frame.depth_m, frame.camera)
    depth = frame.depth_m.double().flatten().numpy()
    along_ray = section.kind in ("fog", "mixture")
    distance = ray if along_ray else depth
    edges, fine = (np.geomspace(NEAREST_M, FARTHEST_M, count + 1) for count in (BINS, FINE_BINS))
    # Each pixel has the extinction of its own colour: keep to one.
    green = (
        (cfa_index(frame.depth_m.shape[-2], frame.depth_m.shape[-1], frame.camera.bayer_pattern) == 1).flatten().numpy()
    )
    finite = green & np.isfinite(depth)
    curves = []
    for record, one in rendered:
        path = light_path(one.transform)
        left = (one.transmission.double() * (1 - one.particle_mask.double())).flatten().numpy()
        optical = path.fog_per_m[1] * ray[finite] + path.veil_depth(depth[finite])
        dots = mean_over_bins(distance[finite], {"left": left[finite]}, edges)
        if section.kind == "mixture":
            expected = mean_over_bins(distance[finite], {"line": np.exp(-optical)}, fine)
            line_m, line = expected["distance_m"], expected["line"]
        else:
            line_m = np.geomspace(NEAREST_M, FARTHEST_M, 200)
            line = np.exp(-path.fog_per_m[1] * line_m - path.veil_depth(line_m))
        curves.append(Curve(record["label"], line_m, line, dots["distance_m"], dots["left"]))
    return transmission_uri(curves, section.kind, "distance along the ray" if along_ray else "depth along the axis")


def _histogram(frame: Frame, section: Section, rendered: Sequence[tuple[dict[str, Any], Rendered]]) -> str:
    def per_colour(linear: torch.Tensor) -> list[tuple[str, np.ndarray[Any, np.dtype[np.float64]]]]:
        return [(name, values.double().numpy()) for name, values in frame.colours(linear)]

    weathers = [(record["label"], per_colour(one.linear)) for record, one in rendered]
    return histogram_uri(per_colour(frame.linear), weathers, section.kind)
