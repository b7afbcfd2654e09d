"""Light of a cloudy day: radiance of the sky, irradiance of tilted surfaces, darkening under objects.

Radiances are linear and relative to the sensor's saturation (1), already exposed; colours are white balanced.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import torch
from torch import Tensor

from torchweather.core.errors import check_at_least, check_between
from torchweather.scenes.position_noise import value_noise
from torchweather.scenes.primitives import Point

__all__ = ["DiffuseLight", "SlabShade", "SphereShade"]


@dataclass(frozen=True)
class DiffuseLight:
    r"""A dome of light, brighter towards the zenith, over ground that sends some of it back.

    Radiance at elevation e: ``L(e) = L_zenith (1 + b sin e) / (1 + b)``. ``b = 2`` is the CIE standard overcast
    sky (Moon and Spencer 1942; ISO 15469 / CIE S 011 type 1 in its traditional form): the horizon has a third of the
    zenith's luminance. ``b = 0`` is a uniform dome.

    Args:
        zenith_rgb: radiance of the zenith, share of saturation. Up to 1 nothing in the sky clips; a camera that
            sees elevations to 30 degrees then meets 0.67 at most.
        gradient: b above.
        cloud_contrast: relative amplitude of soft clouds; it vanishes at the horizon, so that the horizon keeps the
            one colour that a dense fog would have.
        ground_albedo: mean reflectance of the ground, for the light from below.

    References:
        Moon P., Spencer D. E. (1942), Illumination from a non-uniform sky, Illum. Eng. 37.
        Muneer T. (2004), Solar Radiation and Daylight Models, ch. 4: irradiance of a tilted plane under that sky.
    """

    zenith_rgb: tuple[float, float, float] = (0.985, 1.0, 1.0)
    gradient: float = 2.0
    cloud_contrast: float = 0.10
    ground_albedo: float = 0.12

    def __post_init__(self) -> None:
        check_at_least("gradient", self.gradient, 0.0, owner=self)
        check_between("cloud_contrast", self.cloud_contrast, 0.0, 1.0, owner=self)
        check_between("ground_albedo", self.ground_albedo, 0.0, 1.0, owner=self)

    @property
    def horizon_rgb(self) -> tuple[float, float, float]:
        """Radiance of the sky at the horizon: the airlight of a fog under this sky, to first order.

        Example:
            >>> DiffuseLight(zenith_rgb=(0.9, 0.9, 0.9)).horizon_rgb
            (0.3, 0.3, 0.3)
        """
        red, green, blue = self.zenith_rgb
        share = 1 / (1 + self.gradient)
        return (red * share, green * share, blue * share)

    def sky_radiance(self, direction: Tensor) -> Tensor:
        """Radiance from a direction at or above the horizon, ``(..., 3)`` to ``(..., 3)``; below, the horizon's."""
        sine = torch.nn.functional.normalize(direction, dim=-1)[..., 2].clamp_min(0)
        radiance = (1 + self.gradient * sine) / (1 + self.gradient)
        if self.cloud_contrast:
            # Clouds live on a flat layer 1 above the eye; far ones crowd at the horizon and fade there.
            layer = direction / direction[..., 2:].abs().clamp_min(1e-2)
            layer = torch.cat([layer[..., :2].clamp(-99, 99), torch.zeros_like(layer[..., :1])], -1)
            cloud = sum(2.0**-k * (value_noise(layer, 0.8 * 2.0**-k, seed=20 + k) - 0.5) for k in range(3))
            fade = (sine / 0.35).clamp(0, 1) ** 2
            radiance = radiance * (1 + self.cloud_contrast * cloud * fade)
        return radiance[..., None] * direction.new_tensor(self.zenith_rgb)

    def irradiance(self, normal: Tensor) -> tuple[Tensor, Tensor]:
        r"""Irradiance of a surface from the sky and from the ground.

        ``E_h = pi L_zenith (1 + 2 b / 3) / (1 + b)`` on the level, and for a tilt beta (Muneer 2004)
        ``E / E_h = (1 + cos beta)/2 + 2 b / (pi (3 + 2 b)) (sin beta - beta cos beta - pi sin^2(beta / 2))``.
        The first term is the share of the sky that the surface sees, the second the gradient. The ground sends
        ``albedo E_h (1 - cos beta)/2``.

        Args:
            normal: unit normals, ``(..., 3)``.

        Returns:
            Sky and ground irradiance, each ``(..., 3)``, share of saturation times steradian.
        """
        b = self.gradient
        cosine = normal[..., 2].clamp(-1, 1)
        beta = torch.acos(cosine)
        tilt = torch.sin(beta) - beta * cosine - math.pi * (1 - cosine) / 2
        sky = (1 + cosine) / 2 + 2 * b / (math.pi * (3 + 2 * b)) * tilt
        level = normal.new_tensor(self.zenith_rgb) * (math.pi * (1 + 2 * b / 3) / (1 + b))
        ground = self.ground_albedo * (1 - cosine) / 2
        return sky.clamp_min(0)[..., None] * level, ground[..., None] * level

    def mirrored(self, direction: Tensor) -> Tensor:
        """Radiance that a mirror sends on from a direction: the sky above, the lit ground below."""
        sky = self.sky_radiance(direction)
        up = normal_up(direction)
        ground = self.ground_albedo / math.pi * self.irradiance(up)[0]
        sine = torch.nn.functional.normalize(direction, dim=-1)[..., 2:]
        # Trees and houses soften the horizon in a coat of paint: 6 degrees (0.1 rad) of blend.
        return torch.lerp(ground, sky, (sine / 0.1 + 0.5).clamp(0, 1))


def normal_up(like: Tensor) -> Tensor:
    """The vertical, in the shape of ``like``."""
    return like.new_tensor([0.0, 0.0, 1.0]).expand_as(like)


@dataclass(frozen=True)
class SlabShade:
    r"""Sky hidden from the level ground by a horizontal rectangle above it, such as the floor of a car.

    View factor from a small level patch to a parallel rectangle: with X, Y the corners' offsets over the height,
    ``F = (1 / 2 pi) [X/sqrt(1+X^2) atan(Y/sqrt(1+X^2)) + Y/sqrt(1+Y^2) atan(X/sqrt(1+Y^2))]``, added over the four
    corners with their signs (Howell, A Catalog of Radiation Heat Transfer Configuration Factors, B-3/B-4).

    Args:
        centre_m: middle of the rectangle (z is its height).
        size_m: full edges along its own x and y.
        yaw_rad: turn from x to y.
    """

    centre_m: Point
    size_m: tuple[float, float]
    yaw_rad: float = 0.0

    @property
    def reach_m(self) -> float:
        """Beyond this horizontal distance less than 0.5 % of the sky is hidden."""
        # Far away F = h^2 A / (pi d^4), with A the rectangle's area.
        area_m2 = self.size_m[0] * self.size_m[1]
        return math.hypot(*self.size_m) / 2 + math.sqrt(self.centre_m[2] * math.sqrt(area_m2 / (math.pi * 0.005)))

    def hidden_share(self, point_m: Tensor) -> Tensor:
        """Share of the sky's light (uniform sky) that does not reach level points ``(N, 3)``, 0..1.

        Example:
            >>> wide = SlabShade(centre_m=(0.0, 0.0, 0.1), size_m=(100.0, 100.0))
            >>> round(float(wide.hidden_share(torch.zeros(1, 3))), 3)
            1.0
        """
        cos, sin = math.cos(self.yaw_rad), math.sin(self.yaw_rad)
        x, y = point_m[:, 0] - self.centre_m[0], point_m[:, 1] - self.centre_m[1]
        x, y = cos * x + sin * y, cos * y - sin * x
        height = (self.centre_m[2] - point_m[:, 2]).clamp_min(1e-3)
        corners = torch.zeros_like(x)
        for sign_x in (1, -1):
            for sign_y in (1, -1):
                a = (sign_x * self.size_m[0] / 2 - x) / height
                b = (sign_y * self.size_m[1] / 2 - y) / height
                root_a, root_b = (1 + a * a).sqrt(), (1 + b * b).sqrt()
                factor = a / root_a * torch.atan(b / root_a) + b / root_b * torch.atan(a / root_b)
                corners = corners + sign_x * sign_y * factor
        return (corners / (2 * math.pi)).clamp(0, 1)


@dataclass(frozen=True)
class SphereShade:
    r"""Sky hidden from the level ground by a ball above it, such as a crown or a body.

    View factor to a sphere that stands wholly above the horizon: ``F = cos(theta) (R / d)^2``, theta the zenith
    angle of its centre, d the distance (Howell, B-13); nearer ones are cut at 1.

    Args:
        centre_m: middle.
        radius_m: radius.
        opacity: 1 is solid; a crown lets some light through.
    """

    centre_m: Point
    radius_m: float
    opacity: float = 1.0

    @property
    def reach_m(self) -> float:
        """Beyond this horizontal distance less than 0.5 % of the sky is hidden."""
        # F = h R^2 / d^3
        return math.cbrt(max(self.centre_m[2], self.radius_m) * self.radius_m**2 / 0.005)

    def hidden_share(self, point_m: Tensor) -> Tensor:
        """Share of the sky's light (uniform sky) that does not reach level points ``(N, 3)``, 0..1."""
        offset = point_m.new_tensor(self.centre_m) - point_m
        distance = offset.norm(dim=-1).clamp_min(self.radius_m)
        share: Tensor = self.opacity * self.radius_m**2 * offset[:, 2] / distance**3
        return share.clamp(0, 1)
