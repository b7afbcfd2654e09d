"""Bodies as scatterers: facets by physical optics, corner reflectors by their aperture."""

from __future__ import annotations

import math
import warnings

import torch
from torch import Tensor

from torchweather.core.arguments import check_arguments, check_broadcast
from torchweather.core.errors import InputValueError, TorchweatherWarning, check_between, check_finite, check_positive
from torchweather.physics.float64 import Quantity, to_float64
from torchweather.radar.fmcw.facet_rcs import far_field_edge_m, triangle_field_m
from torchweather.radar.fmcw.scatterers import Scatterers

__all__ = ["corner_reflector_rcs_m2", "corner_scatterers", "facet_scatterers", "gathered"]


def corner_reflector_rcs_m2(edge_m: Quantity, wavelength_m: Quantity, to_radar: Tensor | None = None) -> Tensor:
    r"""Radar cross section of a trihedral corner reflector with triangular faces, m^2.

    ``sigma = 4 pi A^2 / lambda^2`` with the aperture A whose rays come back after three reflections. On boresight
    ``A = a^2 / sqrt(3)``, ``sigma = 4 pi a^4 / (3 lambda^2)``. Off it, with the direction cosines ``l <= m <= n`` to
    the three edges and their sum ``s``: ``A = a^2 4 l m / s`` where ``l + m <= n``, else ``A = a^2 (s - 2 / s)``.

    Args:
        edge_m: a, one of the three inner edges that meet in the corner (the outer ones are ``sqrt(2) a``), above 0.
        wavelength_m: above 0.
        to_radar: unit vectors to the radar in the axes of the three inner edges, ``(..., 3)``; ``None`` is boresight.

    Returns:
        float64, the arguments broadcast; 0 where the radar looks at the back of a face.

    Note:
        Three reflections at perfect metal, edges well above a wavelength. The half-power width is about 40 degrees. The
        lobes of single faces and pairs, which rise towards the faces' planes, are left out.

    References:
        PHYSICS.md 6.1 (cross section). Aperture: Robertson 1947, Targets for microwave radar navigation, Bell System
        Technical Journal 26 (unverified; checked by traced rays in the tests).

    Example:
        >>> round(10 * math.log10(float(corner_reflector_rcs_m2(0.1, 0.0039))), 1)
        14.4
    """
    check_arguments(
        "corner_reflector_rcs_m2(edge_m: Quantity, wavelength_m: Quantity, to_radar: real | None)",
        edge_m,
        wavelength_m,
        to_radar,
    )
    check_broadcast("corner_reflector_rcs_m2", edge_m=edge_m, wavelength_m=wavelength_m)
    owner = "corner_reflector_rcs_m2"
    check_positive("edge_m", edge_m, unit="m", owner=owner)
    check_positive("wavelength_m", wavelength_m, unit="m", owner=owner)
    edge, wavelength = to_float64(edge_m, wavelength_m)
    check_between("edge_m", edge_m, 1e-6, 1e6, unit="m", owner=owner)
    check_between("wavelength_m", wavelength_m, 1e-9, 1e6, unit="m", owner=owner)
    if to_radar is not None and (to_radar.is_complex() or to_radar.shape[-1:] != (3,)):
        raise InputValueError(f"{owner}: to_radar must be (..., 3) real; got {to_radar.dtype} {tuple(to_radar.shape)}.")
    if to_radar is not None:
        check_broadcast(owner, edge_m=edge, wavelength_m=wavelength, to_radar=to_radar[..., 0])
    if to_radar is None:
        aperture = edge**2 / math.sqrt(3.0)
    else:
        small, middle, large = to_radar.to(edge.device, torch.float64).clamp_min(0.0).sort(-1).values.unbind(-1)
        total = (small + middle + large).clamp_min(1e-9)  # 0 only behind all faces, where small * middle is 0 too
        share = torch.where(small + middle <= large, 4.0 * small * middle / total, total - 2.0 / total)
        aperture = edge**2 * torch.where(small > 0, share, torch.zeros_like(share))
    rcs: Tensor = 4.0 * math.pi * (aperture / wavelength) ** 2
    return rcs


def facet_scatterers(
    vertices_m: Tensor,
    radar_position_m: Tensor,
    velocity_m_per_s: Tensor,
    wavelength_m: float,
    reflectivity: float = 1.0,
) -> Scatterers:
    """A body of triangles as scatterers: one at the centroid of every facet that the radar sees.

    Args:
        vertices_m: ``(F, 3, 3)``, counter-clockwise seen from outside, in axes parallel to the radar's.
        radar_position_m: ``(3,)`` in the same frame.
        velocity_m_per_s: ``(3,)``, of the body as the radar sees it (no rotation).
        wavelength_m: above 0.
        reflectivity: reflected power over incident power, 0-1; 1 is metal.

    Returns:
        Positions from the radar, in the precision of ``vertices_m``; each facet is seen under its own direction.

    Note:
        Visible is what faces the radar: one facet does not shade another, which is right for convex bodies only.
        Facets must be in their far field; a warning names the edge they may have (`subdivide`).

    References:
        PHYSICS.md 6.3, 6.4.

    Example:
        >>> plate = torch.tensor([[[28.0, -0.1, 0.0], [28.0, 0.0, 0.1], [28.0, 0.1, 0.0]]])
        >>> seen = facet_scatterers(plate, torch.zeros(3), torch.tensor([2.0, 0.0, 0.0]), 0.0039)
        >>> [round(float(v), 1) for v in (seen.range_m, seen.speed_m_per_s, seen.rcs_dbsm)]
        [28.0, 2.0, 19.1]
    """
    check_arguments(
        "facet_scatterers(vertices_m: real, radar_position_m: real, velocity_m_per_s: real, "
        "wavelength_m: float, reflectivity: float)",
        vertices_m,
        radar_position_m,
        velocity_m_per_s,
        wavelength_m,
        reflectivity,
    )
    owner = "facet_scatterers"
    if vertices_m.ndim != 3 or vertices_m.shape[-2:] != (3, 3):
        raise InputValueError(f"{owner}: vertices_m must be (F, 3, 3) in metres; got shape {tuple(vertices_m.shape)}.")
    _check_vector("radar_position_m", radar_position_m, "m", owner)
    check_arguments("facet_scatterers(vertices_m: floating)", vertices_m)
    from_radar = vertices_m - radar_position_m.to(vertices_m)
    position = from_radar.mean(-2)
    range_m = torch.linalg.vector_norm(position, dim=-1, keepdim=True)
    check_positive("distance of the facets", range_m, unit="m", owner=owner)
    away = position / range_m
    field = triangle_field_m(from_radar, -away, wavelength_m, reflectivity)
    seen = field.detach().abs() > 0
    _warn_if_near(from_radar[seen], range_m[seen], wavelength_m, owner)
    return _moving(position[seen], velocity_m_per_s, field[seen], owner)


def corner_scatterers(
    position_m: Tensor,
    facing: Tensor,
    edge_m: Tensor,
    radar_position_m: Tensor,
    velocity_m_per_s: Tensor,
    wavelength_m: float,
) -> Scatterers:
    """Trihedral corner reflectors as scatterers, standing with one inner edge in the upright plane of their boresight.

    Args:
        position_m: of the corners, ``(M, 3)``, in axes parallel to the radar's.
        facing: boresights, unit vectors ``(M, 3)``, not vertical.
        edge_m: inner edges, ``(M,)``.
        radar_position_m: ``(3,)`` in the same frame.
        velocity_m_per_s: ``(3,)``, as the radar sees it.
        wavelength_m: above 0.

    Returns:
        One scatterer a corner, phase 0; its field is 0 where the radar sees the back of a face.

    References:
        PHYSICS.md 6.1; `corner_reflector_rcs_m2`.

    Example:
        >>> at, facing = torch.tensor([[20.0, 0.0, 0.0]]), torch.tensor([[-1.0, 0.0, 0.0]])
        >>> still, edge = torch.zeros(3), torch.tensor([0.1])
        >>> round(float(corner_scatterers(at, facing, edge, still, still, 0.0039).rcs_dbsm), 1)
        14.4
    """
    check_arguments(
        "corner_scatterers(position_m: floating, facing: floating, edge_m: real, radar_position_m: real, "
        "velocity_m_per_s: real, wavelength_m: float)",
        position_m,
        facing,
        edge_m,
        radar_position_m,
        velocity_m_per_s,
        wavelength_m,
    )
    owner = "corner_scatterers"
    if position_m.ndim != 2 or position_m.shape != facing.shape or position_m.shape[-1] != 3:
        raise InputValueError(
            f"{owner}: position_m and facing must both be (M, 3); got shapes {tuple(position_m.shape)} and "
            f"{tuple(facing.shape)}."
        )
    _check_vector("radar_position_m", radar_position_m, "m", owner)
    position = position_m - radar_position_m.to(position_m)
    range_m = torch.linalg.vector_norm(position, dim=-1, keepdim=True)
    check_positive("distance of the corners", range_m, unit="m", owner=owner)
    edges = _inner_edges(facing)
    cosines = torch.einsum("mex,mx->me", edges, (-position / range_m).to(edges))
    field = corner_reflector_rcs_m2(edge_m, wavelength_m, cosines).sqrt()
    exact = torch.promote_types(position_m.dtype, torch.float32)  # as of triangle_field_m
    return _moving(position, velocity_m_per_s, field.to(exact.to_complex()), owner)


def gathered(scatterers: Scatterers, wavelength_m: float, cell_m: float) -> Scatterers:
    """Fewer scatterers with the same echo: the fields in each cube of ``cell_m`` summed at their centre of power.

    ``F = sum_i F_i exp(2 j k (R_i - R))``: exact at the carrier and at the radar's place. Across the sweep a member's
    phase is off by at most ``pi (R_i - R) / dR`` at the band's edges and across an array by its place in the beam:
    keep ``cell_m`` below the range resolution dR and below the beam's width on the target.

    Args:
        scatterers: without batch dimensions, ``(M, 3)``.
        wavelength_m: of the carrier, above 0.
        cell_m: edge of a cube, above 0.

    Returns:
        One scatterer for each cube that holds any power; its speed is the power's mean. Differentiable in fields and
        positions while no scatterer changes its cube.

    References:
        PHYSICS.md 6.3 (sum of fields), 6.4 (sign).

    Example:
        >>> pair = Scatterers.from_rcs(torch.tensor([[20.01, 0.01, 0.01], [20.02, 0.01, 0.01]]).double(), 0.0)
        >>> gathered(pair, 0.004, 0.1).range_m
        tensor([20.0150], dtype=torch.float64)
    """
    check_arguments(
        "gathered(scatterers: Scatterers, wavelength_m: float, cell_m: float)",
        scatterers,
        wavelength_m,
        cell_m,
    )
    owner = "gathered"
    check_positive("wavelength_m", wavelength_m, unit="m", owner=owner)
    check_positive("cell_m", cell_m, unit="m", owner=owner)
    check_between("cell_m", cell_m, 1e-9, 1e9, unit="m", owner=owner)
    if scatterers.position_m.ndim != 2:
        raise InputValueError(
            f"{owner}: scatterers must have no batch dimensions, position_m (M, 3); "
            f"got shape {tuple(scatterers.position_m.shape)}."
        )
    full = scatterers.field_m.detach().abs() > 0
    position, speed, field = scatterers.position_m[full], scatterers.speed_m_per_s[full], scatterers.field_m[full]
    cube = torch.floor(position.detach() / cell_m).long()
    cubes, member = torch.unique(cube, dim=0, return_inverse=True)

    def summed(value: Tensor) -> Tensor:
        return value.new_zeros((len(cubes), *value.shape[1:])).index_add(0, member, value)

    power = field.abs().double() ** 2
    total = summed(power)
    centre = summed(power[:, None] * position) / total[:, None]
    mean_speed = summed(power * speed) / total
    # Millimetres of wavelength in tens of metres: the difference of ranges needs float64.
    farther = torch.linalg.vector_norm(position.double(), dim=-1) - torch.linalg.vector_norm(centre, dim=-1)[member]
    turn = torch.polar(torch.ones_like(farther), 4.0 * math.pi / wavelength_m * farther)
    return Scatterers(centre.to(position), mean_speed.to(speed), summed(field * turn).to(field))


def _moving(position: Tensor, velocity_m_per_s: Tensor, field: Tensor, owner: str) -> Scatterers:
    """Scatterers of one rigid body that does not turn."""
    _check_vector("velocity_m_per_s", velocity_m_per_s, "m/s", owner)
    away = position / torch.linalg.vector_norm(position, dim=-1, keepdim=True)
    return Scatterers(position, away @ velocity_m_per_s.to(position), field)


def _inner_edges(facing: Tensor) -> Tensor:
    """The three inner edges of corners with these boresights, ``(M, 3, 3)``: corner, edge, x y z."""
    forward = facing.double()
    up = torch.zeros_like(forward)
    up[:, 2] = 1.0
    left = torch.nn.functional.normalize(torch.linalg.cross(up, forward), dim=-1)
    upright = torch.linalg.cross(forward, left)
    turns = math.pi / 2.0 + torch.arange(3, dtype=forward.dtype, device=forward.device) * (2.0 * math.pi / 3.0)
    around = torch.cos(turns)[:, None] * left[:, None] + torch.sin(turns)[:, None] * upright[:, None]
    # Each edge makes 54.7 degrees with the boresight: cosine 1 / sqrt(3).
    edges: Tensor = forward[:, None] / math.sqrt(3.0) + math.sqrt(2.0 / 3.0) * around
    return edges


def _check_vector(name: str, value: Tensor, unit: str, owner: str) -> None:
    if value.shape != (3,):
        raise InputValueError(f"{owner}: {name} must be (3,) = x, y, z in {unit}; got shape {tuple(value.shape)}.")
    check_finite(name, value, unit=unit, owner=owner)


def _warn_if_near(from_radar_m: Tensor, range_m: Tensor, wavelength_m: float, owner: str) -> None:
    """Tell of facets that are larger than their far field allows."""
    if torch.compiler.is_compiling() or not from_radar_m.numel():
        return
    with torch.no_grad():
        edge = torch.linalg.vector_norm(from_radar_m - from_radar_m.roll(1, -2), dim=-1).amax(-1)
        allowed = far_field_edge_m(range_m[:, 0], wavelength_m)
        near = edge > allowed
        if bool(near.any()):
            warnings.warn(
                f"{owner}: {int(near.sum())} facets have edges up to {float(edge[near].max()):.2g} m and are in their "
                f"near field, from {float(range_m[near].min()):.3g} m on; split them with "
                f"subdivide(vertices_m, {float(allowed.min()):.2g}).",
                TorchweatherWarning,
                stacklevel=3,
            )
