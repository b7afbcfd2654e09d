"""Common parts of the adapters: which keys of a sample hold sensor data, and arrays as tensors and back."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor

from torchweather.core.errors import InputTypeError, InputValueError, nearest_name, owner_name

__all__ = ["Adapter", "array_from_image", "cloud_tensor", "depth_tensor", "image_tensor", "is_return", "without_lost"]

Sample = Mapping[str, Any]
Array = npt.NDArray[Any]


@dataclass(frozen=True, eq=False)
class Adapter:
    """A transform of samples, and the keys that it is to find as tensors; all other keys pass through.

    Args:
        transform: takes a dictionary and gives a dictionary, such as ``Compose``. Under the keys below it finds tensors
            in this library's shapes.
        clouds: keys of point clouds and lists of detections, ``(N, C)``.
        images: keys of images.
        depths: keys of depth maps, metres; they come back as they were.
        drop_lost: leave out rows without a return (x = y = z = 0, or NaN), which a detector would take for points at
            the sensor.
    """

    transform: Callable[[dict[str, Any]], Sample]
    clouds: Sequence[str] = ("points",)
    images: Sequence[str] = ()
    depths: Sequence[str] = ()
    drop_lost: bool = True

    def __post_init__(self) -> None:
        for name in ("clouds", "images", "depths"):
            if isinstance(getattr(self, name), str):
                raise InputTypeError(
                    f"{owner_name(self)}: {name} must be a sequence of keys, ({getattr(self, name)!r},); got "
                    f"{getattr(self, name)!r}."
                )

    def _check_keys(self, sample: Sample) -> None:
        for key in (*self.clouds, *self.images, *self.depths):
            if key not in sample:
                raise InputValueError(
                    f"{owner_name(self)}: expected the key {key!r}; the sample has {', '.join(map(str, sample))}."
                    f"{nearest_name(key, map(str, sample))} Say which keys hold data with clouds=, images= and depths=."
                )


def cloud_tensor(value: object) -> Tensor:
    """A cloud ``(N, C)`` out of an array, a tensor or lists; integers and lists become float32."""
    if isinstance(value, Tensor):
        return value
    array = np.array(value) if isinstance(value, np.ndarray) else np.array(value, np.float32)
    return torch.from_numpy(array if array.dtype.kind == "f" else array.astype(np.float32))


def without_lost(cloud: Tensor) -> Tensor:
    """The rows that are returns.

    Example:
        >>> without_lost(torch.tensor([[0.0, 0, 0, 7], [1, 0, 0, 7]]))
        tensor([[1., 0., 0., 7.]])
    """
    return cloud[is_return(cloud)]


def is_return(cloud: Tensor) -> Tensor:
    """Mask ``(N,)`` of the rows of a cloud ``(N, 3 or more)`` that are returns."""
    xyz = cloud[:, :3]
    return (xyz != 0).any(1) & torch.isfinite(xyz).all(1)


def image_tensor(value: object, *, bgr: bool = False, float_white: float = 1.0) -> Tensor:
    """An image ``(C, H, W)`` out of an array ``(H, W)`` or ``(H, W, C)``, or of a picture of Pillow's.

    Args:
        value: uint8, uint16 or float; a tensor stays as it is.
        bgr: the channels are blue, green, red.
        float_white: value of white where the array is float; the tensor has 1.
    """
    if isinstance(value, Tensor):
        return value
    mode = getattr(value, "mode", None)
    if mode is not None and mode not in ("RGB", "L", "I;16"):
        value = value.convert("RGB")  # type: ignore[attr-defined]
    array = np.asarray(value)
    if array.dtype.kind not in "uf" or array.ndim not in (2, 3):
        raise InputTypeError(
            "image: expected (H, W) or (H, W, C) of uint8, uint16 or float, or a picture; got "
            f"{type(value).__name__} {array.dtype} {array.shape}. Views of several cameras go under keys of their own."
        )
    array = array[..., None] if array.ndim == 2 else array
    array = array[..., ::-1] if bgr and array.shape[-1] == 3 else array
    tensor = torch.from_numpy(np.array(array.transpose(2, 0, 1), order="C"))
    return tensor / float_white if tensor.is_floating_point() and float_white != 1.0 else tensor


def array_from_image(image: Tensor, like: Array, *, bgr: bool = False, float_white: float = 1.0) -> Array:
    """The image as an array in the shape, dtype and range of the one that it was: the inverse of `image_tensor`."""
    array = image.numpy().transpose(1, 2, 0)
    array = array[..., ::-1] if bgr and array.shape[-1] == 3 else array
    array = array * array.dtype.type(float_white) if like.dtype.kind == "f" and float_white != 1.0 else array
    found: Array = np.ascontiguousarray(array.reshape(like.shape), dtype=like.dtype)
    return found


def depth_tensor(value: object) -> Tensor:
    """A depth map ``(1, H, W)``, metres, out of ``(H, W)``, ``(H, W, 1)`` or ``(1, H, W)``."""
    tensor = value if isinstance(value, Tensor) else cloud_tensor(value)
    if tensor.ndim == 3 and tensor.shape[-1] == 1 and tensor.shape[0] != 1:
        tensor = tensor[..., 0]
    return tensor[None] if tensor.ndim == 2 else tensor
