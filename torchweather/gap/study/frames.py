"""Frames of a study: arrays by name, in memory or in files that are read when they are asked for."""

from __future__ import annotations

import contextlib
import zipfile
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, overload

from numpy.typing import NDArray

from torchweather.core.archives import BROKEN_ARCHIVE
from torchweather.core.errors import TorchweatherError
from torchweather.io.arrays import read_archive

__all__ = ["Check", "Frame", "FrameSource", "Frames", "NpzFile", "load"]

# Of all arrays of a file, unpacked. A mosaic of 60 million pixels with depth, normals and labels in float64 has 3e9.
MOST_BYTES = 4 * 2**30

Frame = Mapping[str, NDArray[Any]]
"""Arrays by name, such as ``range_m`` and ``intensity``."""

FrameSource = Frame | Callable[[], Frame]
"""A frame, or what gives one when it is called; its text names it in messages."""

Check = Callable[[Frame, str], Frame]
"""Gives a frame back in order, or raises with its name."""


@dataclass(frozen=True)
class NpzFile:
    """A frame in a ``.npz`` file; nothing in it is ever run."""

    path: Path

    def __call__(self) -> Frame:
        """The arrays of the file."""
        with contextlib.suppress(*BROKEN_ARCHIVE), zipfile.ZipFile(self.path) as archive:
            # `read_archive` says what is wrong with a file that cannot be opened, and reads no more than is stated.
            stated = sum(member.file_size for member in archive.infolist())
            if stated > MOST_BYTES:
                raise TorchweatherError(
                    f"{self.path}: expected one frame, at most {MOST_BYTES} bytes unpacked; its arrays have {stated}."
                )
        return read_archive(self.path)[0]

    def __str__(self) -> str:
        return str(self.path)


def load(source: FrameSource, name: str, check: Check) -> Frame:
    """The frame of a source, checked; ``name`` is that of a frame in memory."""
    if callable(source):
        return check(source(), str(source))
    return check(source, name)


class Frames(Sequence[Frame]):
    """Frames one after the other. Those of files are read and checked at each access and not kept.

    Args:
        sources: frames, or what gives one when it is called (`NpzFile`).
        check: called with each frame and its name; those in memory are checked at once.
        name: of the whole: who complains, and the key, such as ``study.yaml: scenes[0].clear``; frames in memory are
            ``name[0]``, ``name[1]``, ...

    Example:
        >>> import numpy as np
        >>> frames = Frames([{"bayer": np.zeros((2, 2))}], lambda frame, name: frame, "clear")
        >>> len(frames), frames[0]["bayer"].shape, frames.names
        (1, (2, 2), ('clear[0]',))
    """

    def __init__(self, sources: Iterable[FrameSource], check: Check, name: str) -> None:
        self._check, self.name = check, name
        given = list(sources)
        self.names = tuple(str(one) if callable(one) else f"{name}[{place}]" for place, one in enumerate(given))
        self._sources: tuple[FrameSource, ...] = tuple(
            one if callable(one) else check(one, self.names[place]) for place, one in enumerate(given)
        )

    def __len__(self) -> int:
        return len(self._sources)

    def __repr__(self) -> str:
        return f"<{len(self)} frames>"

    @overload
    def __getitem__(self, place: int) -> Frame: ...
    @overload
    def __getitem__(self, place: slice) -> Frames: ...
    def __getitem__(self, place: int | slice) -> Frame | Frames:
        if isinstance(place, slice):
            part = object.__new__(Frames)
            part._check, part.name = self._check, self.name
            part._sources, part.names = self._sources[place], self.names[place]
            return part
        source = self._sources[place]
        return self._check(source(), self.names[place]) if callable(source) else source

    def __iter__(self) -> Iterator[Frame]:
        return (self[place] for place in range(len(self)))
