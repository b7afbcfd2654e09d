"""The depth of a frame as it is named on the command line."""

from __future__ import annotations

from pathlib import Path

from torch import Tensor

from torchweather.camera.depth import AUTO, ConstantDepth, DepthMap, DepthSource, FlatGround, ScenePrior
from torchweather.io.depth import read_depth

__all__ = ["depth_source"]

GROUND = "ground"
DEPTH_SUFFIXES = (".npy", ".npz", ".png", ".tif", ".tiff")


def depth_source(text: str, encoding: str | None, frame: Path) -> DepthSource:
    """The depth of a frame.

    Args:
        text: a file, a folder with a map of the frame's name, one number of metres, ``ground``, or ``auto``: guessed
            from the picture.
        encoding: of integer maps, as `read_depth` takes it.
        frame: path of the image.
    """
    if text == GROUND:
        return FlatGround()
    if text == AUTO:
        return ScenePrior()
    try:
        return ConstantDepth(float(text))
    except ValueError as error:
        if "could not convert" not in str(error):
            raise
    path = Path(text)
    if path.is_dir():
        path = _same_name(path, frame)
    elif not path.exists():
        raise ValueError(f"--depth must be a file, a folder, a number of metres, {GROUND!r} or {AUTO!r}; got {text!r}.")
    depth: Tensor = read_depth(path, encoding)
    return DepthMap(depth)


def _same_name(folder: Path, frame: Path) -> Path:
    for suffix in DEPTH_SUFFIXES:
        found = folder / (frame.stem + suffix)
        if found.is_file():
            return found
    raise ValueError(f"{folder}: no depth map for {frame.name}; wanted {frame.stem} with {', '.join(DEPTH_SUFFIXES)}.")
