"""MapLayout: what the file of a radar power map does not say of itself, by name of a data set or from a YAML file."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from torchweather.core.arguments import check_arguments
from torchweather.core.errors import InputValueError, TorchweatherError, check_one_of
from torchweather.core.schema import NUMBERS, Key, check_keys, field_keys
from torchweather.core.yaml_file import read_yaml
from torchweather.radar.power_map import MAP_DIMENSIONS, MapAxes, PowerScale

__all__ = ["MAP_LAYOUTS", "MapLayout", "map_layout"]

AXES = {"range": "range_m", "azimuth": "azimuth_deg", "elevation": "elevation_deg", "doppler": "speed_m_per_s"}
PLAIN_SCALES = ("linear", "amplitude", "complex", "db", "db_steps")
Axis = tuple[float, ...] | Mapping[str, float]


@dataclass(frozen=True)
class MapLayout:
    """Order, axes and scale of the maps of a recording.

    Args:
        dims: order of the array's dimensions, out of ``range``, ``azimuth``, ``elevation``, ``doppler``; ``None``: the
            file's own, or of a picture the one of 400 columns or rows as azimuth.
        range_m: middle of each bin, or ``{"first": m, "step": m}``; ``None``: the file's own.
        azimuth_deg: from forward to the left, likewise; ``None``: the file's own, or of a picture a full turn,
            clockwise from forward.
        elevation_deg: up, likewise.
        speed_m_per_s: positive receding, likewise.
        scale: ``linear``, ``amplitude``, ``complex``, ``db``, ``db_steps``; ``None``: ``db_steps`` of bytes and
            ``complex`` of complex numbers; others must say.
        step_db: of one level of ``db_steps``.
        bottom_db: of byte 0.
        key: name of the array in a ``.npz`` with several.
        quadratures: the last dimension holds real and imaginary part.

    Example:
        >>> MapLayout(("range", "azimuth"), {"first": 0.1, "step": 0.2}, {"first": 90, "step": -1}).range_m["step"]
        0.2
    """

    dims: tuple[str, ...] | None = None
    range_m: Axis | None = None
    azimuth_deg: Axis | None = None
    elevation_deg: Axis | None = None
    speed_m_per_s: Axis | None = None
    scale: str | None = None
    step_db: float = 0.5
    bottom_db: float = 0.0
    key: str | None = None
    quadratures: bool = False

    def __post_init__(self) -> None:
        check_arguments(
            "MapLayout(dims: Sequence | None, scale: str | None, step_db: float, bottom_db: float, key: str | None, "
            "quadratures: bool)",
            self.dims,
            self.scale,
            self.step_db,
            self.bottom_db,
            self.key,
            self.quadratures,
        )
        if self.dims is not None:
            object.__setattr__(self, "dims", tuple(self.dims))
            for name in self.dims or ():
                check_one_of("dims", name, MAP_DIMENSIONS, owner=self)
        if self.scale is not None:
            check_one_of("scale", self.scale, PLAIN_SCALES, owner=self)
        for name in AXES.values():
            given = getattr(self, name)
            if isinstance(given, Mapping):
                if set(given) != {"first", "step"} or not all(isinstance(one, (int, float)) for one in given.values()):
                    raise InputValueError(
                        f"MapLayout: {name} must be a list of numbers, or first and step; got {dict(given)!r}."
                    )
            elif given is not None:
                check_arguments(
                    f"MapLayout({name}: Sequence[float])", given.tolist() if hasattr(given, "tolist") else given
                )
                object.__setattr__(self, name, tuple(float(one) for one in given))

    def axes_of(self, shape: Sequence[int], source: Path) -> MapAxes:
        """Axes of an array of this shape; every dimension must be known.

        Args:
            shape: of the array, as ``dims``.
            source: the file, for errors.
        """
        dims = self.dims or ()
        if len(dims) != len(shape):
            raise TorchweatherError(
                f"{source}: expected the names of {len(shape)} dimensions, sizes {' x '.join(map(str, shape))}; got "
                f"{', '.join(dims) or 'none'}. Give dims, such as [range, azimuth], in a layout (YAML) or in the .npz."
            )
        values: dict[str, tuple[float, ...]] = {}
        for name, size in zip(dims, shape, strict=True):
            given = getattr(self, AXES[name])
            if given is None:
                raise TorchweatherError(
                    f"{source}: the {size} cells of {name} have no values; give {AXES[name]} in a layout (YAML), or an "
                    "array of that name in the .npz."
                )
            listed = (
                tuple(given["first"] + given["step"] * k for k in range(size)) if isinstance(given, Mapping) else given
            )
            if len(listed) != size:
                raise TorchweatherError(
                    f"{source}: expected {size} values of {AXES[name]}, one for each cell; got {len(listed)}."
                )
            in_degrees = AXES[name].endswith("_deg")
            values[MAP_DIMENSIONS[name]] = tuple(math.radians(one) for one in listed) if in_degrees else listed
        try:
            return MapAxes(tuple(dims), **values)
        except ValueError as error:
            raise TorchweatherError(f"{source}: {error}") from error

    def scale_of(self, *, is_bytes: bool, is_complex: bool, source: Path) -> PowerScale:
        """Scale of an array by its kind of numbers."""
        kind = self.scale or ("db_steps" if is_bytes else "complex" if is_complex else "")
        if not kind:
            raise TorchweatherError(
                f"{source}: expected a scale; the file does not state if its numbers are powers, amplitudes or dB. "
                f"Give scale ({', '.join(PLAIN_SCALES)}) in a layout (YAML), or in the .npz."
            )
        return PowerScale.steps(self.step_db, self.bottom_db) if kind == "db_steps" else PowerScale(kind)


AXIS = Key("a list of numbers, or first and step", lambda value: NUMBERS.fits(value) or isinstance(value, Mapping))
KEYS = {
    **field_keys(MapLayout),
    **dict.fromkeys(AXES.values(), AXIS.or_null),
    "dims": Key(f"a list of {', '.join(MAP_DIMENSIONS)}", lambda value: isinstance(value, list)).or_null,
}


def _turning(first_m: float, step_m: float) -> MapLayout:
    return MapLayout(range_m={"first": first_m, "step": step_m})


MAP_LAYOUTS: dict[str, MapLayout] = {
    "radiate": MapLayout(dims=("range", "azimuth"), range_m={"first": 0.5 * 0.17361, "step": 0.17361}),
    "oxford": _turning(0.5 * 0.0432, 0.0432),
    "mulran": _turning(0.5 * 0.0595, 0.0595),
    "boreas-2020": _turning(0.5 * 0.0596, 0.0596),
    "boreas-2021": _turning(0.5 * 0.04381, 0.04381),
}
"""Range bins of radars that turn: RADIATE, Oxford Radar RobotCar, MulRan, Boreas before and from 21 September 2021.
Where a picture holds azimuths those count."""


def map_layout(name_or_path: str) -> MapLayout:
    """A layout by the name of a data set (`MAP_LAYOUTS`), or from a YAML file with the fields of `MapLayout`.

    Args:
        name_or_path: such as ``radiate``, or ``mine.yaml``.

    Raises:
        ValueError: no such name.
        TorchweatherError: the file is missing or broken, or a field in it is wrong.

    Example:
        >>> map_layout("radiate").range_m["step"]
        0.17361
    """
    check_arguments("map_layout(name_or_path: str)", name_or_path)
    if not name_or_path.lower().endswith((".yaml", ".yml")):
        check_one_of("layout", name_or_path, MAP_LAYOUTS, owner="map_layout")
        return MAP_LAYOUTS[name_or_path]
    path = Path(name_or_path)
    content = read_yaml(path, "the layout of a radar map")
    check_keys(content, KEYS, str(path))
    try:
        return MapLayout(**content)
    except (TypeError, ValueError) as error:
        raise TorchweatherError(f"{path}: {error}") from error
