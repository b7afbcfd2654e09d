"""First hits against closed forms."""

from __future__ import annotations

import math

import pytest
import torch
from torch import Tensor

from torchweather.scenes.primitives import (
    Box,
    Capsule,
    Cylinder,
    Ellipsoid,
    FacetMesh,
    Foliage,
    GroundPatch,
    Plane,
    Shape,
    Treeline,
)

ORIGIN = torch.zeros(3, dtype=torch.float64)

SHAPES: dict[str, Shape] = {
    "plane": Plane((12.0, 0.0, 0.0), (-1.0, 0.0, 0.0)),
    "ground patch": GroundPatch((2.0, 40.0), (-9.0, 9.0), z_m=-1.0),
    "box": Box((12.0, 0.5, 0.3), (2.0, 1.5, 3.0), yaw_rad=0.6),
    "ellipsoid": Ellipsoid((12.0, 0.0, 0.0), (1.0, 2.0, 1.5)),
    "foliage": Foliage((Ellipsoid((12.0, 0.0, 0.0), (2.0, 2.0, 2.0)),), (0.4,)),
    "cylinder": Cylinder((12.0, 0.0, -2.0), (12.0, 0.5, 2.0), 0.8),
    "tube": Cylinder((12.0, -0.4, 0.0), (12.5, 0.4, 0.0), 1.5, inner_radius_m=1.0),
    "capsule": Capsule((11.0, -1.0, -1.0), (12.0, 1.0, 1.0), 0.5),
    "mesh": FacetMesh(((10.0, -2.0, -2.0), (11.0, 2.0, -2.0), (12.0, 0.0, 2.0)), ((0, 1, 2),)),
    "treeline": Treeline((30.0, 20.0), (25.0, -20.0)),
}


def fan(dtype: torch.dtype = torch.float64) -> Tensor:
    """Rays around the x axis, not of unit length."""
    y, z = torch.meshgrid(torch.linspace(-0.3, 0.3, 41), torch.linspace(-0.3, 0.3, 41), indexing="ij")
    return torch.stack([torch.ones_like(y), y + 1e-4, z + 2e-4], -1).reshape(-1, 3).to(dtype)


@pytest.mark.parametrize("name", SHAPES)
def test_normals_have_unit_length_and_face_the_viewer(name: str) -> None:
    rays = fan()
    t, normal = SHAPES[name].intersect(ORIGIN, rays)
    hit = torch.isfinite(t)
    assert hit.any()
    torch.testing.assert_close(normal[hit].norm(dim=-1), torch.ones(int(hit.sum()), dtype=torch.float64))
    assert ((normal * rays).sum(-1)[hit] <= 0).all()


@pytest.mark.parametrize("name", SHAPES)
def test_hits_lie_in_the_bounding_sphere(name: str) -> None:
    rays = fan()
    t, _ = SHAPES[name].intersect(ORIGIN, rays)
    centre, radius = SHAPES[name].bounding_sphere()
    point = t[:, None] * rays
    distance = (point - torch.tensor(centre, dtype=torch.float64)).norm(dim=-1)
    assert (distance[torch.isfinite(t)] <= radius + 1e-9).all()


@pytest.mark.parametrize("name", SHAPES)
def test_the_parameter_counts_lengths_of_the_direction(name: str) -> None:
    rays = fan()
    once, _ = SHAPES[name].intersect(ORIGIN, rays)
    twice, _ = SHAPES[name].intersect(ORIGIN, 2 * rays)
    hit = torch.isfinite(once) & torch.isfinite(twice)
    # Rays that graze an outline may fall to either side of it by rounding.
    assert hit.sum() >= 0.99 * torch.isfinite(once).sum()
    torch.testing.assert_close(twice[hit], once[hit] / 2, rtol=1e-9, atol=0)


def test_nothing_behind_the_viewer_is_hit() -> None:
    for shape in SHAPES.values():
        t, _ = shape.intersect(ORIGIN, -fan())
        assert torch.isinf(t).all()


def test_plane_distance_is_height_over_sine() -> None:
    depression = torch.linspace(0.05, 1.5, 30, dtype=torch.float64)
    rays = torch.stack([depression.cos(), torch.zeros_like(depression), -depression.sin()], -1)
    t, _ = Plane((0.0, 0.0, 0.0), (0.0, 0.0, 1.0)).intersect(torch.tensor([0.0, 0.0, 1.5], dtype=torch.float64), rays)
    torch.testing.assert_close(t, 1.5 / depression.sin())


def test_box_turned_by_45_degrees_shows_its_edge_half_a_diagonal_nearer() -> None:
    t, _ = Box((10.0, 0.0, 0.0), (1.0, 1.0, 1.0), yaw_rad=math.pi / 4).intersect(
        ORIGIN, torch.tensor([[1.0, 0.0, 0.0]], dtype=torch.float64)
    )
    assert float(t) == pytest.approx(10 - math.sqrt(0.5), rel=1e-9)


def test_a_long_box_turned_to_the_left_reaches_to_the_left() -> None:
    # Its long axis points along yaw = +30 degrees, x to y: above its end, at positive y, a look down meets it.
    box = Box((10.0, 0.0, 0.0), (6.0, 0.1, 1.0), yaw_rad=math.radians(30))
    down = torch.tensor([[0.0, 0.0, -1.0]], dtype=torch.float64)
    for side, meets in ((1, True), (-1, False)):
        above = [10 + 2.5 * math.cos(math.radians(30)), side * 2.5 * math.sin(math.radians(30)), 5.0]
        t, _ = box.intersect(torch.tensor(above, dtype=torch.float64), down)
        assert bool(torch.isfinite(t).all()) is meets


def test_sphere_hit_solves_its_quadratic() -> None:
    centre, radius = torch.tensor([12.0, 1.0, 0.5], dtype=torch.float64), 2.0
    rays = fan()
    t, _ = Ellipsoid((12.0, 1.0, 0.5), (radius,) * 3).intersect(ORIGIN, rays)
    a, b, c = (rays * rays).sum(-1), rays @ centre, centre @ centre - radius**2
    expected = (b - (b * b - a * c).sqrt()) / a
    hit = b * b > a * c
    assert torch.equal(hit, torch.isfinite(t))
    torch.testing.assert_close(t[hit], expected[hit])


def test_hits_lie_on_the_surface_of_capsule_and_tube() -> None:
    rays = fan()
    capsule = SHAPES["capsule"]
    assert isinstance(capsule, Capsule)
    start, end = (torch.tensor(p, dtype=torch.float64) for p in (capsule.start_m, capsule.end_m))
    t, _ = capsule.intersect(ORIGIN, rays)
    point = (t[:, None] * rays)[torch.isfinite(t)]
    share = ((point - start) @ (end - start) / (end - start).square().sum()).clamp(0, 1)
    to_segment = (point - start - share[:, None] * (end - start)).norm(dim=-1)
    torch.testing.assert_close(to_segment, torch.full_like(to_segment, capsule.radius_m))


def test_a_tube_is_open_along_its_bore_and_closed_across_it() -> None:
    tube = Cylinder((10.0, 0.0, 0.0), (11.0, 0.0, 0.0), 1.0, inner_radius_m=0.5)
    rays = torch.tensor([[1.0, 0.0, 1e-6], [1.0, 0.0, 0.075], [1.0, 0.0, 0.2]], dtype=torch.float64)
    t, _ = tube.intersect(ORIGIN, rays)
    assert torch.isinf(t[[0, 2]]).all()
    assert float(t[1]) == pytest.approx(10.0)


def test_triangle_is_hit_inside_only() -> None:
    mesh = FacetMesh(((10.0, 0.0, 0.0), (10.0, 1.0, 0.0), (10.0, 0.0, 1.0)), ((0, 1, 2),))
    aim = torch.tensor([[10.0, 0.2, 0.2], [10.0, 0.8, 0.8], [10.0, -0.1, 0.2]], dtype=torch.float64)
    t, _ = mesh.intersect(ORIGIN, aim)
    assert torch.isfinite(t).tolist() == [True, False, False]
    assert float(t[0]) == pytest.approx(1.0)


def test_closed_foliage_is_its_ellipsoid_and_open_foliage_is_nothing() -> None:
    ball = Ellipsoid((12.0, 0.0, 0.0), (2.0, 2.0, 2.0))
    rays = fan()
    torch.testing.assert_close(Foliage((ball,), (-1.0,)).intersect(ORIGIN, rays)[0], ball.intersect(ORIGIN, rays)[0])
    assert torch.isinf(Foliage((ball,), (1.0,)).intersect(ORIGIN, rays)[0]).all()


def test_dashes_cover_their_share_of_the_line() -> None:
    patch = GroundPatch((0.0, 120.0), (-1.0, 1.0), z_m=-1.0, dash_m=4.0, gap_m=8.0)
    x = torch.arange(0.25, 120, 0.5, dtype=torch.float64)
    t, _ = patch.intersect(ORIGIN, torch.stack([x, torch.zeros_like(x), -torch.ones_like(x)], -1))
    assert torch.isfinite(t).double().mean() == pytest.approx(1 / 3)
