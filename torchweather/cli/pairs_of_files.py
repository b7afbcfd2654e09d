"""Pairs of files on the command line: two files, or two folders matched by name, and what they hold."""

from __future__ import annotations

import zipfile
from collections import Counter
from dataclasses import dataclass
from pathlib import Path

from torchweather.cli.clouds import stem
from torchweather.core.exceptions import InputValueError

__all__ = ["CLOUDS", "DETECTIONS", "IMAGES", "KIND_OF_SENSOR", "PairsOfFiles", "pairs_of_files"]

IMAGES, CLOUDS, DETECTIONS = "images", "point clouds", "radar detections"
KIND_OF_SENSOR = {"camera": IMAGES, "lidar": CLOUDS, "radar": DETECTIONS}
NAMES_SHOWN = 10

# Arrays that say what an .npz holds.
OF_IMAGES = ("bayer.npy", "rgb.npy")
OF_CLOUDS = ("points.npy", "x.npy", "y.npy", "z.npy", "columns.npy")


@dataclass(frozen=True)
class PairsOfFiles:
    """Files to be scored.

    Args:
        kind: ``images``, ``point clouds`` or ``radar detections``.
        pairs: reference and distorted file of each, by name.
        only_reference, only_distorted: files without a partner.
        folders: whether folders were given.
    """

    kind: str
    pairs: tuple[tuple[Path, Path], ...]
    only_reference: tuple[Path, ...] = ()
    only_distorted: tuple[Path, ...] = ()
    folders: bool = False

    def unmatched_line(self) -> str:
        """The files without a partner in one line; '' where there are none."""
        sides = (("reference", self.only_reference), ("distorted", self.only_distorted))
        return "; ".join(f"without a partner, {side}: {_shown(files)}" for side, files in sides if files)


def pairs_of_files(reference: Path, distorted: Path, sensor: str | None = None) -> PairsOfFiles:
    """The pairs of two files, or of two folders: files of one name, or of one name but for the ending.

    Args:
        reference, distorted: two files or two folders (without the folders in them).
        sensor: ``camera``, ``lidar`` or ``radar``: what the files hold. Default: what their endings say.

    Raises:
        ValueError: a file and a folder, no such file, nothing that matches, files of different kinds.
    """
    for path in (reference, distorted):
        if not path.exists():
            raise InputValueError(f"{path}: no such file or folder.")
    if reference.is_dir() != distorted.is_dir():
        raise InputValueError(f"metrics: give two files or two folders; got {reference} and {distorted}.")
    if not reference.is_dir():
        for path in (reference, distorted):
            if not _ends(path, _endings(sensor)):
                raise InputValueError(f"{path}: expected {_wanted(sensor)} ({', '.join(_endings(sensor))}).")
        return PairsOfFiles(_kind([reference, distorted], sensor), ((reference, distorted),))
    first, second = (_inside(folder, sensor) for folder in (reference, distorted))
    pairs = _matched(first, second)
    if not pairs:
        raise InputValueError(
            f"metrics: no file of {reference} ({_shown(first)}) has the name of one of {distorted} ({_shown(second)})."
        )
    taken = {path for pair in pairs for path in pair}
    left = [tuple(path for path in side if path not in taken) for side in (first, second)]
    return PairsOfFiles(_kind(sorted(taken), sensor), tuple(pairs), left[0], left[1], folders=True)


def _matched(first: list[Path], second: list[Path]) -> list[tuple[Path, Path]]:
    """By the whole name, then by the name without its ending where only one file of each side has it."""
    by_name = {path.name: path for path in second}
    pairs = [(path, by_name[path.name]) for path in first if path.name in by_name]
    taken = {path for pair in pairs for path in pair}
    rest = [[path for path in side if path not in taken] for side in (first, second)]
    counts = [Counter(stem(path)[0] for path in side) for side in rest]
    by_stem = {stem(path)[0]: path for path in rest[1]}
    for path in rest[0]:
        name = stem(path)[0]
        if counts[0][name] == counts[1][name] == 1:
            pairs.append((path, by_stem[name]))
    return sorted(pairs)


def _kind(files: list[Path], sensor: str | None) -> str:
    """Kind of all the files."""
    if sensor is not None:
        return KIND_OF_SENSOR[sensor]
    kinds = {path: _kind_of(path) for path in files}
    known = {kind for kind in kinds.values() if kind}
    if len(known) == 1:
        return known.pop()
    if known:
        image = next(path for path in files if kinds[path] == IMAGES)
        cloud = next(path for path in files if kinds[path] == CLOUDS)
        raise InputValueError(
            f"metrics: {image} is an image, {cloud} a point cloud; give --sensor camera, lidar or radar, and files "
            "that belong together."
        )
    raise InputValueError(
        f"metrics: {files[0]} may be an image or a point cloud; give --sensor camera, lidar or radar."
    )


def _kind_of(path: Path) -> str:
    """Kind of a file by its ending; an archive by the names of its arrays; '' unknown."""
    from torchweather.io import IMAGE_SUFFIXES, POINT_SUFFIXES

    if path.suffix.lower() == ".npz":
        try:
            with zipfile.ZipFile(path) as archive:
                arrays = set(archive.namelist())
        except (OSError, zipfile.BadZipFile):
            return ""  # the reader says what is wrong with it
        return IMAGES if arrays & {*OF_IMAGES} else CLOUDS if arrays & {*OF_CLOUDS} else ""
    return IMAGES if _ends(path, IMAGE_SUFFIXES) else CLOUDS if _ends(path, tuple(POINT_SUFFIXES)) else ""


def _inside(folder: Path, sensor: str | None) -> list[Path]:
    files = [path for path in folder.iterdir() if path.is_file() and not path.name.startswith(".")]
    found = sorted(path for path in files if _ends(path, _endings(sensor)))
    if not found:
        raise InputValueError(f"{folder}: holds no {_wanted(sensor)}; expected {', '.join(_endings(sensor))}.")
    return found


def _endings(sensor: str | None) -> tuple[str, ...]:
    from torchweather.cli.detections import DETECTION_SUFFIXES
    from torchweather.io import IMAGE_SUFFIXES, POINT_SUFFIXES

    known = {
        "camera": IMAGE_SUFFIXES,
        "lidar": tuple(POINT_SUFFIXES),
        "radar": DETECTION_SUFFIXES,
    }
    return tuple(dict.fromkeys((*IMAGE_SUFFIXES, *POINT_SUFFIXES))) if sensor is None else known[sensor]


def _wanted(sensor: str | None) -> str:
    return f"{IMAGES} or {CLOUDS}" if sensor is None else KIND_OF_SENSOR[sensor]


def _ends(path: Path, endings: tuple[str, ...]) -> bool:
    return path.name.lower().endswith(endings)


def _shown(files: tuple[Path, ...] | list[Path]) -> str:
    names = [path.name for path in files[:NAMES_SHOWN]]
    more = len(files) - len(names)
    return ", ".join(names) + (f" and {more} more" if more else "")
