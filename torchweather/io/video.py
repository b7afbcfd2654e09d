"""Videos: frames as RGB tensors, one at a time, and H.264 files from such frames.

Needs PyAV (extra ``video``). Neither direction holds more than a few frames.
"""

from __future__ import annotations

import os
import platform
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor

from torchweather.core.atomic import atomic_write
from torchweather.core.errors import InputValueError, MissingExtraError, TorchweatherError, check_positive
from torchweather.core.extras import install_hint

__all__ = ["VIDEO_SUFFIXES", "WRITTEN_SUFFIXES", "VideoFrame", "VideoReader", "VideoWriter", "write_video"]

VIDEO_SUFFIXES = (".mp4", ".m4v", ".mov", ".mkv", ".webm", ".avi", ".mpg", ".mpeg", ".ts")
"""File endings that are taken for videos."""
WRITTEN_SUFFIXES = (".mp4", ".m4v", ".mov", ".mkv")
"""Containers that `write_video` writes; each holds H.264."""

CRF = 16
"""Constant rate factor of libx264: 18 counts as visually lossless, 2 below it costs a quarter more bits and keeps the
small, faint marks of snow and rain."""
HIGH_DEFINITION_ROWS = 720
# Codes of ITU-T H.273: matrices, and transfers of PQ and HLG. Besides BT.709 FFmpeg's scaler has the matrices of FCC,
# BT.601 (two codes), SMPTE 240M and BT.2020. Its codes of ranges: luma from 16 to 235, and from 0 to 255.
_BT709, _BT601 = 1, 5
_MATRICES = (_BT709, 4, _BT601, 6, 7, 9)
_VIDEO_RANGE, _FULL_RANGE = 1, 2
_HIGH_DYNAMIC_RANGE = (16, 18)


@dataclass(frozen=True)
class VideoFrame:
    """One frame of a video.

    Args:
        rgb: ``(3, H, W)`` sRGB, uint8, upright.
        pts: presentation time in units of the video's time base; ``None`` where the file gives none.
    """

    rgb: Tensor
    pts: int | None


class VideoReader:
    """The frames of a video file, decoded one after the other.

    Each iteration opens the file anew and starts at the first frame.

    Args:
        path: a file that FFmpeg decodes. Audio is not read.

    Attributes:
        path: the file.
        height, width: of the upright frames, pixels.
        frame_rate_hz: mean frame rate.
        time_base: unit of the presentation times, seconds.
        has_audio: the file holds sound as well.

    Raises:
        TorchweatherError: the file is missing, no video, a raw mosaic, or of high dynamic range.
        ImportError: PyAV is not installed.
    """

    def __init__(self, path: str | os.PathLike[str]) -> None:
        self.path = Path(path)
        with self._opened() as (container, stream):
            rate = stream.average_rate or stream.guessed_rate
            if not rate or rate <= 0:
                raise TorchweatherError(f"{self.path}: the video gives no frame rate. Extract its frames to a folder.")
            self.frame_rate_hz = Fraction(rate)
            self.time_base = Fraction(stream.time_base or 1 / self.frame_rate_hz)
            self.has_audio = bool(container.streams.audio)
            first = next(self._decoded(container, stream), None)
        if first is None:
            raise TorchweatherError(f"{self.path}: expected a video; the file holds no frame.")
        self.height, self.width = first.rgb.shape[-2:]

    def __iter__(self) -> Iterator[VideoFrame]:
        with self._opened() as (container, stream):
            for number, frame in enumerate(self._decoded(container, stream)):
                if tuple(frame.rgb.shape[-2:]) != (self.height, self.width):
                    raise TorchweatherError(
                        f"{self.path}: frame {number} has {frame.rgb.shape[-2]} x {frame.rgb.shape[-1]} px, the first "
                        f"{self.height} x {self.width} px. Cut the video where its size changes."
                    )
                yield frame

    @contextmanager
    def _opened(self) -> Iterator[tuple[Any, Any]]:
        av = _pyav()
        if not self.path.is_file():
            raise TorchweatherError(f"{self.path}: no such file.")
        try:
            container = av.open(str(self.path), metadata_errors="replace")
        except av.error.FFmpegError as error:
            raise TorchweatherError(f"{self.path}: expected a video; it cannot be read ({error.strerror}).") from error
        with container:
            if not container.streams.video:
                raise TorchweatherError(f"{self.path}: expected a video; the file holds no pictures.")
            stream = container.streams.video[0]
            if stream.codec_context is None:
                raise TorchweatherError(f"{self.path}: expected a video; no decoder is known for its pictures.")
            stream.thread_type = "AUTO"
            self._check(stream.codec_context)
            yield container, stream

    def _check(self, codec: Any) -> None:
        """Refuse pictures that are not sRGB-like colour."""
        layout = str(codec.pix_fmt or "")
        if layout.startswith(("bayer", "gray", "mono")):
            raise TorchweatherError(
                f"{self.path}: expected a colour video; got pixel format {layout}, one value a pixel, which may be a "
                "raw mosaic. Extract its frames to 8 or 16 bit PNG and give the folder with --sequence."
            )
        if codec.color_trc in _HIGH_DYNAMIC_RANGE:
            raise TorchweatherError(
                f"{self.path}: expected sRGB or BT.709; got a high dynamic range (PQ or HLG). Convert it to BT.709."
            )

    def _decoded(self, container: Any, stream: Any) -> Iterator[VideoFrame]:
        av = _pyav()
        number = 0
        try:
            for frame in container.decode(stream):
                array = _as_rgb(frame)
                turns = round(frame.rotation / 90) % 4  # counterclockwise
                if turns:
                    array = np.rot90(array, turns)
                rgb = torch.from_numpy(np.ascontiguousarray(array)).permute(2, 0, 1).contiguous()
                yield VideoFrame(rgb, frame.pts)
                number += 1
        except av.error.FFmpegError as error:
            raise TorchweatherError(
                f"{self.path}: the video is damaged behind frame {number} ({error.strerror}). Repair or cut it."
            ) from error


class VideoWriter:
    """Frames into a video; made by `write_video`."""

    def __init__(self, container: Any, stream: Any, height: int, width: int) -> None:
        self._container, self._stream = container, stream
        self._size = (height, width)
        self._next_pts = 0
        self.written = 0

    def add(self, rgb: Tensor, pts: int | None = None) -> None:
        """Encode the next frame.

        Args:
            rgb: ``(3, H, W)`` sRGB, uint8.
            pts: presentation time in units of the time base; ``None``: one frame interval behind the last one.
        """
        if rgb.dtype != torch.uint8 or tuple(rgb.shape) != (3, *self._size):
            raise InputValueError(
                f"VideoWriter.add: expected rgb (3, {self._size[0]}, {self._size[1]}) uint8; got {tuple(rgb.shape)} "
                f"{rgb.dtype}."
            )
        av = _pyav()
        array = np.moveaxis(rgb.detach().cpu().numpy(), 0, -1)
        odd = [(0, side % 2) for side in self._size]
        if any(after for _, after in odd):
            array = np.pad(array, (*odd, (0, 0)), mode="edge")
        frame = av.VideoFrame.from_ndarray(np.ascontiguousarray(array), format="rgb24")
        frame = frame.reformat(
            format="yuv420p",
            src_colorspace=_BT709,
            dst_colorspace=_BT709,
            src_color_range=_FULL_RANGE,
            dst_color_range=_VIDEO_RANGE,
        )
        time_base = self._stream.codec_context.time_base
        # Presentation times must grow, which those of damaged files do not.
        frame.pts = self._next_pts if pts is None else max(pts, self._next_pts)
        frame.time_base = time_base
        self._next_pts = frame.pts + (self._interval(time_base) if pts is None else 1)
        self._container.mux(self._stream.encode(frame))
        self.written += 1

    def _interval(self, time_base: Fraction) -> int:
        rate: Fraction = self._stream.codec_context.framerate
        return max(1, round(1 / (time_base * rate)))

    def _finish(self) -> None:
        self._container.mux(self._stream.encode(None))


@contextmanager
def write_video(
    path: str | os.PathLike[str],
    height: int,
    width: int,
    frame_rate_hz: float | Fraction,
    *,
    time_base: Fraction | None = None,
    comment: str = "",
) -> Iterator[VideoWriter]:
    """Write an H.264 video (yuv420p, BT.709, constant rate factor 16), whole or not at all.

    The file gets its name when the block ends well; until then it has a temporary one beside it. An odd height or
    width gains one row or column, a copy of the last, because yuv420p halves the colour's resolution.

    Args:
        path: ``.mp4``, ``.m4v``, ``.mov`` or ``.mkv``; its folder must exist.
        height: rows of the frames.
        width: columns of the frames.
        frame_rate_hz: nominal frame rate.
        time_base: unit of the presentation times, seconds. Default: one frame interval.
        comment: text for the file's metadata.

    Example:
        >>> import tempfile
        >>> file = Path(tempfile.mkdtemp()) / "grey.mp4"
        >>> with write_video(file, 32, 48, 10) as video:  # doctest: +SKIP
        ...     video.add(torch.full((3, 32, 48), 90, dtype=torch.uint8))
    """
    target = Path(path)
    if target.suffix.lower() not in WRITTEN_SUFFIXES:
        raise TorchweatherError(
            f"{target}: expected a video ending in {', '.join(WRITTEN_SUFFIXES)}; got {target.suffix or 'no ending'}."
        )
    check_positive("frame_rate_hz", frame_rate_hz, unit="Hz", owner="write_video")
    av = _pyav()
    rate = Fraction(frame_rate_hz).limit_denominator(100_000)
    with atomic_write(target) as unfinished, av.open(str(unfinished), "w") as container:
        stream = container.add_stream("libx264", rate=rate, options=_encoder_options())
        stream.width, stream.height = width + width % 2, height + height % 2
        stream.pix_fmt = "yuv420p"
        codec = stream.codec_context
        codec.time_base = time_base or 1 / rate
        codec.colorspace = codec.color_primaries = codec.color_trc = _BT709
        codec.color_range = _VIDEO_RANGE
        if comment:
            container.metadata["comment"] = comment
        writer = VideoWriter(container, stream, height, width)
        yield writer
        if not writer.written:
            raise InputValueError(f"write_video: expected one frame or more for {target}; got none.")
        writer._finish()


def _encoder_options() -> dict[str, str]:
    """Options of libx264 by which the same frames give the same bytes."""
    # The bytes depend on the number of threads, which by default is that of the machine's cores.
    options = {"crf": str(CRF), "threads": "1"}
    if platform.machine().lower() in ("x86_64", "amd64"):
        # With AVX-512 libx264 gives other bytes from run to run; up to SSE 4.2 it does not, and is not slower.
        options["x264-params"] = "asm=sse4.2"
    return options


def _as_rgb(frame: Any) -> npt.NDArray[np.uint8]:
    """``(H, W, 3)`` of a decoded frame, by the matrix and range of its own."""
    if frame.format.is_rgb:
        rgb: npt.NDArray[np.uint8] = frame.to_ndarray(format="rgb24")
        return rgb
    # PyAV 14 to 16 assumes BT.601, which makes BT.709's green too light, so both are given. Players take unmarked
    # pictures of 720 rows and more for BT.709, smaller ones for BT.601.
    usual = _BT709 if frame.height >= HIGH_DEFINITION_ROWS else _BT601
    matrix = int(frame.colorspace) if int(frame.colorspace) in _MATRICES else usual
    full = int(frame.color_range) == _FULL_RANGE or frame.format.name.startswith("yuvj")
    levels = _FULL_RANGE if full else _VIDEO_RANGE
    converted: npt.NDArray[np.uint8] = frame.reformat(
        format="rgb24",
        src_colorspace=matrix,
        dst_colorspace=matrix,
        src_color_range=levels,
        dst_color_range=_FULL_RANGE,
    ).to_ndarray()
    return converted


def _pyav() -> Any:
    try:
        import av
        import av.error
    except ImportError as error:
        raise MissingExtraError(f"Videos need PyAV. {install_hint('video')}") from error
    return av
