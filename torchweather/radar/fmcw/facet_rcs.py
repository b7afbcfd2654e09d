"""Radar cross section of flat facets by physical optics: what a metal triangle returns to the radar."""

from __future__ import annotations

import math
import warnings
from itertools import pairwise

import torch
from torch import Tensor

from torchweather.core.arguments import check_arguments, check_broadcast
from torchweather.core.errors import (
    InputTypeError,
    InputValueError,
    TorchweatherWarning,
    check_between,
    check_finite,
    check_positive,
)
from torchweather.physics.float64 import Quantity, to_float64

__all__ = ["far_field_edge_m", "isosceles_triangle_rcs_m2", "subdivide", "triangle_field_m"]

# Span of a triangle's three phases below which its transform is a series. There both ways are exact to rounding: the
# series' first term left out is below (2/3)^18 / (2 * 18!) = 5e-20, the difference quotients lose a factor of 2.
SERIES_BELOW_RAD = 1.0
SERIES_ORDER = 16
MOST_PARTS = 4_000_000  # of all triangles together that `subdivide` makes; 72 bytes each in float64
SINC_SERIES_BELOW = 1.0  # the first term left out of sin(x)/x is 1 / 19! = 8e-18


def triangle_field_m(
    vertices_m: Tensor, to_radar: Tensor, wavelength_m: Quantity, reflectivity: Quantity = 1.0
) -> Tensor:
    r"""Field that triangles return to the radar; its square is their radar cross section.

    ``F = sqrt(4 pi eta) / lambda * (n.s)+ * int_A exp(-2 j k s.r') dA``, ``k = 2 pi / lambda``, with r' from the
    triangle's centroid and s the unit vector to the radar: the currents of physical optics on the lit side. The
    integral over a triangle is closed: the second divided difference of exp at the phases of the three corners.

    Args:
        vertices_m: corners in metres, ``(..., F, 3, 3)``: facet, corner, x y z; counter-clockwise seen from outside.
        to_radar: unit vectors from the target to the radar, ``(3,)`` or ``(..., 3)`` (one for all facets of a target)
            or ``(..., F, 3)`` (one a facet).
        wavelength_m: above 0; a number or one that broadcasts against ``(..., F)``.
        reflectivity: eta, reflected power over incident power, 0-1; 1 is metal.

    Returns:
        Complex field in metres, ``(..., F)``: ``|F|^2`` is the cross section in m^2, its phase is that of an echo
        ``exp(+2 j k R)`` relative to the centroid's. 0 for a facet seen from behind. Computed in float64, returned in
        the precision of ``vertices_m``.

    Note:
        Sum fields times ``exp(2 j k R)`` for a coherent target. Flat facets well above a wavelength, in the far field
        (`far_field_edge_m`; else `subdivide` first). No edges, no double reflections, no shadow of one facet on
        another, no cross-polarisation. Below a wavelength physical optics means nothing; a warning names the size.
        Differentiable but where a facet turns edge-on.

    References:
        PHYSICS.md 6.3 and 6.4 (sign). Transform of a polygon as divided differences: Hermite-Genocchi formula.

    Example:
        A plate of 10 x 10 cm that faces the radar: ``4 pi A^2 / lambda^2`` from its two halves.

        >>> a, b, c, d = [0, 0, 0], [0, 0.1, 0], [0, 0.1, 0.1], [0, 0, 0.1]
        >>> plate = torch.tensor([[a, b, c], [a, c, d]], dtype=torch.float64)
        >>> field = triangle_field_m(plate, torch.tensor([1.0, 0, 0], dtype=torch.float64), 0.004)
        >>> round(float(field.sum().abs() ** 2), 2), round(4 * math.pi * 0.01**2 / 0.004**2, 2)
        (78.54, 78.54)
    """
    check_arguments(
        "triangle_field_m(vertices_m: real, to_radar: real, wavelength_m: Quantity, reflectivity: Quantity)",
        vertices_m,
        to_radar,
        wavelength_m,
        reflectivity,
    )
    owner = "triangle_field_m"
    _check_triangles(vertices_m, owner)
    check_positive("wavelength_m", wavelength_m, unit="m", owner=owner)
    check_between("reflectivity", reflectivity, 0.0, 1.0, owner=owner)
    toward = _one_a_facet(to_radar, vertices_m, owner)
    facets = {"facets": vertices_m[..., 0, 0], "to_radar": toward[..., 0]}
    check_broadcast(owner, **facets, wavelength_m=wavelength_m, reflectivity=reflectivity)

    corners, toward, wavelength, eta = to_float64(vertices_m, toward, wavelength_m, reflectivity)
    _warn_if_small(corners, wavelength, owner)
    first, second, third = corners.unbind(-2)
    twice_area = torch.linalg.cross(second - first, third - first, dim=-1)  # (..., F, 3), along the outward normal
    facing = (twice_area * toward).sum(-1).clamp_min(0.0)  # 2 A (n.s)+, needs no unit normal
    from_centroid = corners - corners.mean(-2, keepdim=True)
    nearer = (from_centroid * toward[..., None, :]).sum(-1)  # (..., F, 3), metres
    phase = -4.0 * math.pi / wavelength[..., None] * nearer
    field: Tensor = (math.sqrt(4.0 * math.pi) / wavelength * eta.sqrt() * facing) * _unit_triangle_transform(phase)
    exact = torch.promote_types(vertices_m.dtype, torch.float32)  # complex numbers of 2 x 16 bits are no type of all
    return field.to(exact.to_complex())


def isosceles_triangle_rcs_m2(
    base_m: Quantity, height_m: Quantity, angle_rad: Quantity, wavelength_m: Quantity, reflectivity: Quantity = 1.0
) -> Tensor:
    r"""Radar cross section of an isosceles triangle turned about its axis of symmetry, m^2.

    ``sigma = eta (4 pi A^2 / lambda^2) cos^2(theta) (sin u / u)^4``, ``u = (2 pi / lambda) d sin(theta)`` with
    **d half the base**. D3.4 does not say which d is meant; the whole base is wrong.

    Args:
        base_m, height_m: above 0, metres.
        angle_rad: theta between normal and direction of the radar, in the plane through base and normal; 0 beyond 90
            degrees, where the facet is seen from behind.
        wavelength_m: above 0.
        reflectivity: eta, reflected power over incident power, 0-1.

    Returns:
        float64, the arguments broadcast.

    References:
        PHYSICS.md 6.3 (Pandey & Ram 2022).

    Example:
        >>> round(float(isosceles_triangle_rcs_m2(0.02, 0.03, 0.0, 0.00389341)), 5)
        0.07461
    """
    check_arguments(
        "isosceles_triangle_rcs_m2(base_m: Quantity, height_m: Quantity, angle_rad: Quantity, "
        "wavelength_m: Quantity, reflectivity: Quantity)",
        base_m,
        height_m,
        angle_rad,
        wavelength_m,
        reflectivity,
    )
    check_broadcast(
        "isosceles_triangle_rcs_m2",
        base_m=base_m,
        height_m=height_m,
        angle_rad=angle_rad,
        wavelength_m=wavelength_m,
        reflectivity=reflectivity,
    )
    owner = "isosceles_triangle_rcs_m2"
    for name, value in (("base_m", base_m), ("height_m", height_m), ("wavelength_m", wavelength_m)):
        check_positive(name, value, unit="m", owner=owner)
    check_finite("angle_rad", angle_rad, unit="rad", owner=owner)
    check_between("reflectivity", reflectivity, 0.0, 1.0, owner=owner)
    base, height, angle, wavelength, eta = to_float64(base_m, height_m, angle_rad, wavelength_m, reflectivity)
    area = base * height / 2.0
    half_base = base / 2.0
    u = 2.0 * math.pi / wavelength * half_base * torch.sin(angle)
    return eta * 4.0 * math.pi * (area / wavelength * torch.cos(angle).clamp_min(0.0)) ** 2 * _sinc(u) ** 4


def far_field_edge_m(range_m: Quantity, wavelength_m: Quantity) -> Tensor:
    """Longest edge of a facet in the far field, metres: ``L = sqrt(R lambda / 2)``, from ``R = 2 L^2 / lambda``.

    There the spherical wave departs from a plane one by a sixteenth of a wavelength at the facet's rim, there and back
    an eighth. A 1 m plate at 28 m in parts of L, each with its own range, is right to 1 dB; in parts of L / 3 to
    0.01 dB.

    Args:
        range_m: distance of the facet, above 0.
        wavelength_m: above 0.

    References:
        PHYSICS.md 6.3; Fraunhofer distance, IEEE Std 145.

    Example:
        >>> round(float(far_field_edge_m(28.0, 0.0039)), 3)
        0.234
    """
    check_positive("range_m", range_m, unit="m", owner="far_field_edge_m")
    check_positive("wavelength_m", wavelength_m, unit="m", owner="far_field_edge_m")
    distance, wavelength = to_float64(range_m, wavelength_m)
    return torch.sqrt(distance * wavelength / 2.0)


def subdivide(vertices_m: Tensor, max_edge_m: float) -> Tensor:
    """Split triangles into similar ones with no edge longer than ``max_edge_m``.

    A facet's echo is right in its far field only, ``R > 2 L^2 / lambda``: at 28 m and 3.9 mm its edges must stay below
    0.23 m (`far_field_edge_m`). Parts of a large facet, each with its own range, give the near field too.

    Args:
        vertices_m: ``(..., F, 3, 3)``; the members of a batch are split alike, after the longest edge among them.
        max_edge_m: above 0.

    Returns:
        ``(..., F', 3, 3)``, in the order of the facets, orientation and surface kept; differentiable. A triangle of n
        times the edge becomes n^2.

    References:
        PHYSICS.md 6.3.

    Example:
        >>> triangle = torch.tensor([[[0.0, 0.0, 0.0], [0.0, 0.4, 0.0], [0.0, 0.0, 0.3]]])
        >>> subdivide(triangle, 0.26).shape
        torch.Size([4, 3, 3])
    """
    check_arguments("subdivide(vertices_m: real, max_edge_m: float)", vertices_m, max_edge_m)
    _check_triangles(vertices_m, "subdivide")
    check_positive("max_edge_m", max_edge_m, unit="m", owner="subdivide")
    check_between("max_edge_m", max_edge_m, 1e-9, 1e9, unit="m", owner="subdivide")
    if not vertices_m.numel():
        return vertices_m
    longest = _longest_edge_m(vertices_m.detach().double()).reshape(-1, vertices_m.shape[-3])
    # A rounding above a whole number of parts is none.
    parts = torch.ceil(longest.amax(0) / max_edge_m * (1.0 - 1e-9)).clamp_min(1)
    if float(parts.square().sum()) > MOST_PARTS:
        raise InputValueError(
            f"subdivide: max_edge_m must leave at most {MOST_PARTS} triangles; got {max_edge_m!r} m, which makes "
            f"{float(parts.square().sum()):.3g} of them."
        )
    parts = parts.long()
    split, origin = [], []
    for count in sorted(set(parts.tolist())):
        (facet,) = torch.nonzero(parts == count, as_tuple=True)
        weights = _barycentric_split(count).to(vertices_m)
        split.append(torch.einsum("tcv,...fvx->...ftcx", weights, vertices_m[..., facet, :, :]).flatten(-4, -3))
        origin.append(facet.repeat_interleave(count**2))
    return torch.cat(split, -3)[..., torch.cat(origin).argsort(stable=True), :, :] if split else vertices_m


def _barycentric_split(count: int) -> Tensor:
    """Corners of the ``count^2`` parts of a triangle as weights of its own corners, ``(count^2, 3, 3)`` float64."""
    rows = torch.arange(count)
    in_row = 2 * (count - rows) - 1  # upright and inverted triangles in turn
    i = rows.repeat_interleave(in_row)
    place = torch.arange(count**2) - (in_row.cumsum(0) - in_row)[i]
    j, inverted = place // 2, place % 2
    corners = [(i + inverted, j), (i + 1, j + inverted), (i, j + 1)]
    steps = torch.stack([torch.stack(corner, -1) for corner in corners], 1).double()  # (count^2, 3, 2)
    return torch.cat([count - steps.sum(-1, keepdim=True), steps], -1) / count


def _unit_triangle_transform(phase: Tensor) -> Tensor:
    """``int exp(j (t.phase)) dt`` over ``t >= 0, sum t = 1``: 1/2 at phase 0. Phases ``(..., 3)`` of mean 0."""
    ordered = phase.sort(dim=-1).values
    span = ordered[..., 2] - ordered[..., 0]
    wide = span > SERIES_BELOW_RAD
    # Each branch sees phases it is safe for, so that no gradient becomes nan.
    one = torch.ones_like(span)
    # torch.polar's gradient is right for a positive modulus only: the sinc stays outside.
    lower, upper = (_sinc((b - a) / 2.0) * torch.polar(one, (a + b) / 2.0) for a, b in pairwise(ordered.unbind(-1)))
    quotient = -1j * (upper - lower) / torch.where(wide, span, one)
    return torch.where(wide, quotient, _transform_series(torch.where(wide[..., None], torch.zeros_like(phase), phase)))


def _transform_series(phase: Tensor) -> Tensor:
    """The same for phases near 0: ``sum_n j^n h_n / (n + 2)!`` with the complete symmetric polynomials h_n."""
    a, b, c = phase.unbind(-1)
    pairs, product = a * b + b * c + c * a, a * b * c
    # h_n = -pairs h_(n-2) + product h_(n-3); the term with a + b + c = 0 is gone.
    h = [torch.ones_like(a), torch.zeros_like(a), -pairs]
    for _ in range(3, SERIES_ORDER + 1):
        h.append(product * h[-3] - pairs * h[-2])
    real, imag = (
        sum(((-1) ** (n // 2) / math.factorial(n + 2) * h[n] for n in range(start, SERIES_ORDER + 1, 2)), 0.0 * a)
        for start in (0, 1)
    )
    return torch.complex(real, imag)


def _sinc(x: Tensor) -> Tensor:
    """``sin(x) / x`` with a gradient that stays exact at and near 0."""
    near = x.abs() < SINC_SERIES_BELOW
    square = torch.where(near, x, torch.zeros_like(x)) ** 2
    series = torch.ones_like(x)
    for n in range(8, 0, -1):
        series = 1.0 - square * series / (2 * n * (2 * n + 1))
    far = torch.where(near, torch.ones_like(x), x)
    return torch.where(near, series, torch.sin(far) / far)


def _longest_edge_m(corners_m: Tensor) -> Tensor:
    """``(..., F)``."""
    longest: Tensor = torch.linalg.vector_norm(corners_m - corners_m.roll(1, -2), dim=-1).amax(-1)
    return longest


def _check_triangles(vertices_m: Tensor, owner: str) -> None:
    check_arguments(f"{owner}(vertices_m: floating(..., 3, 3))", vertices_m)
    if vertices_m.ndim < 3:
        raise InputValueError(f"{owner}: vertices_m must be (..., F, 3, 3); got {tuple(vertices_m.shape)}.")
    if vertices_m.ndim < 3 or vertices_m.shape[-2:] != (3, 3):
        raise InputValueError(
            f"{owner}: vertices_m must be (..., F, 3, 3) in metres: facet, corner, x y z; "
            f"got shape {tuple(vertices_m.shape)}."
        )
    if not vertices_m.is_floating_point():
        raise InputTypeError(f"{owner}: vertices_m must be floating point; got {vertices_m.dtype}.")
    check_finite("vertices_m", vertices_m, unit="m", owner=owner)


def _one_a_facet(to_radar: Tensor, vertices_m: Tensor, owner: str) -> Tensor:
    """The directions as ``(..., 1 or F, 3)``."""
    check_arguments(f"{owner}(to_radar: floating(..., 3))", to_radar)
    per_target = to_radar.ndim == 1 or to_radar.ndim == vertices_m.ndim - 2
    toward = to_radar[..., None, :] if per_target else to_radar
    facets = vertices_m.shape[:-2]
    if to_radar.shape[-1:] != (3,) or not (per_target or to_radar.ndim == vertices_m.ndim - 1):
        fits = False
    else:
        fits = all(a == b or 1 in (a, b) for a, b in zip(toward.shape[-2::-1], facets[::-1], strict=False))
    if not fits:
        raise InputValueError(
            f"{owner}: to_radar must be (3,), (..., 3) or (..., F, 3) for vertices_m {tuple(vertices_m.shape)}; "
            f"got shape {tuple(to_radar.shape)}. For D directions on one target give vertices_m[None] and (D, 3)."
        )
    # 1e-3: far above float32's rounding, far below a direction that was not normalised.
    length = torch.linalg.vector_norm(to_radar, dim=-1)
    check_between("length of to_radar", length, 0.999, 1.001, owner=owner, advice="Give unit vectors.")
    return toward


def _warn_if_small(corners_m: Tensor, wavelength_m: Tensor, owner: str) -> None:
    """Tell of facets below a wavelength; those without area (padding) are none."""
    if torch.compiler.is_compiling() or not corners_m.numel():
        return
    with torch.no_grad():
        longest = _longest_edge_m(corners_m)
        small = (longest > 0) & (longest < wavelength_m)
        if not bool(small.any()):
            return
        size = float(longest.expand(small.shape)[small].min())
        warnings.warn(
            f"{owner}: {int(small.sum())} facets are smaller than the wavelength (longest edge from {size:.2g} m, "
            f"wavelength {float(wavelength_m.max()):.3g} m): physical optics means nothing for them. "
            "Use larger facets, or point scatterers of known cross section.",
            TorchweatherWarning,
            stacklevel=3,
        )
