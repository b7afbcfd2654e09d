"""Coefficients of a weather as a table over the logarithm of its intensity (rain rate, visibility)."""

from __future__ import annotations

import math
from collections.abc import Callable

import torch
from torch import Tensor

from torchweather.core.arguments import call_given, check_arguments
from torchweather.core.errors import InputValueError, check_between, check_positive
from torchweather.core.precision import AtLeastSingle

__all__ = ["InterpolationTable"]


class InterpolationTable(AtLeastSingle):
    """Values of a function of the intensity, computed once and then interpolated: a new rate costs no set-up.

    The nodes are uniform in ln(intensity). With ``log_values`` the interpolation is linear in (ln intensity, ln value),
    that is a power law inside each cell, and the end cells continue as power laws outside ``[low, high]``. Without, it
    is linear in (ln intensity, value) and the end values are held. ``forward`` is elementwise plus a gather:
    differentiable in the intensity, and it exports to ONNX.

    Args:
        function: intensity ``(n,)``, float64, to values ``(n, *value_shape)``; above 0 where ``log_values``.
        low: smallest node of the intensity, above 0, in the intensity's unit.
        high: largest node.
        n: number of nodes, 2 or more.
        log_values: interpolate ln(value) (for coefficients that span decades).
        zero_at_zero: the intensity 0 (no rain) gives exactly 0 with gradient 0.
        zero_at_inf: the intensity ``inf`` (unlimited visibility) gives exactly 0 with gradient 0.

    Note:
        The error is quadratic in the cell width ln(high / low) / (n - 1); tests hold it below 0.5 % for the users'
        tables.

    References:
        DESIGN.md 2.

    Example:
        >>> table = InterpolationTable(lambda rate: 1e-3 * rate**0.63, 0.1, 300.0, 16, zero_at_zero=True)
        >>> table(torch.tensor([0.0, 1.0, 25.0])).round(decimals=6)
        tensor([0.0000, 0.0010, 0.0076])
    """

    values: Tensor

    def __init__(
        self,
        function: Callable[[Tensor], Tensor],
        low: float,
        high: float,
        n: int = 64,
        log_values: bool = True,
        *,
        zero_at_zero: bool = False,
        zero_at_inf: bool = False,
    ) -> None:
        check_arguments(
            "InterpolationTable(function: Callable, low: float, high: float, n: int, log_values: bool, "
            "zero_at_zero: bool, zero_at_inf: bool)",
            function,
            low,
            high,
            n,
            log_values,
            zero_at_zero,
            zero_at_inf,
        )
        super().__init__()
        check_positive("low", low, owner=self)
        check_between("n", n, 2, 1 << 20, owner=self)
        if not (high > low and math.isfinite(high)) or n < 2:
            raise InputValueError(
                f"InterpolationTable: expected low < high < inf and 2 nodes or more; got {low!r}, {high!r}, n={n!r}."
            )
        self.low, self.high, self.n, self.log_values = float(low), float(high), int(n), log_values
        self.zero_at_zero, self.zero_at_inf = zero_at_zero, zero_at_inf
        self._step = math.log(high / low) / (n - 1)
        with torch.no_grad():
            nodes = torch.exp(math.log(low) + torch.arange(n, dtype=torch.float64) * self._step)
            found = call_given("InterpolationTable", "function", function, nodes)
            check_arguments("InterpolationTable(values_of_function: real)", found)
            values = found.to(torch.float64)
            if values.ndim < 1 or values.shape[0] != n:
                raise InputValueError(
                    f"InterpolationTable: function must give shape ({n}, ...); got {tuple(values.shape)}."
                )
            if not bool(torch.isfinite(values).all()):
                raise InputValueError(
                    f"InterpolationTable: function gave values that are not finite between {low:g} and {high:g}."
                )
            if log_values:
                check_positive(
                    "function(intensity)", values, owner=self, advice="Use log_values=False for values with 0."
                )
                values = torch.log(values)
        self.register_buffer("values", values)

    @property
    def value_shape(self) -> torch.Size:
        """Shape of the value at one intensity."""
        return self.values.shape[1:]

    def forward(self, intensity: Tensor) -> Tensor:
        """Value at each intensity, ``(..., *value_shape)``, in the intensity's dtype (float32 or float64)."""
        intensity = torch.as_tensor(intensity)
        none = torch.zeros_like(intensity, dtype=torch.bool)
        if self.zero_at_zero:
            none = none | (intensity <= 0)
        if self.zero_at_inf:
            none = none | torch.isinf(intensity)
        # Taken out before the logarithm as well as after it: a gradient through ln 0 would be nan times 0.
        safe = torch.where(none, torch.full_like(intensity, self.low), intensity)
        position = (torch.log(safe) - math.log(self.low)) / self._step
        # Clamped as integers too, because the floor of nan is any integer; nan then comes out as nan.
        index = position.detach().floor().clamp(0, self.n - 2).to(torch.int64).clamp(0, self.n - 2)
        weight = position - index
        if not self.log_values:
            weight = weight.clamp(0.0, 1.0)
        values = self.values.to(device=intensity.device, dtype=intensity.dtype)
        before, after = values[index], values[index + 1]
        trailing = (1,) * len(self.value_shape)
        weight = weight.reshape(weight.shape + trailing)
        value = before + weight * (after - before)
        if self.log_values:
            value = torch.exp(value)
        return torch.where(none.reshape(none.shape + trailing), torch.zeros_like(value), value)

    def extra_repr(self) -> str:
        """Range and size, for ``print(module)``."""
        return f"low={self.low:g}, high={self.high:g}, n={self.n}, value_shape={tuple(self.value_shape)}"
