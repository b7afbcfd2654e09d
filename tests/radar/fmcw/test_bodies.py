"""Bodies as scatterers: corner reflectors against traced rays and plates, gathering, and the car."""

from __future__ import annotations

import math

import pytest
import torch
from torch import Tensor

from torchweather.core.errors import TorchweatherWarning
from torchweather.radar.fmcw.bodies import corner_reflector_rcs_m2, corner_scatterers, facet_scatterers, gathered
from torchweather.radar.fmcw.car import CAR_DETAILS, car_details, car_facets, car_scatterers
from torchweather.radar.fmcw.facet_rcs import subdivide, triangle_field_m
from torchweather.radar.fmcw.scatterers import Scatterers

WAVELENGTH_M = 299_792_458.0 / 77e9
STILL = torch.zeros(3, dtype=torch.float64)


def tensor(values: object) -> Tensor:
    return torch.tensor(values, dtype=torch.float64)


def coherent_rcs_m2(seen: Scatterers, wavelength_m: float = WAVELENGTH_M) -> float:
    """Of all scatterers together, in the convention exp(+2jkR)."""
    way = torch.exp(4j * math.pi / wavelength_m * seen.range_m)
    return float((seen.field_m * way).sum().abs() ** 2)


# Corner reflectors.


def test_corner_on_boresight_returns_like_the_plate_of_its_hexagonal_aperture() -> None:
    """Rays come back where a point of the aperture and its mirror image both lie in the triangle: a hexagon."""
    edge = 0.15
    side = math.sqrt(2) * edge / 3  # of the hexagon, a third of the outer edge
    turns = torch.arange(7, dtype=torch.float64) * math.pi / 3
    rim = side * torch.stack([torch.cos(turns), torch.sin(turns), torch.zeros(7)], -1)
    plate = torch.stack([torch.zeros(6, 3), rim[:-1], rim[1:]], -2)
    field = triangle_field_m(plate, tensor([0.0, 0.0, 1.0]), WAVELENGTH_M).sum()
    rcs = float(corner_reflector_rcs_m2(edge, WAVELENGTH_M))
    assert rcs == pytest.approx(float(field.abs() ** 2), rel=1e-12)
    assert rcs == pytest.approx(4 * math.pi * edge**4 / (3 * WAVELENGTH_M**2), rel=1e-12)


def traced_aperture_m2(edge_m: float, toward: Tensor, cells: int = 400) -> float:
    """Aperture whose rays meet all three faces of the corner within their triangles: rays on a grid, mirrored."""
    a = torch.linspace(-1.5, 1.5, cells, dtype=torch.float64) * edge_m
    up = tensor([0.0, 0.0, 1.0])
    left = torch.nn.functional.normalize(torch.linalg.cross(up, toward), dim=-1)
    top = torch.linalg.cross(toward, left)
    origin = (a[:, None, None] * left + a[None, :, None] * top + 3 * edge_m * toward).reshape(-1, 3)
    way = (-toward).expand_as(origin).clone()
    alive = torch.ones(len(origin), dtype=torch.bool)
    for _ in range(3):
        # Planes of the faces: coordinate i is 0; the next one is met first.
        time = torch.where(way < -1e-12, -origin / way, math.inf)
        time = torch.where(time > 1e-9, time, math.inf)
        first, face = time.min(-1)
        alive &= first.isfinite()
        origin = origin + torch.where(alive, first, 0.0)[:, None] * way
        inside = (origin >= -1e-9).all(-1) & (origin.sum(-1) <= edge_m)
        alive &= inside
        way = way * (1 - 2 * torch.nn.functional.one_hot(face, 3))
    return float(alive.sum()) * float(a[1] - a[0]) ** 2


@pytest.mark.parametrize("cosines", [(1, 1, 1), (1, 1, 1.6), (0.3, 1, 1), (0.2, 0.4, 1), (0.9, 1.2, 0.6)])
def test_corner_off_boresight_has_the_aperture_of_traced_rays(cosines: tuple[float, float, float]) -> None:
    """Tolerance: the aperture's rim crosses about 1 % of the grid's cells that lie inside it."""
    toward = torch.nn.functional.normalize(tensor(cosines), dim=-1)
    aperture = traced_aperture_m2(0.1, toward)
    rcs = float(corner_reflector_rcs_m2(0.1, WAVELENGTH_M, toward))
    assert rcs == pytest.approx(4 * math.pi * (aperture / WAVELENGTH_M) ** 2, rel=0.03)


def test_corner_seen_from_behind_a_face_returns_nothing() -> None:
    behind = torch.nn.functional.normalize(tensor([[1.0, 1.0, -0.1], [-1.0, -1.0, -1.0]]), dim=-1)
    assert corner_reflector_rcs_m2(0.1, WAVELENGTH_M, behind).tolist() == [0.0, 0.0]


def test_corner_scatterers_stand_where_they_are_and_lose_half_their_power_20_degrees_off() -> None:
    place = tensor([[20.0, 3.0, 1.0]])
    radar, velocity = tensor([0.0, 3.0, 1.0]), tensor([-5.0, 2.0, 0.0])

    def seen(turn_deg: float) -> Scatterers:
        turn = math.radians(180 + turn_deg)
        facing = tensor([[math.cos(turn), math.sin(turn), 0.0]])
        return corner_scatterers(place, facing, tensor([0.1]), radar, velocity, WAVELENGTH_M)

    straight = seen(0.0)
    assert straight.position_m.tolist() == [[20.0, 0.0, 0.0]]
    assert float(straight.speed_m_per_s) == pytest.approx(-5.0)
    assert float(straight.rcs_dbsm) == pytest.approx(10 * math.log10(4 * math.pi * 1e-4 / 3 / WAVELENGTH_M**2))
    # Half-power width of a triangular trihedral: about 40 degrees (Robertson 1947, unverified); one of its axes.
    for turn_deg in (-20.0, 20.0):
        assert -4.0 < float(seen(turn_deg).rcs_dbsm - straight.rcs_dbsm) < -2.0
    assert complex(seen(90.0).field_m) == 0


# Facets as scatterers.


def test_facet_scatterers_are_the_facets_that_face_the_radar() -> None:
    front = tensor([[[10.0, -0.05, 0.0], [10.0, 0.0, 0.05], [10.0, 0.05, 0.0]]])
    back = front.flip(-2) + tensor([0.2, 0.0, 0.0])
    radar, velocity = tensor([0.0, 0.0, 0.5]), tensor([4.0, 0.0, 0.0])
    seen = facet_scatterers(torch.cat([back, front]), radar, velocity, WAVELENGTH_M)
    centroid = front[0].mean(0) - radar
    assert torch.allclose(seen.position_m, centroid[None])
    assert float(seen.speed_m_per_s) == pytest.approx(float(4.0 * centroid[0] / centroid.norm()))
    away = torch.nn.functional.normalize(centroid, dim=-1)
    assert torch.equal(seen.field_m, triangle_field_m(front - radar, -away, WAVELENGTH_M))


def test_facets_in_their_near_field_warn_and_name_the_edge_they_may_have() -> None:
    plate = 5 * tensor([[[4.0, -0.1, 0.0], [4.0, 0.0, 0.1], [4.0, 0.1, 0.0]]])
    with pytest.warns(TorchweatherWarning, match=r"1 facets have edges up to 1 m .* subdivide\(vertices_m, 0\.2\)"):
        facet_scatterers(plate, STILL, STILL, WAVELENGTH_M)
    assert len(facet_scatterers(subdivide(plate, 0.19), STILL, STILL, WAVELENGTH_M).field_m) == 36


def test_gathered_scatterers_echo_as_before_at_the_carrier() -> None:
    generator = torch.Generator().manual_seed(3)
    place = tensor([20.0, -1.0, 0.0]) + torch.rand(400, 3, generator=generator, dtype=torch.float64)
    phase = 2 * math.pi * torch.rand(400, generator=generator, dtype=torch.float64)
    many = Scatterers.from_rcs(place, -10.0, 3.0, phase)
    few = gathered(many, WAVELENGTH_M, 0.25)
    assert len(few.field_m) <= 5**3
    # Rounding of 1e-15 m in 20 m, 400 terms.
    assert coherent_rcs_m2(few) == pytest.approx(coherent_rcs_m2(many), rel=1e-8)
    assert few.speed_m_per_s.tolist() == pytest.approx([3.0] * len(few.field_m))
    low, high = few.position_m.amin(0), few.position_m.amax(0)
    assert bool((low >= place.amin(0)).all())
    assert bool((high <= place.amax(0)).all())
    single = gathered(Scatterers.from_rcs(place[:1], 3.0), WAVELENGTH_M, 0.25)
    assert torch.allclose(single.position_m, place[:1])


def test_gathered_scatterers_echo_as_before_across_the_sweep() -> None:
    """77 GHz +- 0.25 GHz, dR = 0.3 m, cells of 0.1 m: phases off by at most pi x 0.05 x sqrt(3) / 0.3 = 0.9 rad, each.

    The sum over 8 cells a side stays within 1 dB of the facets' on the mean over the sweep, gathered at its middle.
    """
    car = car_scatterers((28.0, 0.0), WAVELENGTH_M, details=(), cell_m=None)
    few = gathered(car, WAVELENGTH_M, 0.1)
    assert len(few.field_m) < len(car.field_m) / 5
    wavelengths = [299_792_458.0 / (77e9 + offset) for offset in torch.linspace(-0.25e9, 0.25e9, 21).tolist()]
    whole, less = (sum(coherent_rcs_m2(s, w) for w in wavelengths) for s in (car, few))
    assert 10 * math.log10(less / whole) == pytest.approx(0.0, abs=1.0)


# The car.


def test_car_is_closed_and_faces_outward() -> None:
    car = car_facets()
    corners, index = torch.unique(car.reshape(-1, 3), dim=0, return_inverse=True)
    index = index.reshape(-1, 3)
    start, end = index, index.roll(-1, -1)
    ways = (start * len(corners) + end).flatten()
    back = (end * len(corners) + start).flatten()
    assert len(ways.unique()) == len(ways)  # each edge once in each direction
    assert torch.equal(ways.sort().values, back.sort().values)
    volume = float((torch.linalg.cross(car[:, 0], car[:, 1]) * car[:, 2]).sum()) / 6
    # 4.3 x 1.8 x 1.27 m of bounding box, two thirds of it filled.
    assert 0.55 < volume / (4.3 * 1.8 * 1.27) < 0.8


def test_car_has_the_named_size_and_its_rear_at_the_origin() -> None:
    car = car_facets(4.8, 1.9, 1.6)
    low, high = car.amin((0, 1)), car.amax((0, 1))
    # Levels come every 3 cm; 1.5 cm off the foremost one the body falls back by 0.2 mm at most.
    assert torch.allclose(low, tensor([0.0, -0.95, 0.2 * 1.6 / 1.47]), atol=5e-4)
    assert torch.allclose(high, tensor([4.8, 0.95, 1.6]), atol=5e-4)
    assert float(car[car[..., 0] < 0.005].mean(0)[1]) == pytest.approx(0.0, abs=1e-6)  # symmetric about its middle


def test_car_skin_returns_the_product_of_its_radii_from_the_spot_that_faces_the_radar() -> None:
    """``pi R1 R2``: 0.9^2 / (2 x 0.10) = 4.05 m across; up the bumper 0.15^2 / (2 x 0.01) = 1.1 m by its levels,
    0.83 m by the curvature of the outline at its rearmost point. 10.2 dBsm; end of the bumper's bow and facets of 3 cm:
    1.5 dB.
    """
    expected = 10 * math.log10(math.pi * 4.05 * 0.83)
    for yaw_deg in (0.0, 2.0, 5.0):
        seen = car_scatterers((28.0, 0.0), WAVELENGTH_M, yaw_rad=math.radians(yaw_deg), details=())
        assert 10 * math.log10(coherent_rcs_m2(seen)) == pytest.approx(expected, abs=1.5)


def test_car_from_behind_returns_as_much_as_measured_cars() -> None:
    """5-20 dBsm at 76-81 GHz (literature, unverified), 10 m^2 in ISO 15622: mean over aspect, range and height.

    50 aspects of a spread of 0.56 of the mean: the mean is known to 8 %, 0.33 dB; the model's is 10.6 dBsm.
    """
    generator = torch.Generator().manual_seed(0)
    skin, power = car_facets(), []
    for share in torch.rand(50, 3, generator=generator).tolist():
        car = car_scatterers(
            (20 + 60 * share[0], 0.0),
            WAVELENGTH_M,
            yaw_rad=math.radians(10 * share[1] - 5),
            radar_height_m=0.3 + 0.5 * share[2],
            facets_m=skin,
        )
        power.append(coherent_rcs_m2(car))
    assert 10 * math.log10(sum(power) / len(power)) == pytest.approx(10.6, abs=0.8)
    typical = sorted(10 * math.log10(p) for p in power)
    # 80 % of the aspects, and the middle one.
    assert typical[5] > 2.0
    assert typical[25] > 5.0
    assert typical[-5] < 20.0


def test_car_seen_from_its_side_returns_more_than_from_a_corner() -> None:
    """Flanks are long and hardly curved; between them and the ends only the small corners answer."""

    def rcs_dbsm(yaw_deg: float) -> float:
        seen = car_scatterers((28.0, 0.0), WAVELENGTH_M, yaw_rad=math.radians(yaw_deg))
        return 10 * math.log10(coherent_rcs_m2(seen))

    assert rcs_dbsm(90.0) > 18.0
    assert rcs_dbsm(90.0) > rcs_dbsm(60.0) + 10.0


def test_car_stands_and_moves_as_told() -> None:
    car = car_scatterers((28.0, 1.0), WAVELENGTH_M, velocity_m_per_s=(-6.0, 0.0, 0.0), radar_height_m=0.6)
    assert 28.0 < float(car.position_m[:, 0].min()) < 28.05
    assert float(car.position_m[:, 2].min()) >= 0.2 - 0.6  # the skin's underside
    weight = car.field_m.abs() ** 2
    assert float((weight * car.position_m[:, 1]).sum() / weight.sum()) == pytest.approx(1.0, abs=0.5)
    assert torch.allclose(car.speed_m_per_s, -6.0 * car.position_m[:, 0] / car.range_m, rtol=1e-4)
    turned = car_scatterers((28.0, 0.0), WAVELENGTH_M, yaw_rad=math.pi)
    assert float(turned.position_m[:, 0].min()) == pytest.approx(28.0 - 4.3, abs=0.05)  # shows its front


def test_car_details_lie_on_the_car_and_come_in_mirrored_pairs() -> None:
    place, facing, edge_m = car_details()
    assert len(CAR_DETAILS) == len(place)
    assert torch.allclose(facing.norm(dim=-1), torch.ones(len(place), dtype=torch.float64))
    assert bool((edge_m > 7 * WAVELENGTH_M).all())  # optics of the aperture needs edges of several wavelengths
    assert bool((place >= tensor([0.0, -0.95, 0.1])).all())
    assert bool((place <= tensor([4.3, 0.95, 1.47])).all())
    left = {d.name[5:]: d for d in CAR_DETAILS if d.name.startswith("left")}
    for detail in CAR_DETAILS:
        if detail.name.startswith("right"):
            twin = left[detail.name[6:]]
            assert detail.place == (twin.place[0], -twin.place[1], twin.place[2])
            assert detail.azimuth_deg == -twin.azimuth_deg


def test_bad_input_is_named() -> None:
    around = tensor([[[1.0, 0.0, 0.0], [-1.0, 1.0, 0.0], [0.0, -1.0, 0.0]]])
    plate = tensor([[[9.0, -0.05, 0.0], [9.0, 0.0, 0.05], [9.0, 0.05, 0.0]]])
    with pytest.raises(ValueError, match=r"vertices_m must be \(F, 3, 3\)"):
        facet_scatterers(plate[0], STILL, STILL, WAVELENGTH_M)
    with pytest.raises(ValueError, match=r"radar_position_m must be \(3,\) = x, y, z in m"):
        facet_scatterers(plate, STILL[:2], STILL, WAVELENGTH_M)
    with pytest.raises(ValueError, match=r"velocity_m_per_s must be a finite number in m/s"):
        facet_scatterers(plate, STILL, STILL * math.nan, WAVELENGTH_M)
    with pytest.raises(ValueError, match="distance of the facets must be above 0 m"):
        facet_scatterers(around, STILL, STILL, WAVELENGTH_M)
    with pytest.raises(ValueError, match=r"position_m and facing must both be \(M, 3\)"):
        corner_scatterers(plate[0], STILL, tensor([0.1]), STILL, STILL, WAVELENGTH_M)
    with pytest.raises(ValueError, match="edge_m must be above 0 m"):
        corner_reflector_rcs_m2(-0.1, WAVELENGTH_M)
    with pytest.raises(ValueError, match="cell_m must be above 0 m"):
        gathered(Scatterers.from_rcs(plate[0], 0.0), WAVELENGTH_M, 0.0)
    with pytest.raises(ValueError, match="length_m must be above 0 m"):
        car_facets(0.0)
    with pytest.raises(ValueError, match="rear_m must be a finite number in m"):
        car_scatterers((math.nan, 0.0), WAVELENGTH_M)
