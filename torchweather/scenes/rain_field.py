"""The part of a scene that sprinklers fill with drops: a box, and the way of each ray through it."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from torchweather.core.arguments import check_arguments
from torchweather.core.errors import InputValueError, check_finite
from torchweather.scenes.primitives import Point

__all__ = ["RainField"]


@dataclass(frozen=True)
class RainField:
    """A box of air with weather in it, its edges along the axes of the vehicle frame.

    Args:
        low_m: its least x, y, z, metres.
        high_m: its greatest x, y, z, metres, each above ``low_m``.

    Example:
        >>> field = RainField((0.0, -2.5, 0.0), (50.0, 2.5, 5.0))
        >>> enter, leave = field.crossing_m((0.0, 0.0, 1.5), torch.tensor([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]))
        >>> enter.tolist(), leave.tolist()
        ([0.0, 0.0], [50.0, 2.5])
    """

    low_m: Point
    high_m: Point

    def __post_init__(self) -> None:
        check_arguments("RainField(low_m: Sequence[float], high_m: Sequence[float])", self.low_m, self.high_m)
        for name in ("low_m", "high_m"):
            corner = tuple(float(one) for one in getattr(self, name))
            if len(corner) != 3:
                raise InputValueError(f"RainField: {name} must be x, y, z in metres; got {getattr(self, name)!r}.")
            check_finite(name, torch.tensor(corner), unit="m", owner=self)
            object.__setattr__(self, name, corner)
        if not all(low < high for low, high in zip(self.low_m, self.high_m, strict=True)):
            raise InputValueError(
                f"RainField: expected low_m below high_m in x, y and z, metres; got {self.low_m} and {self.high_m}."
            )

    def crossing_m(self, origin_m: Tensor | Point, direction: Tensor) -> tuple[Tensor, Tensor]:
        """Entry and exit of rays in the field, metres along the ray; both 0 for a ray that never meets it.

        Slab method (Kay and Kajiya 1986, Ray tracing complex scenes).

        Args:
            origin_m: start of all rays in the vehicle frame, ``(3,)``.
            direction: ``(..., 3)``, any length above zero.

        Returns:
            Two tensors ``(...)``, 0 to infinity; the first is 0 where the ray starts inside.
        """
        check_arguments("RainField.crossing_m(direction: Tensor)", direction)
        if direction.shape[-1:] != (3,) or not direction.is_floating_point():
            raise InputValueError(
                "RainField.crossing_m: direction must be a float tensor of shape (..., 3) = x, y, z; "
                f"got {direction.dtype} {tuple(direction.shape)}."
            )
        unit = torch.nn.functional.normalize(direction, dim=-1)
        origin = torch.as_tensor(origin_m, dtype=unit.dtype, device=unit.device)
        low, high = (unit.new_tensor(edge) - origin for edge in (self.low_m, self.high_m))
        # A ray along a face's plane divides 0 by 0; next to nothing in its place keeps it inside.
        slope = torch.where(unit == 0, torch.finfo(unit.dtype).tiny, unit)
        first, second = low / slope, high / slope
        enter = torch.minimum(first, second).amax(-1).clamp_min(0.0)
        leave = torch.maximum(first, second).amin(-1)
        met = leave > enter
        none = torch.zeros_like(leave)
        return torch.where(met, enter, none), torch.where(met, leave, none)
