"""The demo page: a chapter for each frame, with a section for each kind of weather."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch

from torchweather.camera.bayer import cfa_index
from torchweather.camera.tone import srgb_encode
from torchweather.report import parts
from torchweather.report.demo_words import NAMES, WHY, limits
from torchweather.report.figures import Curve, histogram_uri, map_uri, transmission_uri
from torchweather.report.frames import Frame, Rendered
from torchweather.report.machine import machine_text
from torchweather.report.measure import light_path, mean_over_bins, populations, ray_length_m
from torchweather.report.pictures import (
    Window,
    brightened,
    brightening,
    centred_window,
    cropped,
    jpeg_uri,
    liveliest_window,
    png_uri,
    shrunk,
    tinted_raw,
)
from torchweather.report.report import Report, Section
from torchweather.report.tables import number_text, numbers_table

__all__ = ["FrameChapter", "Shown", "demo_page"]

WIDE_PX, NARROW_PX = 1000, 640  # columns of the pictures on the page: large, in a row of several
CLOSE_UP_PX = (120, 160)  # height, width of a close-up
RAW_PX = (54, 72)  # height, width of a raw crop
BINS, FINE_BINS = 15, 40
NEAREST_M, FARTHEST_M = 2.0, 200.0  # of the transmission figure
MAP_LOW = 1e-3  # lower end of the particle map's colour bar


@dataclass(frozen=True)
class Shown:
    """A frame in the weathers of one kind, light to heavy.

    Args:
        kind: of the weather.
        best: index of the one that stands for it.
        records: of the summary.
        rendered: the frames.
    """

    kind: str
    best: int
    records: Sequence[Mapping[str, Any]]
    rendered: Sequence[Rendered]

    @property
    def labels(self) -> list[str]:
        """Of the weathers."""
        return [record["label"] for record in self.records]


def demo_page(summary: Mapping[str, Any], chapters: Sequence[Section]) -> Report:
    """The page of the demo.

    Args:
        summary: what ``summary.json`` holds.
        chapters: one a frame.
    """
    subjects = summary["subjects"]
    lidar, radar = (any(sensor in subject for subject in subjects) for sensor in ("lidar", "radar"))
    others = ", a LiDAR\u00a0scan and a radar\u00a0frame" if radar else " and a LiDAR\u00a0scan" if lidar else ""
    raw = "a raw" if all(subject["format"] == "raw" for subject in subjects) else "a"
    lead = """Each picture starts from the same clear frame. The weather is computed from the size of its drops and
        flakes, in linear light, on the Bayer mosaic, before any colour exists. All pictures are developed with the
        white balance and exposure of the clear frame, so their brightness can be compared."""
    camera = subjects[0]["camera"]
    exposure = f"{camera['bit_depth']} bit, {1000 * camera['exposure_s']:g} ms"
    facts = [
        ("version", summary["torchweather"]),
        ("seed", f"{summary['seed']}"),
        ("camera", f"{camera['width']} × {camera['height']} px, {camera['bayer_pattern']}, {exposure}"),
        ("machine", machine_text(summary["machine"])),
    ]
    return Report(
        title=f"Rain, fog and snow on {raw} camera\u00a0frame{others}",
        head="torchweather: rain, fog and snow on a raw camera frame" + others.replace("\u00a0", " "),
        lead=[parts.Paragraph(lead, "lead"), parts.Facts(facts)],
        sections=chapters,
        footer=limits(summary["torchweather"], summary["seed"], lidar=lidar, radar=radar),
    )


class FrameChapter:
    """One frame: clear and in every kind of weather, what goes in, and a section for each kind.

    It keeps pictures of what was rendered, not the frames, which would fill the memory.

    Args:
        frame: the frame.
    """

    def __init__(self, frame: Frame) -> None:
        self.frame = frame
        self.clear = frame.picture(frame.data)
        exposure = f"exposure {frame.camera.exposure_s * 1e3:g} ms"
        facts = [f"{frame.camera.width} × {frame.camera.height} px", exposure]
        self._hero = [_captioned(frame, "Clear", self.clear, facts)]
        self._raw = [_raw_crop(frame, "Clear", frame.linear)]
        self._sections: list[Section] = []

    def add(self, shown: Shown) -> torch.Tensor:
        """Add a kind of weather.

        Returns:
            Display picture of its representative.
        """
        pictures = [self.frame.picture(one.data) for one in shown.rendered]
        self._sections.append(_weather_section(self.frame, self.clear, shown, pictures))
        label, best = shown.labels[shown.best], pictures[shown.best]
        if shown.kind != "mixture":
            facts = _facts(shown.kind, shown.records[shown.best]["numbers"])
            self._hero.append(_captioned(self.frame, label, best, facts))
            self._raw.append(_raw_crop(self.frame, label, shown.rendered[shown.best].linear))
        return best

    def section(self, notes: Sequence[str], more: Sequence[Section] = ()) -> Section:
        """The chapter.

        Args:
            notes: what a reader must know of the frame.
            more: sections of other sensors that look at the same scene.
        """
        many = len(self._hero) > 2
        hero = [parts.Pictures(self._hero, across=2, look="stacked")] if many else []
        inputs = [*_inputs(self.frame), *(_raw_pixels(self.frame, self._raw) if many else [])]
        sections = [Section("What goes in", inputs), *self._sections, *more]
        return Section(self.frame.title, [*map(parts.Note, notes), *hero], id=self.frame.name, sections=sections)


def _captioned(frame: Frame, label: str, picture: torch.Tensor, facts: Sequence[str]) -> parts.Figure:
    small = jpeg_uri(shrunk(picture, NARROW_PX))
    return parts.Figure(small, f"{frame.title}, {label}", caption=label, facts=facts)


def _facts(kind: str, numbers: Mapping[str, Any]) -> list[str]:
    """Facts below a picture at the top."""
    left = f"{number_text(100 * numbers['transmission_28_m'])} % of the light from 28 m arrives"
    if kind == "fog":
        return [left, f"{number_text(numbers['liquid_water_g_per_m3'])} g of water per m³"]
    return [left, f"{number_text(numbers['particles_per_m3'])} {'drops' if kind == 'rain' else 'flakes'} per m³"]


def _inputs(frame: Frame) -> list[parts.Part]:
    """The mosaic in grey, and the depth."""
    # The sensor delivers one grey value per pixel.
    grey = srgb_encode((frame.linear * frame.look.exposure).clamp(0, 1)).expand(3, -1, -1)
    name = "Mosaic sampled from the RGB image" if frame.is_rgb else "Raw mosaic"
    filters = f"one value per pixel, {frame.camera.bayer_pattern}, shown in grey"
    mosaic = jpeg_uri(shrunk(grey, NARROW_PX))
    depth = map_uri(
        np.where(np.isfinite(frame.depth_m[0].numpy()), frame.depth_m[0].double().numpy(), np.nan),
        "depth along the optical axis, m",
        low=2.0,
        high=200.0,
        log=True,
        beyond="sky" if bool(torch.isinf(frame.depth_m).any()) else None,
    )
    decides = "decides which particles and how much air stand in front of a pixel"
    figures = [
        parts.Figure(mosaic, "The raw mosaic as grey values", caption=name, facts=[filters]),
        parts.Figure(depth, "Depth map", caption="Depth", facts=[decides]),
    ]
    return [parts.Pictures(figures, across=2, look="roomy")]


def _raw_crop(frame: Frame, label: str, linear: torch.Tensor) -> parts.Figure:
    """A magnified crop of the mosaic, every pixel in the colour of its filter."""
    crop = cropped(linear, centred_window(frame.camera, *RAW_PX))
    tinted = tinted_raw(crop, frame.camera.bayer_pattern, 1.4 * frame.look.exposure)
    return parts.Figure(png_uri(tinted), f"Raw pixels, {label}", caption=label, look="pixels")


def _raw_pixels(frame: Frame, crops: Sequence[parts.Figure]) -> list[parts.Part]:
    _, _, height, width = centred_window(frame.camera, *RAW_PX)
    text = f"""A look at single pixels, {width} × {height} of them around the horizon. Each carries one colour of the
        filter array, and it is this mosaic that the weather changes."""
    return [parts.Paragraph(text), parts.Pictures(crops, across=4)]


# ---- one kind of weather --------------------------------------------------------------------------------------------


def _weather_section(frame: Frame, clear: torch.Tensor, shown: Shown, pictures: Sequence[torch.Tensor]) -> Section:
    name, labels = NAMES[shown.kind], shown.labels
    file = "frame (PNG)" if frame.is_rgb else "raw frame (PNG)"
    width = NARROW_PX if len(pictures) > 1 else WIDE_PX
    frames = [
        parts.Figure(
            jpeg_uri(shrunk(picture, width)),
            f"{frame.title}, {label}",
            caption=label,
            facts=[parts.link(record["file"], file)],
        )
        for label, picture, record in zip(labels, pictures, shown.records, strict=True)
    ]
    histogram = parts.Figure(
        _histogram(frame, shown),
        "Histograms of the linear signal per colour",
        title=f"Raw signal, clear against {name.lower()}",
        look="chart wide",
    )
    return Section(
        name,
        [
            parts.Prose(WHY[shown.kind]),
            parts.Pictures(frames, across={1: 1, 4: 4}.get(len(frames), 3)),
            *_close_ups(frame, clear, pictures, shown),
            parts.Pictures([_map(shown), _transmission(frame, shown)], across=2, look="roomy"),
            histogram,
            numbers_table(shown.records),
        ],
        id=f"{frame.name}-{shown.kind}",
        short=name,
    )


def _close_ups(frame: Frame, clear: torch.Tensor, pictures: Sequence[torch.Tensor], shown: Shown) -> list[parts.Part]:
    window = _window(frame, clear, shown.kind, pictures[-1], shown.rendered[-1].particle_mask)
    crops = [cropped(picture, window) for picture in (clear, *pictures)]
    factor = 1.0 if shown.kind == "fog" else brightening(crops[-1])
    small = f"{window[3]} × {window[2]} pixels, enlarged without smoothing"
    if factor > 1:
        small += f", all brightened × {factor}"
    figures = [
        parts.Figure(png_uri(brightened(crop, factor)), f"Close-up, {label}", caption=label, look="pixels")
        for label, crop in zip(("Clear", *shown.labels), crops, strict=True)
    ]
    return [parts.Heading("Close up", small), parts.Pictures(figures, across=5 if len(figures) == 5 else 2)]


def _window(
    frame: Frame, clear: torch.Tensor, kind: str, heaviest: torch.Tensor, particle_mask: torch.Tensor
) -> Window:
    if kind == "fog":
        return centred_window(frame.camera, *CLOSE_UP_PX)
    return liveliest_window(clear, heaviest, particle_mask, frame.depth_m, *CLOSE_UP_PX)


def _map(shown: Shown) -> parts.Figure:
    """The particle mask, or the transmission where there are no particles."""
    label, one = shown.labels[shown.best], shown.rendered[shown.best]
    if populations(one.transform):
        title, values = f"Particle mask, {label}", one.particle_mask
        bar = "share of the exposure in which particles cover the pixel"
        picture = map_uri(values[0].double().numpy(), bar, low=MAP_LOW, high=1.0, log=True)
    else:
        title, values = f"Transmission, {label}", one.transmission
        bar = "share of the scene's light that arrives"
        picture = map_uri(values[0].double().numpy(), bar, low=0.0, high=1.0, log=False)
    return parts.Figure(picture, title, title=title, look="plain")


def _transmission(frame: Frame, shown: Shown) -> parts.Figure:
    """Fog and particles dim along the ray."""
    ray = ray_length_m(frame.depth_m, frame.camera)
    depth = frame.depth_m.double().flatten().numpy()
    edges, fine = (np.geomspace(NEAREST_M, FARTHEST_M, count + 1) for count in (BINS, FINE_BINS))
    # Each pixel has the extinction of its own colour: keep to one.
    green = (
        (cfa_index(frame.depth_m.shape[-2], frame.depth_m.shape[-1], frame.camera.bayer_pattern) == 1).flatten().numpy()
    )
    finite = green & np.isfinite(depth)
    curves = []
    for label, one in zip(shown.labels, shown.rendered, strict=True):
        path = light_path(one.transform)
        left = (one.transmission.double() * (1 - one.particle_mask.double())).flatten().numpy()
        optical = path.fog_per_m[1] * ray[finite] + path.veil_depth(depth[finite], ray[finite] / depth[finite])
        dots = mean_over_bins(ray[finite], {"left": left[finite]}, edges)
        if shown.kind == "mixture":
            expected = mean_over_bins(ray[finite], {"line": np.exp(-optical)}, fine)
            line_m, line = expected["distance_m"], expected["line"]
        else:
            line_m = np.geomspace(NEAREST_M, FARTHEST_M, 200)
            line = np.exp(-path.fog_per_m[1] * line_m - path.veil_depth(line_m))
        curves.append(Curve(label, line_m, line, dots["distance_m"], dots["left"]))
    picture = transmission_uri(curves, shown.kind, "distance along the ray")
    small = "lines: equations; dots: mean of the rendered pixels"
    return parts.Figure(picture, "Transmission against distance", title="Light that arrives", small=small, look="chart")


def _histogram(frame: Frame, shown: Shown) -> str:
    def per_colour(linear: torch.Tensor) -> list[tuple[str, np.ndarray[Any, np.dtype[np.float64]]]]:
        return [(name, values.double().numpy()) for name, values in frame.colours(linear)]

    weathers = [(label, per_colour(one.linear)) for label, one in zip(shown.labels, shown.rendered, strict=True)]
    return histogram_uri(per_colour(frame.linear), weathers, shown.kind)
