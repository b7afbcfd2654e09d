"""The frame of a cloud and that of the sensor that took it: where the sensor stands and which way it looks.

A cloud may lie in the frame of the vehicle (Waymo: the origin is the rear axle) while a LiDAR's beams start at the
sensor. ``Lidar.origin_m`` and ``Lidar.rotation`` say where:

``p_cloud = rotation @ p_sensor + origin_m``; the columns of the rotation are the sensor's x, y, z in the cloud's frame.
"""

from __future__ import annotations

import math
import sys
from collections.abc import Sequence

import torch
from torch import Tensor

from torchweather.core.compiled import uses_compiled
from torchweather.lidar.pose import Rotation
from torchweather.lidar.sensor import Lidar

__all__ = ["points_in_cloud_frame", "points_in_sensor_frame"]


def is_apart(lidar: Lidar) -> bool:
    """Tell whether the sensor's frame differs from the cloud's."""
    return lidar.rotation is not None or any(lidar.origin_m)


def points_in_sensor_frame(points: Tensor, lidar: Lidar) -> Tensor:
    """A cloud in the sensor's frame; rows at the cloud's origin hold no return and stay there.

    Args:
        points: ``(..., N, 3 or more)`` in the cloud's frame: x, y, z in metres, further columns.
        lidar: with ``origin_m`` and ``rotation``.

    Returns:
        ``(..., N, 3 or more)``, the further columns as they are; ``points`` itself where the frames are the same.

    Example:
        >>> from torchweather.sensors import Lidar
        >>> lidar = Lidar(905.0, origin_m=(1.0, 0.0, 2.0))
        >>> points_in_sensor_frame(torch.tensor([[11.0, 5.0, 0.0, 9.0], [0.0, 0.0, 0.0, 0.0]]), lidar)
        tensor([[10.,  5., -2.,  9.],
                [ 0.,  0.,  0.,  0.]])
    """
    if not is_apart(lidar):
        return points
    here, more = points[..., :3].unbind(-1), points[..., 3:].unbind(-1)
    wide = here if _in_graph() else tuple(column.double() for column in here)
    local: Sequence[Tensor] = [
        column - offset if offset else column for column, offset in zip(wide, lidar.origin_m, strict=True)
    ]
    if lidar.rotation is not None:
        local = _turned(local, lidar.rotation, back=False)
    there = holds_return(points)
    columns = [torch.where(there, column.to(points), 0.0) for column in local]
    return torch.stack([*columns, *more], -1)


def points_in_cloud_frame(
    values: Tensor,
    local: Tensor,
    given: Tensor,
    lidar: Lidar,
    height_m: Tensor | None = None,
    *,
    in_place: bool = False,
) -> Tensor:
    """A result in the cloud's frame; rows that nothing moved have the bits that they came with.

    Args:
        values: ``(..., N, C)`` in the sensor's frame, from where each beam starts.
        local: ``(..., N, C)`` the cloud that went in, likewise; rows of 0 where it was completed.
        given: ``(..., M, C)`` the same as it came, M <= N, in the cloud's frame.
        lidar: with ``origin_m`` and ``rotation``.
        height_m: ``(..., N)`` at which the beams start over the sensor's origin; ``None`` is 0.
        in_place: the values may be written anew.

    Returns:
        ``(..., N, C)`` in the dtype of ``values``; rows of 0 (lost) stay so.
    """
    if not is_apart(lidar) and height_m is None:
        return values
    if not is_apart(lidar) and height_m is not None and are_plain(values, local, given, height_m):
        return _raised(values, local, given, height_m, in_place)
    x, y, z = values[..., :3].unbind(-1)
    start_x, start_y, start_z = local[..., :3].unbind(-1)
    untouched = (x == start_x) & (y == start_y) & (z == start_z)
    there = holds_return(values)
    more = values.shape[-2] - given.shape[-2]

    def column(moved: Tensor, place: int) -> Tensor:
        came = given[..., place].to(values)
        own = torch.nn.functional.pad(came, (0, more)) if more else came
        return torch.where(untouched, own, torch.where(there, moved.to(values), 0.0))

    if not is_apart(lidar):
        assert height_m is not None
        return with_column(values, 2, column(z + height_m.to(z) if _in_graph() else z.double() + height_m.double(), 2))
    wide: Sequence[Tensor] = (x, y, z) if _in_graph() else (x.double(), y.double(), z.double())
    if height_m is not None:
        wide = [*wide[:2], wide[2] + height_m.to(wide[2])]
    if lidar.rotation is not None:
        wide = _turned(wide, lidar.rotation, back=True)
    moved = [column(one + offset, place) for place, (one, offset) in enumerate(zip(wide, lidar.origin_m, strict=True))]
    return torch.stack([*moved, *values[..., 3:].unbind(-1)], -1)


def with_column(points: Tensor, place: int, values: Tensor) -> Tensor:
    """A cloud ``(..., N, C)`` with one of its columns replaced by ``(..., N)``."""
    if _in_graph():
        columns = list(points.unbind(-1))
        columns[place] = values
        return torch.stack(columns, -1)
    changed = points.clone()
    changed[..., place] = values
    return changed


def holds_return(points: Tensor) -> Tensor:
    """Rows of a cloud ``(..., N, 3 or more)`` that do not lie at the origin, ``(..., N)`` bool."""
    x, y, z = points[..., :3].unbind(-1)
    return (x != 0) | (y != 0) | (z != 0)


def are_plain(*values: Tensor) -> bool:
    """True where compiled loops may work on all: some points, single precision on the processor, no gradients."""
    if _in_graph() or not uses_compiled():
        return False
    learns = torch.is_grad_enabled()
    return all(
        one.device.type == "cpu"
        and one.dtype == torch.float32
        and one.numel() > 0
        and not (learns and one.requires_grad)
        for one in values
    )


def _raised(values: Tensor, local: Tensor, given: Tensor, height_m: Tensor, in_place: bool) -> Tensor:
    """`points_in_cloud_frame` of a sensor at the cloud's origin, by compiled loops: the same bits."""
    from torchweather.lidar.compiled_rows import raise_rows

    storages = {one.untyped_storage().data_ptr() for one in (local, given)}
    own = in_place and values.is_contiguous() and values.untyped_storage().data_ptr() not in storages
    out = values if own else torch.empty(values.shape)
    flat = [one.reshape(-1, *one.shape[-2:]) for one in (out, values, local, given)]
    heights = height_m.expand(values.shape[:-1]).reshape(len(flat[0]), -1)
    for sample, height in enumerate(heights):
        raised, moved, start, came = (one[sample].detach().contiguous().numpy() for one in flat)
        single = height[:1] if height.stride(0) == 0 else height
        raise_rows(raised, moved, start, came, single.detach().contiguous().numpy(), not own)
    return out


def _in_graph() -> bool:
    """True while a graph is made, which computes in single precision."""
    if torch.compiler.is_compiling():
        return True
    # To import torch.onnx takes a fifth of a second; what is not imported exports nothing.
    return "torch.onnx" in sys.modules and torch.onnx.is_in_onnx_export()


def _turned(columns: Sequence[Tensor], rotation: Rotation, *, back: bool) -> Sequence[Tensor]:
    """Columns x, y, z times a rotation: out of the cloud's frame, or ``back`` into it."""
    xyz = torch.stack(list(columns), -1)
    turn = xyz.new_tensor(rotation)
    return (xyz @ (turn.T if back else turn)).unbind(-1)


def directions_in_sensor_frame(directions: Tensor | None, lidar: Lidar) -> Tensor | None:
    """Directions ``(..., N, 3)`` of the cloud's frame in the sensor's."""
    if directions is None or lidar.rotation is None:
        return directions
    return directions @ directions.new_tensor(lidar.rotation)


def pose_words(origin_m: Sequence[float], rotation: Rotation | None) -> str:
    """Where a sensor stands, in words.

    Example:
        >>> pose_words((1.43, 0.0, 2.18), None)
        '(1.43, 0.00, 2.18) m'
    """
    place = f"({', '.join(f'{value:.2f}' for value in origin_m)}) m"
    if rotation is None:
        return place
    turned_deg = math.degrees(math.acos(max(-1.0, min(1.0, (sum(rotation[k][k] for k in range(3)) - 1.0) / 2.0))))
    return f"{place}, turned by {turned_deg:.1f} degrees"
