"""Lamps of a night scene, and the options of its light."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, fields
from typing import Any, ClassVar

import torch
from torch import Tensor

from torchweather.core.arguments import check_arguments
from torchweather.core.errors import InputTypeError, InputValueError, check_one_of, nearest_name
from torchweather.core.fields import above, at_least, between, check_fields

__all__ = ["BEAMS", "Lamp", "Night", "as_night", "beam_share", "own_headlamps"]

BEAMS = ("isotropic", "low_beam", "high_beam", "rear")
FIND = "find"
OWN_LAMPS = ("low_beam", "high_beam", "none")
# Luminous intensity along the axis of a pattern, cd, each lamp. Order of magnitude: LED headlamps reach 20,000 to
# 30,000 cd in low beam; UN Regulation 112 bounds all high beams together by 430,000 cd (primary text not seen).
PEAK_CD = {"low_beam": 20_000.0, "high_beam": 60_000.0}
# Where headlamps sit, seen from the ground below a camera behind the windscreen: forward, left and up.
HEADLAMP_FORWARD_M, HEADLAMP_ASIDE_M, HEADLAMP_HEIGHT_M = 1.8, 0.65, 0.65

_LAMP_RANGES = {
    "position_m": between(-1e4, 1e4, "m (forward, left, up; origin on the ground below the camera)"),
    "intensity_cd": at_least(0.0, 1e8, "cd"),
    "heading_rad": between(-2 * math.pi, 2 * math.pi, "rad"),
    "tilt_rad": between(-math.pi / 2, math.pi / 2, "rad"),
    "colour": between(0.0, 1e3),
    "radius_m": above(0.0, 10.0, "m"),
}


@dataclass(frozen=True)
class Lamp:
    """A lamp of the scene.

    Args:
        position_m: forward, left, up, from the ground below the camera.
        intensity_cd: luminous intensity along its axis, candela. A headlamp in low beam has 20,000 along its axis and
            300 into the eyes of others, a tail lamp 10, a street lamp 1,000 to 5,000.
        beam: pattern: ``isotropic``, ``low_beam``, ``high_beam`` or ``rear`` (falling as the cosine).
        heading_rad: azimuth of its axis, from forward to left; pi shines at the camera.
        tilt_rad: elevation of its axis.
        colour: relative linear red, green, blue; the mean of a white one is 1.
        radius_m: of what glows.

    Example:
        >>> Lamp((40.0, 3.0, 0.65), 300.0, heading_rad=3.14).beam
        'isotropic'
    """

    position_m: tuple[float, float, float]
    intensity_cd: float = 1000.0
    beam: str = "isotropic"
    heading_rad: float = 0.0
    tilt_rad: float = 0.0
    colour: tuple[float, float, float] = (1.0, 1.0, 1.0)
    radius_m: float = 0.06

    def __post_init__(self) -> None:
        check_one_of("beam", self.beam, BEAMS, owner=self)
        check_fields(self, _LAMP_RANGES)
        for name in ("position_m", "colour"):
            if len(getattr(self, name)) != 3:
                raise InputValueError(f"Lamp: {name} must be three numbers; got {getattr(self, name)!r}.")

    @classmethod
    def of(cls, value: Lamp | Mapping[str, Any]) -> Lamp:
        """A lamp, or one from its values."""
        return value if isinstance(value, Lamp) else _from_mapping(cls, value)


def own_headlamps(beam: str = "low_beam") -> tuple[Lamp, Lamp]:
    """The two headlamps of the own car, 1.8 m in front of the camera, 0.65 m aside and high.

    Args:
        beam: ``low_beam`` or ``high_beam``.

    Example:
        >>> [lamp.position_m[1] for lamp in own_headlamps()]
        [0.65, -0.65]
    """
    check_arguments("own_headlamps(beam: str)", beam)
    check_one_of("beam", beam, tuple(PEAK_CD), owner="own_headlamps")
    left, right = (
        Lamp((HEADLAMP_FORWARD_M, side * HEADLAMP_ASIDE_M, HEADLAMP_HEIGHT_M), PEAK_CD[beam], beam)
        for side in (1.0, -1.0)
    )
    return left, right


def beam_share(beam: str, azimuth_rad: Tensor, elevation_rad: Tensor) -> Tensor:
    """Luminous intensity of a pattern in a direction, over that along its axis; both angles from the axis.

    The low beam has a wide hot spot 1.5 degrees below the axis, a wider apron, a cut-off at 0.57 degrees below it, and
    1.5 % of stray light: within the bounds of UN Regulation 112, class B, at its points 50V, 25L, 25R and B50L. Real
    lamps differ by a factor of two.

    Args:
        beam: one of ``BEAMS``.
        azimuth_rad: to either side.
        elevation_rad: up, broadcast against it.
    """
    check_arguments(
        "beam_share(beam: str, azimuth_rad: Tensor, elevation_rad: Tensor)", beam, azimuth_rad, elevation_rad
    )
    check_one_of("beam", beam, BEAMS, owner="beam_share")
    if beam == "isotropic":
        return torch.ones_like(azimuth_rad + elevation_rad)
    if beam == "rear":
        return (torch.cos(azimuth_rad) * torch.cos(elevation_rad)).clamp_min(0.0)
    aside, up = torch.rad2deg(azimuth_rad), torch.rad2deg(elevation_rad)
    stray = 0.015 * _bell(aside, 30.0) * _bell(up, 12.0)
    if beam == "high_beam":
        return _bell(aside, 5.0) * _bell(up, 3.0) + 0.1 * _bell(aside, 15.0) * _bell(up, 6.0) + stray
    below = torch.sigmoid((-0.57 - up) / 0.15)
    hot, apron = _bell(aside, 10.0) * _bell(up + 1.5, 1.5), 0.15 * _bell(aside, 25.0) * _bell(up + 4.0, 4.0)
    return below * (hot + apron) + stray


def _bell(value: Tensor, width: float) -> Tensor:
    return torch.exp(-0.5 * (value / width).square())


_NIGHT_RANGES = {
    "saturation_cd_per_m2": above(0.0, 1e7, "cd/m2"),
    "white_lamp_cd": at_least(0.0, 1e8, "cd"),
    "red_lamp_cd": at_least(0.0, 1e8, "cd"),
    "street_lamp_height_m": between(2.0, 30.0, "m"),
}


@dataclass(frozen=True)
class Night:
    """Light of a night scene.

    Args:
        own: headlamps of the own car: ``low_beam``, ``high_beam``, ``none``, or lamps.
        lamps: of others: ``find`` takes bright spots of the frame for lamps; or lamps; or none, ``()``.
        saturation_cd_per_m2: luminance that saturates the camera; of a known exposure that of
            ``image.LuminanceExposure``: 7.3 cd/m2 at 1/30 s, f/1.8 and ISO 1600.
        white_lamp_cd, red_lamp_cd: intensity towards the camera that a found lamp is taken to have: low beams of others
            and street lamps, tail lamps. Their light saturates the frame, which does not tell.
        street_lamp_height_m: of a found lamp in front of the sky, from which its distance follows.

    Example:
        >>> Night().saturation_cd_per_m2
        10.0
    """

    kind: ClassVar[str] = "night"

    own: str | tuple[Lamp, ...] = "low_beam"
    lamps: str | tuple[Lamp, ...] = FIND
    saturation_cd_per_m2: float = 10.0
    white_lamp_cd: float = 1000.0
    red_lamp_cd: float = 10.0
    street_lamp_height_m: float = 8.0

    def __post_init__(self) -> None:
        check_fields(self, _NIGHT_RANGES)
        for name, words in (("own", OWN_LAMPS), ("lamps", (FIND,))):
            value = getattr(self, name)
            if isinstance(value, str):
                check_one_of(name, value, words, owner=self)
            elif isinstance(value, Sequence):
                object.__setattr__(self, name, tuple(Lamp.of(one) for one in value))
            else:
                raise InputTypeError(f"Night: {name} must be {' or '.join(map(repr, words))}, or lamps; got {value!r}.")

    @property
    def own_lamps(self) -> tuple[Lamp, ...]:
        """The headlamps of the own car."""
        if isinstance(self.own, str):
            return () if self.own == "none" else own_headlamps(self.own)
        return self.own

    @property
    def given_lamps(self) -> tuple[Lamp, ...]:
        """Lamps of others that were given."""
        return () if isinstance(self.lamps, str) else self.lamps

    def to_dict(self) -> dict[str, Any]:
        """Plain values that ``as_night`` takes."""
        values = {field.name: getattr(self, field.name) for field in fields(self)}
        for name in ("own", "lamps"):
            if not isinstance(values[name], str):
                values[name] = [_plain(lamp) for lamp in values[name]]
        return values


def _plain(lamp: Lamp) -> dict[str, Any]:
    return {name: list(value) if isinstance(value, tuple) else value for name, value in asdict(lamp).items()}


def as_night(value: Night | Mapping[str, Any] | bool, owner: object) -> Night | None:
    """Night from its values; ``True`` is the default one, ``False`` none."""
    if isinstance(value, bool):
        return Night() if value else None
    if isinstance(value, (Night, Mapping)):
        return value if isinstance(value, Night) else _from_mapping(Night, value)
    raise InputTypeError(
        f"{type(owner).__name__}: night must be None, True, a Night or its values; got {value!r}. Write "
        "night=Night(own='low_beam')."
    )


def _from_mapping(cls: type[Any], value: Mapping[str, Any]) -> Any:
    if not isinstance(value, Mapping):
        raise InputTypeError(f"{cls.__name__}: expected a {cls.__name__} or its values; got {value!r}.")
    known = [field.name for field in fields(cls)]
    for key in value:
        if key not in known:
            raise InputValueError(f"{cls.__name__}: unknown field {key!r}.{nearest_name(str(key), known)}")
    if cls is Lamp and "position_m" not in value:
        raise InputValueError("Lamp: position_m is missing: forward, left, up in metres.")
    return cls(**{key: tuple(one) if isinstance(one, list) else one for key, one in value.items()})
