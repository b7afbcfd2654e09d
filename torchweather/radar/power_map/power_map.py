"""RadarPowerMap: power over range and azimuth, and over Doppler and elevation where a radar has them."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import pairwise
from typing import Any

import torch
from torch import Tensor

from torchweather.core.arguments import check_arguments
from torchweather.core.errors import InputValueError, check_between, check_finite, check_one_of
from torchweather.radar.power_map.scale import PowerScale

__all__ = ["MAP_DIMENSIONS", "MapAxes", "RadarPowerMap"]

MAP_DIMENSIONS = {
    "range": "range_m",
    "azimuth": "azimuth_rad",
    "elevation": "elevation_rad",
    "doppler": "speed_m_per_s",
}
"""Dimensions that a map may have, and the axis of ``MapAxes`` that belongs to each."""
NEEDED = ("range",)
TURN_SLACK = 1.5  # steps that the azimuths of a full turn may lack


@dataclass(frozen=True)
class MapAxes:
    """Order of the dimensions of a map and the place of each cell.

    Args:
        dims: names out of ``range``, ``azimuth``, ``elevation``, ``doppler``, in the order of the array; ``range`` is
            needed.
        range_m: middle of each range bin, rising, 0 or more.
        azimuth_rad: of each column, from x (forward) to y (left), any order; ``None`` where a map has no azimuth: it
            looks ahead.
        elevation_rad: up; ``None`` likewise.
        speed_m_per_s: middle of each Doppler bin, evenly spaced over the unambiguous speeds, positive receding.

    Example:
        >>> axes = MapAxes.of_turn(bins=576, bin_m=0.17361, azimuths=400, dims=("range", "azimuth"))
        >>> axes.shape, round(axes.range_bin_m, 5), round(math.degrees(axes.azimuth_bin_rad), 2), axes.full_turn
        ((576, 400), 0.17361, 0.9, True)
    """

    dims: tuple[str, ...]
    range_m: tuple[float, ...]
    azimuth_rad: tuple[float, ...] | None = None
    elevation_rad: tuple[float, ...] | None = None
    speed_m_per_s: tuple[float, ...] | None = None

    def __post_init__(self) -> None:
        check_arguments(
            "MapAxes(dims: Sequence[str], range_m: Sequence, azimuth_rad: Sequence | None, "
            "elevation_rad: Sequence | None, speed_m_per_s: Sequence | None)",
            self.dims,
            self.range_m,
            self.azimuth_rad,
            self.elevation_rad,
            self.speed_m_per_s,
        )
        dims = tuple(self.dims)
        unknown = [name for name in dims if name not in MAP_DIMENSIONS]
        if unknown or len(set(dims)) != len(dims) or any(name not in dims for name in NEEDED):
            raise InputValueError(
                f"MapAxes: dims must be different names out of {', '.join(MAP_DIMENSIONS)}, range among them; got "
                f"{', '.join(map(str, dims)) or 'none'}."
            )
        object.__setattr__(self, "dims", dims)
        for name, axis in MAP_DIMENSIONS.items():
            given = getattr(self, axis)
            if (given is not None) != (name in dims):
                state = "has no values" if given is None else "has values although dims lacks it"
                raise InputValueError(f"MapAxes: {axis} {state}: give it together with {name!r} in dims.")
            if given is not None:
                object.__setattr__(self, axis, _numbers(axis, given))
        ranges = self.range_m
        if len(ranges) < 2 or ranges[0] < 0 or any(b <= a for a, b in pairwise(ranges)):
            raise InputValueError(
                "MapAxes: range_m must be two metres or more of 0 or more, rising; got "
                f"{ranges[:3]}{'...' if len(ranges) > 3 else ''}."
            )

    @classmethod
    def of_turn(
        cls,
        *,
        bins: int,
        bin_m: float,
        azimuths: int,
        dims: Sequence[str] = ("azimuth", "range"),
        start_rad: float = 0.0,
        clockwise: bool = True,
        first_range_m: float | None = None,
    ) -> MapAxes:
        """Axes of a radar that turns: evenly spaced azimuths over a full circle.

        Args:
            bins: of range.
            bin_m: width of one.
            azimuths: of a turn.
            dims: order of the array's dimensions.
            start_rad: azimuth of the first column.
            clockwise: seen from above, as radars of Navtech turn.
            first_range_m: middle of the first bin; ``None``: half a bin.
        """
        check_arguments(
            "MapAxes.of_turn(bins: int, bin_m: float, azimuths: int, dims: Sequence[str], start_rad: float, "
            "clockwise: bool, first_range_m: float | None)",
            bins,
            bin_m,
            azimuths,
            dims,
            start_rad,
            clockwise,
            first_range_m,
        )
        for name, value in (("bins", bins), ("azimuths", azimuths)):
            check_between(name, value, 1, 1 << 20, owner="MapAxes.of_turn")
        first = 0.5 * bin_m if first_range_m is None else first_range_m
        turn = (-1.0 if clockwise else 1.0) * 2.0 * math.pi / azimuths
        return cls(
            tuple(dims),
            tuple(first + bin_m * k for k in range(bins)),
            tuple(start_rad + turn * k for k in range(azimuths)),
        )

    # ---- sizes ---------------------------------------------------------------------------------------------------

    @property
    def shape(self) -> tuple[int, ...]:
        """Of a map."""
        return tuple(len(getattr(self, MAP_DIMENSIONS[name])) for name in self.dims)

    @cached_property
    def range_bin_m(self) -> float:
        """Median width of a range bin."""
        return _median_step(self.range_m)

    @cached_property
    def azimuth_bin_rad(self) -> float:
        """Median step of the azimuth; 0 without azimuths."""
        return 0.0 if self.azimuth_rad is None or len(self.azimuth_rad) < 2 else _median_step(self.azimuth_rad)

    @cached_property
    def speed_bin_m_per_s(self) -> float:
        """Median width of a Doppler bin; 0 without a Doppler axis."""
        return 0.0 if self.speed_m_per_s is None or len(self.speed_m_per_s) < 2 else _median_step(self.speed_m_per_s)

    @cached_property
    def full_turn(self) -> bool:
        """True if the azimuths go around: such a radar turns its beam, others look ahead."""
        if self.azimuth_rad is None or len(self.azimuth_rad) < 8:
            return False
        covered = (len(self.azimuth_rad) + TURN_SLACK) * self.azimuth_bin_rad
        return covered >= 2.0 * math.pi

    def axis(self, name: str, like: Tensor | None = None) -> Tensor:
        """Values of an axis, ``(n,)``; a dimension that the map lacks is the one value 0."""
        check_arguments("MapAxes.axis(name: str, like: Tensor | None)", name, like)
        check_one_of("name", name, MAP_DIMENSIONS, owner="MapAxes.axis")
        values = getattr(self, MAP_DIMENSIONS[name])
        found = torch.tensor((0.0,) if values is None else values, dtype=torch.float64)
        return found if like is None else found.to(like)

    def laid_out(self, values: Tensor, names: Sequence[str]) -> Tensor:
        """A tensor ``(B, *names)`` shaped to broadcast over a batch of maps ``(B, *dims)``.

        Args:
            values: its last dimensions are ``names``; a dimension that the map lacks must have the size 1.
            names: out of ``MAP_DIMENSIONS``.
        """
        kept = [name for name in names if name in self.dims]
        squeezed = values.reshape(values.shape[0], *(values.shape[1 + names.index(name)] for name in kept))
        order = sorted(range(len(kept)), key=lambda place: self.dims.index(kept[place]))
        squeezed = squeezed.permute(0, *(1 + place for place in order))
        present = [kept[place] for place in order]
        sizes = [squeezed.shape[1 + present.index(name)] if name in present else 1 for name in self.dims]
        return squeezed.reshape(values.shape[0], *sizes)

    def to_dict(self) -> dict[str, Any]:
        """Plain values that ``from_dict`` takes."""
        axes = {axis: getattr(self, axis) for axis in MAP_DIMENSIONS.values()}
        return {"dims": list(self.dims), **{name: None if v is None else list(v) for name, v in axes.items()}}

    @classmethod
    def from_dict(cls, values: Mapping[str, Any]) -> MapAxes:
        """The inverse of ``to_dict``."""
        check_arguments("MapAxes.from_dict(values: Mapping[str])", values)
        known = ["dims", *MAP_DIMENSIONS.values()]
        if not {"dims", "range_m"} <= set(values) <= set(known):
            raise InputValueError(
                f"MapAxes.from_dict: expected dims and range_m, and axes among {', '.join(known)}; got "
                f"{', '.join(values) or 'nothing'}."
            )
        for name, value in values.items():
            check_arguments(f"MapAxes.from_dict({name}: Sequence | None)", value)
        given: dict[str, Any] = {key: None if value is None else tuple(value) for key, value in values.items()}
        return cls(**given)


@dataclass(frozen=True, eq=False)
class RadarPowerMap:
    """A map of power as a radar recorded it.

    Args:
        values: numbers as stored, of the shape of ``axes``.
        axes: order and place of the cells.
        scale: what the numbers mean.
        record: what the file holds besides, for the writer; ``None`` for a map that came from none.
        notes: how axes and scale were found, in words.

    Example:
        >>> axes = MapAxes.of_turn(bins=4, bin_m=0.5, azimuths=8)
        >>> power_map = RadarPowerMap(torch.full((8, 4), 40, dtype=torch.uint8), axes, PowerScale.steps(0.5))
        >>> float(power_map.decibels[0, 0]), power_map.range_bin_m
        (20.0, 0.5)
    """

    values: Tensor
    axes: MapAxes
    scale: PowerScale
    record: Any = field(default=None, repr=False)
    notes: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        check_arguments(
            "RadarPowerMap(values: Tensor, axes: MapAxes, scale: PowerScale, notes: Sequence)",
            self.values,
            self.axes,
            self.scale,
            self.notes,
        )
        if tuple(self.values.shape) != self.axes.shape:
            named = " x ".join(f"{name} {size}" for name, size in zip(self.axes.dims, self.axes.shape, strict=True))
            raise InputValueError(f"RadarPowerMap: values must have shape {named}; got {tuple(self.values.shape)}.")
        self.scale.check(self.values)

    @property
    def decibels(self) -> Tensor:
        """Power in dB, of the map's shape."""
        return self.scale.decibels(self.values)

    @property
    def range_bin_m(self) -> float:
        """Width of a range bin."""
        return self.axes.range_bin_m

    @property
    def azimuth_bin_rad(self) -> float:
        """Step of the azimuth; 0 without azimuths."""
        return self.axes.azimuth_bin_rad

    def with_values(self, values: Tensor) -> RadarPowerMap:
        """The same map with other numbers, as a transform gives them."""
        return replace(self, values=values)

    def with_scale(self, scale: PowerScale) -> RadarPowerMap:
        """The same numbers, read by another scale."""
        return replace(self, scale=scale)


def _numbers(name: str, values: Sequence[float] | Tensor) -> tuple[float, ...]:
    check_arguments(f"MapAxes({name}: real(N) | Sequence[float])", values)
    listed = values.detach().double().tolist() if isinstance(values, Tensor) else [float(value) for value in values]
    if not listed:
        raise InputValueError(f"MapAxes: {name} must hold one value or more; got none.")
    check_finite(name, torch.tensor(listed, dtype=torch.float64), owner="MapAxes")
    return tuple(listed)


def _median_step(values: tuple[float, ...]) -> float:
    steps = torch.tensor(values, dtype=torch.float64).diff().abs()
    return float(steps.median())
