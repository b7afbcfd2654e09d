"""Check of a camera study's scene: another one in weather than in clear air, or the same.

What stands elsewhere has edges that the clear frames lack, the same ones in every condition. Drops on the window are
elsewhere in each condition, streaks in each frame; fog and blur take edges away; wet roads mirror, and are left out.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import combinations
from typing import TypeVar

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from torchweather.camera.sensor import Camera
from torchweather.core.errors import InputValueError, TorchweatherError, check_one_of
from torchweather.gap.study.conditions import StudyContent

__all__ = ["MOST_IGNORED", "changed_parts", "described", "part_names", "refuse_changed", "with_parts_ignored"]

S = TypeVar("S", bound=StudyContent)

WINDOW = 8  # blocks that a part of the picture is high and wide
FEWEST_WINDOWS = 3
UNEXPLAINED = 0.6  # of the energy of edges, that the clear scene does not explain
TOGETHER = 0.7  # correlation of what is not explained in two conditions
STRONG = 0.03  # root mean square of the unexplained logarithm of neighbouring blocks' ratio
MOSTLY = 0.5
BLOCK_PX = 4
SIDE_PX = BLOCK_PX * WINDOW  # of a part
MOST_NAMED = 6
MOST_IGNORED = 24  # parts that the error offers to ignore; where more changed, the camera may have moved
PART = re.compile(r"(?P<scene>.+):(?P<row>\d{1,6}),(?P<column>\d{1,6})")


def refuse_changed(
    scene: str,
    measured: Mapping[str, Tensor],
    modelled: Mapping[str, Tensor],
    level: Tensor | None,
    left_out: Tensor | None = None,
) -> None:
    """Raise where parts of the picture show, in two conditions alike, what the clear scene does not have.

    Args:
        scene: id.
        measured: condition to the mean logarithm of blocks ``(h, w)`` over its frames.
        modelled: condition to the same of the clear scene in its weather.
        level: ``(h, w)`` which blocks lie on level ground; ``None``: not known.
        left_out: ``(H, W)`` pixels of the frame that do not count; ``None``: none. Parts with one are left out.

    Raises:
        TorchweatherError: the scene changed.
    """
    places, number = changed_parts(measured, modelled, level, left_out)
    if places:
        raise TorchweatherError(
            f"find_gap: {described(scene, places, number)} Something moved, or the camera did. Take clear frames of "
            "the scene as it is in weather, leave these conditions out, or put what moved in the scene's mask."
            f"{_offer(scene, places)}"
        )


def changed_parts(
    measured: Mapping[str, Tensor],
    modelled: Mapping[str, Tensor],
    level: Tensor | None,
    left_out: Tensor | None = None,
) -> tuple[list[tuple[int, int]], int]:
    """First row and column of the parts that changed, none where they are fewer than three, and the number of all.

    Arguments as of `refuse_changed`.
    """
    names = list(measured)
    if len(names) < 2:
        return [], 0
    left, share = {}, {}
    for name in names:
        after, before = _edges(measured[name]), _edges(modelled[name])
        energy = _windows(after.square()).clamp_min(1e-12)
        slope = _windows(after * before) / _windows(before.square()).clamp_min(1e-12)
        left[name] = after - _spread(slope, after.shape[-2:]) * before
        share[name] = _windows(left[name].square()) / energy
    standing = torch.ones_like(share[names[0]], dtype=torch.bool)
    if level is not None:
        # Of both differences alike.
        standing = _windows(level[None, :-1, :-1].float().expand(2, -1, -1)) / (2 * WINDOW**2) < MOSTLY
    if left_out is not None:
        standing &= _windows(_blocks(left_out, names, measured)[None, :-1, :-1].expand(2, -1, -1)) == 0
    changed = torch.zeros_like(standing)
    for one, other in combinations(names, 2):
        own, its = (_windows(left[name].square()) for name in (one, other))
        together = _windows(left[one] * left[other]) / (own * its).clamp_min(1e-24).sqrt()
        strong = torch.minimum(own, its) / (2 * WINDOW**2) > STRONG**2
        changed |= standing & strong & (together > TOGETHER) & (torch.minimum(share[one], share[other]) > UNEXPLAINED)
    places = [(SIDE_PX * row, SIDE_PX * column) for row, column in changed.nonzero().tolist()]
    return places if len(places) >= FEWEST_WINDOWS else [], changed.numel()


def described(scene: str, places: Sequence[tuple[int, int]], number: int) -> str:
    """Parts of a picture that changed, in words.

    Args:
        scene: id.
        places: first row and column of each part.
        number: of all parts of the picture.
    """
    parts = ", ".join(f"({row}, {column})" for row, column in places[:MOST_NAMED])
    more = "" if len(places) <= MOST_NAMED else f" and {len(places) - MOST_NAMED} more"
    return (
        f"scene changed: in weather {len(places)} of {number} parts of the picture of scene {scene} show edges that "
        f"its clear frames do not have, the same in several conditions: {SIDE_PX} x {SIDE_PX} px from (row, column) "
        f"{parts}{more}."
    )


def with_parts_ignored(study: S, names: Sequence[str], owner: str = "find_gap") -> S:
    """The study with parts of the picture added to the masks of its scenes, so that they are no change of a scene.

    Args:
        study: of a camera.
        names: ``SCENE:ROW,COLUMN`` each, the first pixel of a part of 32 x 32 px, as the error of `refuse_changed` has
            them.

    Raises:
        InputTypeError: a study of another sensor.
        InputValueError: an unknown scene, or no part of its picture.
    """
    if not names:
        return study
    study.sensor_as(Camera)
    masks: dict[str, NDArray[np.uint8]] = {}
    for name in names:
        found = PART.fullmatch(name.strip())
        if found is None:
            raise InputValueError(
                f"{owner}: ignore_parts must be SCENE:ROW,COLUMN, such as s0:0,32; got {name!r}. "
                'Take the names from the error "scene changed".'
            )
        scene_id, row, column = found["scene"], int(found["row"]), int(found["column"])
        check_one_of("scene of ignore_parts", scene_id, study.scenes, owner=owner)
        scene = study.scenes[scene_id]
        height, width = np.shape(scene.clear[0]["bayer"])[-2:]
        if row % SIDE_PX or column % SIDE_PX or row + SIDE_PX > height or column + SIDE_PX > width:
            raise InputValueError(
                f"{owner}: ignore_parts: expected a row and a column that are multiples of {SIDE_PX} px within the "
                f'picture of {height} x {width} px; got {name}. Take the names from the error "scene changed".'
            )
        if scene_id not in masks:
            masks[scene_id] = np.array(scene.geometry.get("mask", np.zeros((height, width))) != 0, dtype=np.uint8)
        masks[scene_id][row : row + SIDE_PX, column : column + SIDE_PX] = 1
    scenes = {
        name: replace(scene, geometry={**scene.geometry, "mask": masks[name]}) if name in masks else scene
        for name, scene in study.scenes.items()
    }
    return replace(study, scenes=scenes)


def _offer(scene: str, places: Sequence[tuple[int, int]]) -> str:
    """Advice for going on in spite of few parts."""
    if len(places) > MOST_IGNORED:
        return ""
    names = part_names(scene, places)
    return f" To search all the same, ignore these parts: --ignore-parts {names}, or find_gap(ignore_parts=...)."


def part_names(scene: str, places: Sequence[tuple[int, int]]) -> str:
    """Parts as `with_parts_ignored` takes them, with spaces between."""
    return " ".join(f"{scene}:{row},{column}" for row, column in places)


def _blocks(left_out: Tensor, names: Sequence[str], measured: Mapping[str, Tensor]) -> Tensor:
    """1 for each block ``(h, w)`` that holds a pixel which does not count."""
    rows, columns = measured[names[0]].shape
    cut = left_out[: BLOCK_PX * rows, : BLOCK_PX * columns].float()
    return cut.reshape(rows, BLOCK_PX, columns, BLOCK_PX).amax((1, 3))


def _edges(level: Tensor) -> Tensor:
    """Differences of neighbouring blocks, across and down, ``(2, h - 1, w - 1)``."""
    return torch.stack([level[:-1, 1:] - level[:-1, :-1], level[1:, :-1] - level[:-1, :-1]])


def _windows(values: Tensor) -> Tensor:
    """Sums over windows and both differences ``(H, W)``; what is left at the ends is left out."""
    rows, columns = (size // WINDOW for size in values.shape[-2:])
    cut = values[:, : rows * WINDOW, : columns * WINDOW]
    return cut.reshape(2, rows, WINDOW, columns, WINDOW).sum((0, 2, 4))


def _spread(values: Tensor, size: Sequence[int]) -> Tensor:
    """A value of each window for its blocks ``(h, w)``, 0 outside of all."""
    found = torch.zeros(*size)
    whole = values.repeat_interleave(WINDOW, 0).repeat_interleave(WINDOW, 1)
    found[: whole.shape[0], : whole.shape[1]] = whole
    return found
