"""Physical optics of triangles: against quadrature, closed forms, the oracle and the sphere."""

from __future__ import annotations

import math
import warnings

import numpy as np
import pytest
import torch
from torch import Tensor

from tests.oracles import load
from torchweather.core.errors import TorchweatherWarning
from torchweather.radar.fmcw.facet_rcs import far_field_edge_m, isosceles_triangle_rcs_m2, subdivide, triangle_field_m

WAVELENGTH_M = 299_792_458.0 / 77e9
WAVENUMBER_PER_M = 2.0 * math.pi / WAVELENGTH_M


def tensor(values: object) -> Tensor:
    return torch.tensor(values, dtype=torch.float64)


def direction(angle_rad: float, roll_rad: float = 0.0) -> Tensor:
    """Unit vector ``angle_rad`` off the z axis, towards ``roll_rad`` in the x-y plane."""
    sin = math.sin(angle_rad)
    return tensor([sin * math.cos(roll_rad), sin * math.sin(roll_rad), math.cos(angle_rad)])


def isosceles(base_m: float, height_m: float) -> Tensor:
    """Facing z, base along x."""
    return tensor([[[-base_m / 2, 0, 0], [base_m / 2, 0, 0], [0, height_m, 0]]])


def rectangle(width_m: float, height_m: float) -> Tensor:
    """Two triangles facing z, centred."""
    x, y = width_m / 2, height_m / 2
    a, b, c, d = [-x, -y, 0], [x, -y, 0], [x, y, 0], [-x, y, 0]
    return tensor([[a, b, c], [a, c, d]])


def coherent_rcs_m2(facets: Tensor, toward: Tensor, wavelength_m: float = WAVELENGTH_M) -> float:
    """Fields summed with each centroid's way there and back, in the far field."""
    field = triangle_field_m(facets, toward, wavelength_m)
    way = torch.exp(-4j * math.pi / wavelength_m * (facets.mean(-2) @ toward))
    return float((field * way).sum().abs() ** 2)


def by_quadrature(facets: Tensor, toward: Tensor, nodes: int = 60) -> Tensor:
    """``sqrt(4 pi) / lambda (n.s)+ int exp(-2jk s.r') dA`` by Gauss-Legendre on the triangle folded to a square."""
    x, weight = (torch.from_numpy(v) for v in np.polynomial.legendre.leggauss(nodes))
    u, v = (x[:, None] + 1) / 2, (x[None, :] + 1) / 2
    share = torch.stack([(1 - u).expand(nodes, nodes), u * (1 - v), u * v], -1)  # (n, n, 3)
    points = torch.einsum("pqc,fcx->fpqx", share, facets - facets.mean(-2, keepdim=True))
    normal = torch.linalg.cross(facets[:, 1] - facets[:, 0], facets[:, 2] - facets[:, 0])  # 2 A n
    element = weight[:, None] * weight[None, :] / 4 * u
    integral = (element * torch.exp(-2j * WAVENUMBER_PER_M * (points @ toward))).sum((-1, -2))
    return math.sqrt(4 * math.pi) / WAVELENGTH_M * (normal @ toward).clamp_min(0.0) * integral


def test_oracle_facet_at_77_ghz_by_transform_and_by_closed_form() -> None:
    block = load("facet_rcs_77GHz")
    base, height = block["base_m"], block["height_m"]
    for degrees, row in block["rows"].items():
        angle = math.radians(float(degrees))
        field = triangle_field_m(isosceles(base, height), direction(angle), WAVELENGTH_M)
        assert float(field.abs() ** 2) == pytest.approx(row["PO_numeric_m2"], rel=block["tol"])
        closed = isosceles_triangle_rcs_m2(base, height, angle, WAVELENGTH_M)
        assert float(closed) == pytest.approx(row["closed_form_m2"], rel=block["tol"])


def test_closed_form_holds_for_half_the_base_only() -> None:
    """With the whole base as d the same facet is off by far more than any rounding."""
    block = load("facet_rcs_77GHz")
    base, height, angle = block["base_m"], block["height_m"], math.radians(5.0)
    area = base * height / 2
    peak = 4 * math.pi * (area / WAVELENGTH_M * math.cos(angle)) ** 2

    def published(d_m: float) -> float:
        u = WAVENUMBER_PER_M * d_m * math.sin(angle)
        return peak * (math.sin(u) / u) ** 4

    exact = block["rows"]["5.0"]["PO_numeric_m2"]
    assert published(base / 2) == pytest.approx(exact, rel=block["tol"])
    assert published(base) != pytest.approx(exact, rel=0.5)
    assert float(isosceles_triangle_rcs_m2(base, height, angle, WAVELENGTH_M)) == pytest.approx(exact, rel=block["tol"])


def test_transform_equals_quadrature_over_a_dense_sweep() -> None:
    """Triangles of 2-8 wavelengths from specular to grazing, through every removable singularity.

    Tolerance: 60 nodes resolve the 16 turns of the fastest phase to rounding; the worst is 7e-15 of the peak.
    """
    generator = torch.Generator().manual_seed(0)
    random = (torch.rand(6, 3, 3, generator=generator, dtype=torch.float64) - 0.5) * 8 * WAVELENGTH_M
    facets = torch.cat([random, isosceles(0.02, 0.03), rectangle(0.03, 0.02)])
    normal = torch.nn.functional.normalize(
        torch.linalg.cross(facets[:, 1] - facets[:, 0], facets[:, 2] - facets[:, 0]), dim=-1
    )
    edges = torch.nn.functional.normalize(facets[:, 1] - facets[:, 0], dim=-1)
    worst = 0.0
    for tilt in [0.0, 1e-12, 1e-8, 1e-6, 1e-4, 1e-3, 0.01, 0.03, *torch.linspace(0.05, 1.55, 31).tolist()]:
        for roll in [0.0, math.pi / 2, 0.3, 2.0, 4.0]:
            side = torch.linalg.cross(normal, edges)
            across = math.cos(roll) * edges + math.sin(roll) * side  # roll pi/2: two phases equal
            toward = torch.nn.functional.normalize(math.cos(tilt) * normal + math.sin(tilt) * across, dim=-1)
            field = triangle_field_m(facets, toward, WAVELENGTH_M)
            for k in range(len(facets)):
                exact = by_quadrature(facets[k : k + 1], toward[k])
                peak = math.sqrt(4 * math.pi) / WAVELENGTH_M * _area_m2(facets[k])
                worst = max(worst, float((field[k] - exact).abs()) / peak)
    assert worst < 1e-13


def _area_m2(facet: Tensor) -> float:
    return float(torch.linalg.cross(facet[1] - facet[0], facet[2] - facet[0]).norm()) / 2


def test_plate_at_normal_incidence_returns_4_pi_area_squared_over_wavelength_squared() -> None:
    for width, height in ((0.1, 0.1), (0.05, 0.4)):
        expected = 4 * math.pi * (width * height / WAVELENGTH_M) ** 2
        assert coherent_rcs_m2(rectangle(width, height), direction(0.0)) == pytest.approx(expected, rel=1e-12)


@pytest.mark.parametrize("roll_rad", [0.0, math.pi / 2, 0.7])
@pytest.mark.parametrize("angle_deg", [0.0, 0.5, 3.0, 11.0, 40.0])
def test_two_triangles_of_a_rectangle_return_its_sinc_squared(angle_deg: float, roll_rad: float) -> None:
    width, height = 0.06, 0.04
    toward = direction(math.radians(angle_deg), roll_rad)
    x, y = (WAVENUMBER_PER_M * size * float(s) for size, s in ((width, toward[0]), (height, toward[1])))
    peak = 4 * math.pi * (width * height / WAVELENGTH_M) ** 2
    expected = peak * (float(toward[2]) * np.sinc(x / math.pi) * np.sinc(y / math.pi)) ** 2
    # Relative to the peak: in a null the two triangles cancel to rounding.
    assert coherent_rcs_m2(rectangle(width, height), toward) == pytest.approx(expected, rel=1e-9, abs=1e-14 * peak)


def test_field_belongs_to_the_centroid_wherever_the_facet_stands() -> None:
    """The way there and back is the caller's: tolerance from 5 m in float64, 1e-15 m of a wavelength."""
    facet, toward = isosceles(0.02, 0.03), direction(0.1, 0.4)
    field = triangle_field_m(facet, toward, WAVELENGTH_M)
    assert torch.allclose(triangle_field_m(facet + 5.0 * toward, toward, WAVELENGTH_M), field, rtol=1e-9)


def test_tessellated_sphere_tends_to_pi_radius_squared() -> None:
    """A sphere of 100 wavelengths in 82,000 facets of 1.4-2.1 wavelengths.

    Tolerance: a flat facet lies up to ``L^2 / (6 r)`` below the sphere, a phase error of 0.09 rad there and back. It
    repeats from facet to facet, so that the sum departs by at most its size; curvature is seen from four sides.
    """
    radius = 100 * WAVELENGTH_M
    base = icosahedron()
    edge = float((base[0, 0] - base[0, 1]).norm())
    ball = radius * torch.nn.functional.normalize(subdivide(base, edge / 64), dim=-1)
    longest = float((ball - ball.roll(1, -2)).norm(dim=-1).max())
    phase_error_rad = 2 * WAVENUMBER_PER_M * longest**2 / (6 * radius)
    assert phase_error_rad < 0.1
    for toward in ([1.0, 0.0, 0.0], [0.6, 0.0, 0.8], [0.36, 0.48, 0.8], [-0.48, 0.6, -0.64]):
        share = coherent_rcs_m2(ball, tensor(toward)) / (math.pi * radius**2)
        assert share == pytest.approx(1.0, abs=phase_error_rad)


def icosahedron() -> Tensor:
    """Unit vertices, ``(20, 3, 3)``, counter-clockwise from outside."""
    golden = (1 + math.sqrt(5)) / 2
    corners = []
    for a in (-1, 1):
        for b in (-golden, golden):
            corners += [(0.0, a, b), (a, b, 0.0), (b, 0.0, a)]
    points = tensor(corners)
    faces = []
    for i in range(12):
        for j in range(12):
            for k in range(12):
                near = all(float((points[p] - points[q]).norm()) < 2.1 for p, q in ((i, j), (j, k), (k, i)))
                distinct = i < j and i < k and j != k
                if distinct and near and float(torch.linalg.det(points[[i, j, k]])) > 0:
                    faces.append([i, j, k])
    assert len(faces) == 20
    return torch.nn.functional.normalize(points[torch.tensor(faces)], dim=-1)


def test_facet_seen_from_behind_returns_nothing() -> None:
    facet = isosceles(0.02, 0.03)
    assert complex(triangle_field_m(facet, direction(math.pi - 0.1), WAVELENGTH_M)) == 0
    assert complex(triangle_field_m(facet.flip(-2), direction(0.1), WAVELENGTH_M)) == 0
    assert float(isosceles_triangle_rcs_m2(0.02, 0.03, math.pi - 0.1, WAVELENGTH_M)) == 0


def test_reflectivity_scales_power() -> None:
    facet, toward = isosceles(0.02, 0.03), direction(0.05)
    metal, dull = (triangle_field_m(facet, toward, WAVELENGTH_M, eta).abs() ** 2 for eta in (1.0, 0.25))
    assert float(dull / metal) == pytest.approx(0.25, rel=1e-12)
    closed = isosceles_triangle_rcs_m2(0.02, 0.03, 0.05, WAVELENGTH_M, 0.25)
    assert float(closed) == pytest.approx(float(dull), rel=1e-9)


def test_batches_of_facets_and_directions_equal_one_by_one() -> None:
    facets = torch.cat([rectangle(0.05, 0.03), isosceles(0.02, 0.03)])
    targets = torch.stack([facets, 2 * facets])  # (2, 3, 3, 3)
    directions = torch.stack([direction(a, 0.3) for a in (0.0, 0.02, 0.4)])

    swept = triangle_field_m(facets[None], directions, WAVELENGTH_M)
    assert swept.shape == (3, 3)
    for row, toward in zip(swept, directions, strict=True):
        assert torch.equal(row, triangle_field_m(facets, toward, WAVELENGTH_M))

    both = triangle_field_m(targets, directions[:2], WAVELENGTH_M)
    own = triangle_field_m(targets, directions.expand(2, 3, 3), WAVELENGTH_M)
    for k in range(2):
        assert torch.equal(both[k], triangle_field_m(targets[k], directions[k], WAVELENGTH_M))
        assert torch.equal(own[k], triangle_field_m(targets[k], directions, WAVELENGTH_M))


def test_single_precision_facets_give_single_precision_fields() -> None:
    facets, toward = rectangle(0.05, 0.03), direction(0.1)
    single = triangle_field_m(facets.float(), toward.float(), WAVELENGTH_M)
    assert single.dtype == torch.complex64
    assert triangle_field_m(facets, toward, WAVELENGTH_M).dtype == torch.complex128
    # float32 corners of 5 cm are right to 2e-9 m: 6e-6 rad there and back, 1e-5 of the peak with the direction's own.
    exact = triangle_field_m(facets, toward, WAVELENGTH_M)
    peak = math.sqrt(4 * math.pi) / WAVELENGTH_M * 0.05 * 0.03 / 2
    assert float((single - exact).abs().max()) < 1e-5 * peak


@pytest.mark.parametrize("tilt_rad", [0.0, 1e-9, 1e-4, 0.02, 0.3])
def test_gradients_in_the_vertices(tilt_rad: float) -> None:
    facets = torch.cat([rectangle(0.03, 0.02), isosceles(0.02, 0.03)]).requires_grad_()
    toward = direction(tilt_rad, 0.4)

    def field(vertices: Tensor) -> Tensor:
        return torch.view_as_real(triangle_field_m(vertices, toward, WAVELENGTH_M))

    # Scaled to wavelengths, so that gradcheck's step of 1e-6 is small against the phase.
    assert torch.autograd.gradcheck(
        lambda x: field(x * WAVELENGTH_M), (facets.detach() / WAVELENGTH_M).requires_grad_()
    )
    (gradient,) = torch.autograd.grad(field(facets).square().sum(), facets)
    assert bool(gradient.isfinite().all())


def test_facet_without_area_is_silent_and_has_finite_gradients() -> None:
    padding = torch.zeros(1, 3, 3, dtype=torch.float64, requires_grad=True)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        field = triangle_field_m(padding, direction(0.2), WAVELENGTH_M)
    assert complex(field.detach()) == 0
    (gradient,) = torch.autograd.grad(torch.view_as_real(field).sum(), padding)
    assert bool(gradient.isfinite().all())


def test_facets_below_a_wavelength_warn_once_and_name_their_size() -> None:
    small = torch.cat([rectangle(0.002, 0.0015), rectangle(0.05, 0.05)])
    with pytest.warns(TorchweatherWarning, match=r"2 facets .* 0\.0025 m, wavelength 0\.00389 m") as caught:
        triangle_field_m(small, direction(0.0), WAVELENGTH_M)
    assert len(caught) == 1


def test_subdivision_keeps_surface_orientation_and_field() -> None:
    facets = torch.cat([rectangle(0.3, 0.2), isosceles(0.02, 0.03)])
    parts = subdivide(facets, 0.1)
    assert float((parts - parts.roll(1, -2)).norm(dim=-1).max()) <= 0.1 * (1 + 1e-9)
    twice_area = torch.linalg.cross(parts[:, 1] - parts[:, 0], parts[:, 2] - parts[:, 0])
    assert bool((twice_area[:, 2] > 0).all())
    assert float(twice_area[:, 2].sum()) / 2 == pytest.approx(0.3 * 0.2 + 0.02 * 0.03 / 2, rel=1e-12)
    assert torch.equal(parts[-1], facets[-1])  # short enough as it is, and in its place
    for angle in (0.0, 0.01, 0.1):
        whole, split = (coherent_rcs_m2(f, direction(angle, 0.2)) for f in (facets, parts))
        peak = 4 * math.pi * (0.06 / WAVELENGTH_M) ** 2
        assert split == pytest.approx(whole, rel=1e-9, abs=1e-14 * peak)


def test_large_plate_at_short_range_needs_parts() -> None:
    """1 x 1 m at 28 m lies within its near field: the whole facet overrates it, parts with their own range do not.

    Reference: spherical phase by the midpoint rule on cells of 2.5 mm, whose sagitta error is below 1e-3 rad.
    """
    plate, radar, range_m = rectangle(1.0, 1.0), tensor([0.0, 0.0, 28.0]), 28.0

    def rcs_m2(facets: Tensor) -> float:
        away = radar - facets.mean(-2)
        distance = away.norm(dim=-1)
        field = triangle_field_m(facets, away / distance[:, None], WAVELENGTH_M)
        return float((field * torch.exp(2j * WAVENUMBER_PER_M * distance)).sum().abs() ** 2)

    side = torch.arange(-0.5 + 0.00125, 0.5, 0.0025, dtype=torch.float64)
    distance = torch.sqrt(side[:, None] ** 2 + side[None, :] ** 2 + range_m**2)
    area = (range_m / distance * torch.exp(2j * WAVENUMBER_PER_M * distance)).sum() * 0.0025**2
    exact = float(4 * math.pi / WAVELENGTH_M**2 * area.abs() ** 2)

    edge = float(far_field_edge_m(range_m, WAVELENGTH_M))
    assert edge == pytest.approx(0.2335, abs=1e-4)
    # An error of phase falls with the square of the edge, its mark in the power with the fourth: 26 %, 0.3 % (half).
    assert rcs_m2(subdivide(plate, edge)) == pytest.approx(exact, rel=0.3)
    # Reference and parts of a third are each right to 4e-4.
    assert rcs_m2(subdivide(plate, edge / 3)) == pytest.approx(exact, rel=1e-3)
    assert rcs_m2(plate) > 2 * exact


def test_bad_input_is_named() -> None:
    facet, toward = isosceles(0.02, 0.03), direction(0.1)
    with pytest.raises(ValueError, match=r"vertices_m must be \(\.\.\., F, 3, 3\).*\(3, 3\)"):
        triangle_field_m(facet[0], toward, WAVELENGTH_M)
    with pytest.raises(TypeError, match="floating-point tensor"):
        triangle_field_m(facet.long(), toward, WAVELENGTH_M)
    with pytest.raises(ValueError, match="finite number in m"):
        triangle_field_m(facet * math.nan, toward, WAVELENGTH_M)
    with pytest.raises(ValueError, match=r"to_radar must be .* got shape \(5, 3\)"):
        triangle_field_m(facet.expand(4, 3, 3), toward.expand(5, 3), WAVELENGTH_M)
    with pytest.raises(ValueError, match=r"length of to_radar.*Give unit vectors"):
        triangle_field_m(facet, 28 * toward, WAVELENGTH_M)
    with pytest.raises(ValueError, match="wavelength_m must be above 0 m"):
        triangle_field_m(facet, toward, 0.0)
    with pytest.raises(ValueError, match=r"reflectivity must lie in 0\.\.1"):
        triangle_field_m(facet, toward, WAVELENGTH_M, 1.5)
    with pytest.raises(ValueError, match="max_edge_m must be above 0 m"):
        subdivide(facet, 0.0)
    with pytest.raises(ValueError, match="base_m must be above 0 m"):
        isosceles_triangle_rcs_m2(0.0, 0.03, 0.0, WAVELENGTH_M)


@pytest.mark.gpu
def test_fields_on_a_gpu_equal_those_on_the_cpu() -> None:
    if not torch.cuda.is_available():
        pytest.skip("no CUDA device")
    facets, toward = subdivide(rectangle(0.3, 0.2), 0.1), direction(0.05, 0.3)
    there = triangle_field_m(facets.cuda(), toward.cuda(), WAVELENGTH_M)
    assert there.is_cuda
    assert torch.allclose(there.cpu(), triangle_field_m(facets, toward, WAVELENGTH_M), rtol=1e-9)
