"""Radial speeds of a scene at rest, for clouds that have none of their own."""

from __future__ import annotations

import torch
from torch import Tensor

from torchweather.core.arguments import check_arguments
from torchweather.core.errors import check_between

__all__ = ["static_speed_m_per_s"]


def static_speed_m_per_s(points: Tensor, ego_speed_m_per_s: float) -> Tensor:
    """Radial speed of a scene at rest as a Doppler LiDAR on a moving vehicle measures it, positive away.

    Args:
        points: ``(..., N, 3 or more)`` x forward, y left, z up in metres, the sensor at the origin.
        ego_speed_m_per_s: of the vehicle, forward.

    Returns:
        ``(..., N)`` m/s: ``-v x / R``; 0 for rows without return.

    Example:
        A cloud without speeds gets the column that ``Lidar(speed_column=4)`` takes.

        >>> cloud = torch.tensor([[30.0, 0.0, 0.0, 0.2], [3.0, 4.0, 0.0, 0.5]])
        >>> torch.cat([cloud, static_speed_m_per_s(cloud, 20.0)[:, None]], -1)[:, 4]
        tensor([-20., -12.])
    """
    check_arguments(
        "static_speed_m_per_s(points: floating(..., N, 3+), ego_speed_m_per_s: float)", points, ego_speed_m_per_s
    )
    check_between("ego_speed_m_per_s", ego_speed_m_per_s, -100.0, 100.0, unit="m/s", owner="static_speed_m_per_s")
    range_m = points[..., :3].norm(dim=-1)
    return -float(ego_speed_m_per_s) * points[..., 0] / torch.where(range_m > 0, range_m, 1.0)
