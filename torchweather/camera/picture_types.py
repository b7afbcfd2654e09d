"""Pictures as users hold them, as tensors and back: tensors, numpy arrays, PIL images."""

from __future__ import annotations

import sys
from collections.abc import Callable
from typing import Any

import numpy as np
import torch
from torch import Tensor

from torchweather.core.errors import InputTypeError, InputValueError

__all__ = ["is_picture", "picture_tensor"]

Back = Callable[[Tensor], Any]


def is_picture(value: Any) -> bool:
    """Check whether `picture_tensor` takes it."""
    return isinstance(value, (Tensor, np.ndarray)) or _is_pil(value)


def _is_pil(value: Any) -> bool:
    # Without importing PIL: where a PIL image came from, PIL is loaded.
    module = sys.modules.get("PIL.Image")
    return module is not None and isinstance(value, module.Image)


def picture_tensor(picture: Any, owner: str) -> tuple[Tensor, Back]:
    """A picture as ``(..., 3, H, W)``, and what brings a result into the picture's own type.

    Args:
        picture: a tensor ``(..., 3, H, W)`` (subclasses such as torchvision's ``Image`` come back as such); a numpy
            array ``(..., H, W, 3)``; a PIL image of mode RGB.
        owner: named in errors.
    """
    if isinstance(picture, Tensor):
        kind = type(picture)
        if kind is Tensor:
            return picture, lambda result: result
        return picture.as_subclass(Tensor), lambda result: result.as_subclass(kind)
    if isinstance(picture, np.ndarray):
        if picture.ndim < 3 or picture.shape[-1] != 3:
            first = picture.ndim >= 3 and picture.shape[-3] == 3
            advice = " Channels come last in numpy: np.moveaxis(picture, -3, -1), or give a tensor." if first else ""
            raise InputValueError(f"{owner}: a numpy picture must be (..., H, W, 3); got {picture.shape}.{advice}")
        tensor = torch.from_numpy(np.ascontiguousarray(np.moveaxis(picture, -1, -3)))
        return tensor, lambda result: np.ascontiguousarray(np.moveaxis(result.cpu().numpy(), -3, -1))
    if _is_pil(picture):
        if picture.mode != "RGB":
            raise InputValueError(
                f"{owner}: a PIL image must be of mode RGB; got {picture.mode}. Use image.convert('RGB')."
            )
        tensor = torch.from_numpy(np.array(picture)).movedim(-1, -3)
        from_array = sys.modules["PIL.Image"].fromarray
        return tensor, lambda result: from_array(np.ascontiguousarray(result.movedim(-3, -1).cpu().numpy()))
    raise InputTypeError(
        f"{owner}: expected a picture: a tensor (..., 3, H, W), a numpy array (..., H, W, 3) or a PIL image; got "
        f"{type(picture).__name__}."
    )
