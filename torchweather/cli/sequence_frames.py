"""Sequences on the command line: frames of a folder or a video, one at a time, and where their results go."""

from __future__ import annotations

import hashlib
import json
import warnings
from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path
from typing import Any

from torch import Tensor

from torchweather.core.atomic import atomic_write
from torchweather.core.errors import TorchweatherError, TorchweatherWarning
from torchweather.datasets.speeds import read_timestamps
from torchweather.io import ImageInfo, read_image, write_image
from torchweather.io.video import VideoReader, VideoWriter, write_video

__all__ = ["MANIFEST", "ClipFrames", "FolderFrames", "FolderResult", "Frame", "VideoResult", "file_digest"]

MANIFEST = "sequence.jsonl"
"""Name of the file beside the results: a line of settings, then a line for each frame that was written."""


@dataclass(frozen=True)
class Frame:
    """One frame of a sequence.

    Args:
        number: in the sequence, from 0.
        image: ``(3, H, W)`` colour or ``(1, H, W)`` mosaic.
        name: of the frame, for results and messages.
        pts: presentation time of a video's frame.
        info: what its file held beside the pixels; ``None`` of a video.
    """

    number: int
    image: Tensor
    name: str
    pts: int | None = None
    info: ImageInfo | None = None


class FolderFrames:
    """Frames that are files of one size and kind, in the order of the list."""

    def __init__(self, paths: Sequence[Path]) -> None:
        self.paths = list(paths)
        self.name = str(self.paths[0].parent)
        first = self._read(0)
        height, width = first.image.shape[-2:]
        self.size: tuple[int, int] = (height, width)
        self.is_rgb = first.image.shape[-3] == 3

    def frames(self, start: int = 0) -> Iterator[Frame]:
        """The frames from one on."""
        for number in range(start, len(self.paths)):
            frame = self._read(number)
            if tuple(frame.image.shape[-2:]) != self.size or (frame.image.shape[-3] == 3) != self.is_rgb:
                raise TorchweatherError(
                    f"{self.paths[number]}: expected the sequence's size and kind, {self.size}, "
                    f"{'colour' if self.is_rgb else 'mosaic'}; got {tuple(frame.image.shape)}. A sequence is one drive "
                    "of one camera."
                )
            yield frame

    def sample(self, most: int) -> tuple[list[Frame], int]:
        """Up to so many frames, evenly spaced, and the number of all."""
        count = len(self.paths)
        chosen = sorted({round(place * (count - 1) / max(1, most - 1)) for place in range(min(most, count))})
        return [self._read(number) for number in chosen], count

    def digest(self) -> str:
        """Digest of the names and contents of all frames."""
        whole = hashlib.blake2b(digest_size=16)
        for path in self.paths:
            whole.update(f"{path.name}\0{file_digest(path)}\0".encode())
        return whole.hexdigest()

    def frame_rate_hz(self) -> float | None:
        """By the ``timestamps.txt`` of raw KITTI data beside or above the folder; ``None`` where there is none."""
        folder = self.paths[0].parent
        for stamps in (folder / "timestamps.txt", folder.parent / "timestamps.txt"):
            if stamps.is_file():
                times = read_timestamps(stamps)
                if len(times) == len(self.paths) and len(times) > 1:
                    return float((len(times) - 1) / times[-1])
        return None

    def _read(self, number: int) -> Frame:
        image, info = read_image(self.paths[number])
        if image.ndim != 3:
            raise TorchweatherError(
                f"{self.paths[number]}: expected one image a file in a sequence; got a batch {tuple(image.shape)}."
            )
        if info.note:
            warnings.warn(info.note, TorchweatherWarning, stacklevel=2)
        return Frame(number, image, self.paths[number].name, info=info)


class ClipFrames:
    """Frames of a video."""

    def __init__(self, path: Path) -> None:
        self.video = VideoReader(path)
        self.name = str(path)
        self.size: tuple[int, int] = (self.video.height, self.video.width)
        self.is_rgb = True

    def frames(self, start: int = 0) -> Iterator[Frame]:
        """The frames from one on; those before it are decoded and dropped."""
        for number, frame in enumerate(self.video):
            if number >= start:
                yield Frame(number, frame.rgb, f"{number:06d}.png", frame.pts)

    def sample(self, most: int) -> tuple[list[Frame], int]:
        """At most so many frames, evenly spaced, and the number of all; the video is decoded once."""
        kept: list[Frame] = []
        stride, count = 1, 0
        for frame in self.frames():
            count += 1
            if frame.number % stride == 0:
                kept.append(frame)
            if len(kept) > most:
                stride *= 2
                kept = [one for one in kept if one.number % stride == 0]
        return kept, count

    def digest(self) -> str:
        """Digest of the file."""
        return file_digest(self.video.path)

    def frame_rate_hz(self) -> float:
        """The video's mean frame rate."""
        return float(self.video.frame_rate_hz)


class FolderResult:
    """Results as image files with a manifest, which a later run with the same settings continues.

    Args:
        folder: of the results; made where it does not exist.
        settings: every option that changes the results, as plain values.

    Attributes:
        about: what was found on the way, for the manifest.
        done: names of the results that are there already.
        discarded: the folder holds results of other settings.
    """

    def __init__(self, folder: Path, settings: Mapping[str, Any]) -> None:
        self.folder, self.manifest = folder, folder / MANIFEST
        if folder.exists() and not folder.is_dir():
            raise TorchweatherError(f"{folder}: expected a folder for the frames; got a file.")
        self.settings = json.loads(json.dumps(settings, sort_keys=True))
        self.about: Mapping[str, Any] = {}
        self.done: set[str] = set()
        self.discarded = False
        self._find_done()

    def __enter__(self) -> FolderResult:
        self.folder.mkdir(parents=True, exist_ok=True)
        if not self.done:
            with atomic_write(self.manifest) as unfinished:
                head = json.dumps({"settings": self.settings, "found": dict(self.about)})
                unfinished.write_text(head + "\n", encoding="utf-8")
        else:
            # A kill may have torn the last line: the next one must not continue it.
            with self.manifest.open("a", encoding="utf-8") as file:
                file.write("\n")
        return self

    def __exit__(self, *failure: object) -> None:
        return None

    def write(self, frame: Frame, after: Tensor) -> None:
        """Write a frame, then its line of the manifest."""
        target = self.folder / frame.name
        write_image(target, after, like=frame.info)
        line = json.dumps({"frame": frame.number, "file": frame.name, "blake2b": file_digest(target)})
        with self.manifest.open("a", encoding="utf-8") as file:
            file.write(line + "\n")

    def _find_done(self) -> None:
        """Frames that a run with the same settings has written and nobody has changed since."""
        if not self.manifest.is_file():
            return
        lines = self.manifest.read_text(encoding="utf-8", errors="replace").splitlines()
        entries = [entry for line in lines if (entry := _entry(line))]
        if not entries or entries[0].get("settings") != self.settings:
            self.discarded = bool(entries)
            return
        for entry in entries[1:]:
            path = self.folder / Path(str(entry.get("file"))).name
            if path.is_file() and file_digest(path) == entry.get("blake2b"):
                self.done.add(path.name)


class VideoResult:
    """Results as one video, which gets its name when it is complete; its comment holds settings and findings."""

    done: frozenset[str] = frozenset()
    discarded = False

    def __init__(
        self,
        path: Path,
        size: tuple[int, int],
        rate_hz: Fraction | float,
        time_base: Fraction | None,
        settings: Mapping[str, Any],
    ) -> None:
        self._given = (path, *size, rate_hz)
        self._time_base, self._settings = time_base, settings
        self.about: Mapping[str, Any] = {}
        self._stack = ExitStack()
        self._writer: VideoWriter | None = None

    def __enter__(self) -> VideoResult:
        self._given[0].parent.mkdir(parents=True, exist_ok=True)
        comment = json.dumps({"settings": self._settings, "found": dict(self.about)})
        self._writer = self._stack.enter_context(write_video(*self._given, time_base=self._time_base, comment=comment))
        return self

    def __exit__(self, *failure: Any) -> None:
        self._stack.__exit__(*failure)

    def write(self, frame: Frame, after: Tensor) -> None:
        """Encode a frame."""
        assert self._writer is not None
        self._writer.add(after, frame.pts)


def file_digest(path: Path) -> str:
    """BLAKE2b of a file's content, 128 bits."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, lambda: hashlib.blake2b(digest_size=16)).hexdigest()


def _entry(line: str) -> dict[str, Any] | None:
    """A line of the manifest; ``None`` where it is empty or torn."""
    try:
        entry = json.loads(line)
    except (json.JSONDecodeError, RecursionError):
        return None
    return entry if isinstance(entry, dict) else None
