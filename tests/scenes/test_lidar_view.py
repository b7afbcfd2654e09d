"""Point clouds of the scenes against closed forms of geometry and link budget."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import pytest
import torch
from torch import Tensor

from torchweather.lidar.intensity import reflectivity_from_intensity
from torchweather.scenes import SCENES, LidarView, Scene, SceneLabel, fog_tunnel, lidar_view, test_track
from torchweather.scenes.lidar_view import ROOF_MOUNT_M
from torchweather.scenes.lighting import DiffuseLight
from torchweather.scenes.materials import MATERIALS, Material, board, laser_reflectivity
from torchweather.scenes.primitives import Plane
from torchweather.scenes.scene import Part, SceneObject
from torchweather.sensors import Lidar

LIDAR = Lidar(wavelength_nm=905.0)  # 50 m at 10 %
AHEAD = torch.tensor([[1.0, 0.0, 0.0]], dtype=torch.float64)
HEIGHT = ROOF_MOUNT_M[2]


def scan(rings: int = 64, columns: int = 512, elevation_deg: float = 22.5) -> Tensor:
    """A full turn, ``(rings, columns, 3)``."""
    elevation = torch.deg2rad(torch.linspace(elevation_deg, -elevation_deg, rings))
    azimuth = (torch.arange(columns) + 0.5) / columns * 2 * math.pi
    e, a = torch.meshgrid(elevation, azimuth, indexing="ij")
    return torch.stack([e.cos() * a.cos(), e.cos() * a.sin(), e.sin()], -1)


def wall(distance_m: float, material: Material | float) -> Scene:
    """A wall across the x axis."""
    surface = material if isinstance(material, Material) else board(material)
    part = Part(Plane((distance_m, 0.0, 0.0), (-1.0, 0.0, 0.0)), surface)
    return Scene("wall", (SceneObject("wall", SceneLabel.WALL, (part,)),), DiffuseLight())


def one_beam(scene: Scene, lidar: Lidar = LIDAR, direction: Tensor = AHEAD, **more: Any) -> list[float]:
    """x, y, z, intensity, ring of a single beam."""
    row: list[float] = lidar_view(scene, lidar, directions=direction, **more).points[0].tolist()
    return row


@pytest.fixture(scope="module")
def track() -> LidarView:
    return lidar_view(test_track(), LIDAR, directions=scan())


@pytest.fixture(scope="module")
def tunnel() -> LidarView:
    return lidar_view(fog_tunnel(), LIDAR, directions=scan())


def test_cloud_is_organised(track: LidarView) -> None:
    assert track.grid == (64, 512)
    assert track.points.shape == (64 * 512, 5)
    assert torch.equal(track.points[:, 4].reshape(64, 512)[:, 7], torch.arange(64.0))
    along = track.points[:, :3] - track.points[:, :3].norm(dim=-1, keepdim=True) * track.directions
    # float32 holds 120 m to 8 micrometres.
    assert along.abs().max() < 3e-5


def test_sky_gives_no_return(track: LidarView) -> None:
    sky = track.label == SceneLabel.SKY
    assert sky.any()
    assert not track.hit[sky].any()
    assert (track.points[~track.hit][:, :4] == 0).all()
    assert torch.equal(sky, track.object_id == -1)
    assert (track.cos_incidence[sky] == 0).all()


def test_ground_is_seen_in_rings_of_height_over_sine_of_elevation(track: LidarView) -> None:
    ground = track.hit & ((track.label == SceneLabel.ROAD) | (track.label == SceneLabel.GRASS))
    points, down = track.points[ground], -track.directions[ground][:, 2]
    assert ground.sum() > 5000
    torch.testing.assert_close(points[:, :3].norm(dim=-1), HEIGHT / down, rtol=1e-5, atol=0)
    torch.testing.assert_close(track.cos_incidence[ground], down, rtol=1e-5, atol=0)


def test_ground_ends_where_its_grazing_signal_meets_the_threshold() -> None:
    # rho cos i / R^2 = rho h / R^3 = 0.1 / R10^2 for ground seen from the height h.
    even = replace(MATERIALS["asphalt"], texture="plain", near_infrared=(0.2, 0.2))
    part = Part(Plane((0.0, 0.0, 0.0), (0.0, 0.0, 1.0)), even)
    ground = Scene("ground", (SceneObject("ground", SceneLabel.ROAD, (part,)),), DiffuseLight())
    end_m = (0.2 * HEIGHT / 0.1 * LIDAR.range_at_10_percent_m**2) ** (1 / 3)
    for share, seen in ((0.999, True), (1.001, False)):
        range_m = share * end_m
        ray = torch.tensor([[math.sqrt(range_m**2 - HEIGHT**2), 0.0, -HEIGHT]], dtype=torch.float64)
        assert bool(lidar_view(ground, LIDAR, directions=ray).hit) is seen


@pytest.mark.parametrize(("reflectivity", "range_m"), [(0.1, 50.0), (0.4, 100.0), (0.025, 25.0)])
def test_a_surface_ends_at_the_range_that_calibrates_the_link(reflectivity: float, range_m: float) -> None:
    assert one_beam(wall(0.999 * range_m, reflectivity))[0] == pytest.approx(0.999 * range_m)
    assert one_beam(wall(1.001 * range_m, reflectivity))[:4] == [0, 0, 0, 0]


@pytest.mark.parametrize("angle_deg", [0.0, 30.0, 60.0])
def test_intensity_falls_with_the_cosine_of_the_incidence(angle_deg: float) -> None:
    angle = math.radians(angle_deg)
    slanted = torch.tensor([[math.cos(angle), math.sin(angle), 0.0]], dtype=torch.float64)
    view = lidar_view(wall(10.0, 0.5), LIDAR, directions=slanted)
    assert float(view.points[0, 3]) == pytest.approx(0.5 * math.cos(angle))
    assert float(view.cos_incidence) == pytest.approx(math.cos(angle))
    assert float(view.points[0, :3].norm()) == pytest.approx(10.0 / math.cos(angle))


@pytest.mark.parametrize(
    ("unit", "expected"),
    [
        ("reflectivity", 0.2),
        ("reflectivity_percent", 20.0),
        ("uint8_linear", 51.0),
        ("uint8_calibrated", 20.0),
        ("none", 1.0),
        # 10 photons at the threshold, twice the reflectivity, half the range: 80; half way up the near-range ramp: 40.
        ("photons", 40.0),
    ],
)
@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_intensity_comes_in_the_sensors_unit(unit: str, expected: float, dtype: torch.dtype) -> None:
    lidar = Lidar(
        wavelength_nm=905.0,
        intensity_unit=unit,
        photons_at_threshold=10.0,
        near_start_m=20.0,
        near_full_m=30.0,
        range_at_10_percent_m=50.0,
    )
    assert one_beam(wall(25.0, 0.2), lidar, AHEAD.to(dtype))[3] == pytest.approx(expected)


def test_whole_numbers_are_not_lost_to_rounding_and_fractions_are_cut_off() -> None:
    lidar = replace(LIDAR, intensity_unit="uint8_calibrated")
    # 0.29 x 100 is 28.999999999999996 in floating point.
    assert [one_beam(wall(10.0, value), lidar)[3] for value in (0.29, 0.299)] == [29.0, 29.0]


@pytest.mark.parametrize("unit", ["reflectivity", "reflectivity_percent", "uint8_linear", "uint8_calibrated"])
@pytest.mark.parametrize("reflectivity", [0.3, 0.9, 3.0, 40.0])
def test_weather_reads_back_the_reflectivity_that_the_view_wrote(unit: str, reflectivity: float) -> None:
    sheet = Material(rgb=(0.0, 0.0, 0.0), retroreflectivity=reflectivity)
    written = lidar_view(wall(20.0, sheet), replace(LIDAR, intensity_unit=unit), directions=AHEAD).points[:, 3]
    read = float(reflectivity_from_intensity(written, unit, 0.1))
    if unit == "uint8_linear":
        assert min(reflectivity, 1.0) - 1 / 255 <= read <= min(reflectivity, 1.0) + 1e-6
    else:
        # One step of 155 for a factor of 100, rounded down: 3 % at most; one of 100 below white: 1/30 at 0.3.
        assert read == pytest.approx(reflectivity, rel=0.034 if unit == "uint8_calibrated" else 1e-6)
        assert read <= reflectivity * (1 + 1e-6)


def test_photons_of_a_ten_percent_target_at_its_range_are_those_of_the_threshold() -> None:
    lidar = replace(LIDAR, intensity_unit="photons", photons_at_threshold=7.0)
    assert one_beam(wall(49.9999, 0.1), lidar)[3] == pytest.approx(7.0, rel=1e-4)


def test_near_range_response_opens_no_dark_ring() -> None:
    # A response that rises late and slowly: surfaces are returned from contact on.
    lidar = replace(LIDAR, near_start_m=2.0, near_full_m=10.0, near_power=2.0)
    for distance_m in (0.05, 0.5, 1.99, 2.01, 2.2, 3.0, 9.0):
        assert one_beam(wall(distance_m, 0.02), lidar)[0] == pytest.approx(distance_m)


@pytest.mark.parametrize(("distance_m", "seen"), [(0.9, False), (1.1, True), (29.0, True), (31.0, False)])
def test_range_limits_of_the_sensor_hold(distance_m: float, seen: bool) -> None:
    lidar = replace(LIDAR, min_range_m=1.0, max_range_m=30.0)
    view = lidar_view(wall(distance_m, 0.5), lidar, directions=AHEAD)
    assert bool(view.hit) is seen
    assert int(view.label) == SceneLabel.WALL


def test_range_noise_belongs_to_its_seed_and_has_the_sensors_size() -> None:
    lidar = replace(LIDAR, range_noise_m=0.03)
    beams = AHEAD.expand(20_000, 3)
    clean = lidar_view(wall(20.0, 0.5), lidar, directions=beams)
    assert torch.equal(clean.points[:, 0], torch.full((20_000,), 20.0, dtype=torch.float64))
    noisy, again, other = (
        lidar_view(wall(20.0, 0.5), lidar, directions=beams, range_noise_seed=seed).points for seed in (1, 1, 2)
    )
    assert torch.equal(noisy, again)
    assert not torch.equal(noisy, other)
    error = noisy[:, 0] - 20.0
    # 20 000 draws: the mean is known to 0.03 / sqrt(n), the standard deviation to 1 / sqrt(2 n) = 0.5 %; four of each.
    assert abs(float(error.mean())) < 4 * 0.03 / math.sqrt(20_000)
    assert float(error.std()) == pytest.approx(0.03, rel=0.02)
    # The surface's own signal does not move with the range that is read.
    assert torch.equal(noisy[:, 3], clean.points[:, 3])


def test_ranges_are_multiples_of_the_sensors_resolution() -> None:
    lidar = replace(LIDAR, range_resolution_m=0.004)
    assert one_beam(wall(20.0017, 0.5), lidar)[0] == pytest.approx(20.0, abs=1e-9)
    assert one_beam(wall(20.0021, 0.5), lidar)[0] == pytest.approx(20.004, abs=1e-9)


@pytest.mark.parametrize(("name", "face_m", "gap_m"), [("car 28 m", 28.0, 1e-4), ("car 56 m", 56.0, 0.12)])
def test_cars_stand_at_their_distance(name: str, face_m: float, gap_m: float) -> None:
    scene = test_track()
    # A fine window of the sky's sphere around both cars; at 10 % seen to 200 m.
    y, z = torch.meshgrid(torch.linspace(-0.05, 0.09, 120), torch.linspace(-0.065, 0.0, 60), indexing="ij")
    window = torch.stack([torch.ones_like(y), y, z], -1)
    view = lidar_view(scene, replace(LIDAR, range_at_10_percent_m=200.0), directions=window)
    on_car = view.hit & (view.object_id == scene.object_id(name))
    x = view.points[on_car, 0]
    assert on_car.sum() > 100
    # The oncoming car's bumper slants by 10 cm over its height.
    assert face_m - 1e-4 <= float(x.min()) <= face_m + gap_m


@pytest.mark.parametrize("name", SCENES)
def test_returns_of_road_users_lie_in_their_boxes(name: str, track: LidarView, tunnel: LidarView) -> None:
    made = {"test-track": track, "fog-tunnel": tunnel}
    view = made[name] if name in made else lidar_view(SCENES[name](), LIDAR, directions=scan())
    assert len(view.boxes) == {"test-track": 4, "fog-tunnel": 2}.get(name, 1)
    for box, k in zip(view.boxes, view.box_object_id, strict=True):
        points = view.points[view.hit & (view.object_id == k), :3] - box[:3]
        assert len(points) > 0
        cos, sin = box[6].cos(), box[6].sin()
        own = torch.stack([cos * points[:, 0] + sin * points[:, 1], cos * points[:, 1] - sin * points[:, 0]], -1)
        own = torch.cat([own, points[:, 2:]], -1)
        # float32 at 60 m: 4 micrometres, a few times over.
        assert (own.abs() <= box[3:6] / 2 + 2e-4).all()


def test_boards_show_their_reflectance() -> None:
    scene = test_track()
    lidar = replace(LIDAR, range_at_10_percent_m=100.0)
    for k, percent in enumerate((5, 10, 50, 80, 90)):
        aim = torch.tensor([[21.0, -6.3 - 1.25 * k, 1.0 - HEIGHT]])
        view = lidar_view(scene, lidar, directions=aim)
        assert scene.objects[int(view.object_id)].name == f"board {percent} %"
        cosine = 21.0 / float(aim.norm())
        assert float(view.points[0, 3]) == pytest.approx(percent / 100 * cosine, rel=1e-5)


def test_window_glass_gives_no_return_where_the_paint_around_it_does() -> None:
    scene = test_track()
    # Rear window and tail gate of the car at 28 m.
    aims = torch.tensor([[28.2, -0.15, 1.15 - HEIGHT], [28.0, 0.6, 0.65 - HEIGHT]])
    view = lidar_view(scene, LIDAR, directions=aims)
    assert (view.object_id == scene.object_id("car 28 m")).all()
    assert view.hit.tolist() == [False, True]


def test_number_plate_is_brighter_than_white_and_clips_in_eight_bits() -> None:
    aim = torch.tensor([[28.0, -0.15, 0.56 - HEIGHT]])
    reflectivity = one_beam(test_track(), LIDAR, aim)[3]
    plate = MATERIALS["number_plate"]
    assert reflectivity == pytest.approx(plate.retroreflectivity + 0.70, rel=1e-2)
    for unit in ("uint8_linear", "uint8_calibrated"):
        assert one_beam(test_track(), replace(LIDAR, intensity_unit=unit), aim)[3] == 255.0


def test_retroreflection_does_not_follow_the_cosine() -> None:
    sheet = Material(rgb=(0.5, 0.5, 0.5), near_infrared=(0.0, 0.0), retroreflectivity=40.0)
    slanted = torch.tensor([[1.0, 1.0, 0.0]], dtype=torch.float64)
    assert one_beam(wall(10.0, sheet), LIDAR, slanted)[3] == pytest.approx(40.0)


def test_plants_and_skin_are_dark_at_1550_nm() -> None:
    for name in ("grass", "foliage", "skin"):
        short, long = (laser_reflectivity(MATERIALS[name], nm) for nm in (905.0, 1550.0))
        assert long < 0.6 * short
    grass = replace(MATERIALS["grass"], texture="plain")
    seen = one_beam(wall(10.0, grass), replace(LIDAR, wavelength_nm=1550.0))[3]
    assert seen == pytest.approx(laser_reflectivity(MATERIALS["grass"], 1550.0))


def test_laser_reflectivity_is_interpolated_between_its_wavelengths_and_held_outside() -> None:
    surface = Material(rgb=(0.1, 0.2, 0.3), near_infrared=(0.4, 0.2))
    assert [laser_reflectivity(surface, nm) for nm in (865.0, 1225.0, 1600.0)] == pytest.approx([0.4, 0.3, 0.2])
    # Without a near-infrared pair of its own: as bright as to the eye.
    assert laser_reflectivity(Material(rgb=(0.1, 0.2, 0.3)), 905.0) == pytest.approx(0.2)


def test_every_material_of_the_scenes_has_a_near_infrared_reflectance() -> None:
    assert all(material.near_infrared is not None for material in MATERIALS.values())


def test_the_laser_sees_neither_daylight_nor_a_glowing_roof(tunnel: LidarView) -> None:
    roof = tunnel.hit & (tunnel.label == SceneLabel.ROOF)
    brightest = laser_reflectivity(MATERIALS["membrane_roof"], 905.0)
    assert float(tunnel.points[roof, 3].max()) <= brightest + 1e-6


def test_turned_and_moved_sensor_sees_the_same_world() -> None:
    scene = test_track()
    angle = 0.7
    cos, sin = math.cos(angle), math.sin(angle)
    pose = torch.tensor([[cos, -sin, 0, 2.0], [sin, cos, 0, -0.5], [0, 0, 1, 1.9], [0, 0, 0, 1]], dtype=torch.float64)
    upright = torch.eye(4, dtype=torch.float64)
    upright[:3, 3] = pose[:3, 3]
    beams = scan(16, 128).reshape(-1, 3).double()
    straight = lidar_view(scene, LIDAR, directions=beams, T_vehicle_from_lidar=upright)
    turned = lidar_view(scene, LIDAR, directions=beams @ pose[:3, :3], T_vehicle_from_lidar=pose)
    torch.testing.assert_close(turned.points[:, :3] @ pose[:3, :3].T, straight.points[:, :3])
    # Ground lies on the border of two cells of its grain, so rounding may pick either: 1 point in 50.
    same = torch.isclose(turned.points[:, 3], straight.points[:, 3])
    assert same.double().mean() > 0.98
    assert torch.equal(turned.label, straight.label)


def test_order_of_the_beams_does_not_matter(track: LidarView) -> None:
    shuffle = torch.randperm(64 * 512, generator=torch.Generator().manual_seed(1))
    mixed = lidar_view(test_track(), LIDAR, directions=scan().reshape(-1, 3)[shuffle])
    assert mixed.grid is None
    assert (mixed.points[:, 4] == -1).all()
    # Rounding of a matrix product depends on its block: 1 beam in 1000 may pass an edge on the other side.
    same = torch.isclose(mixed.points[:, :4], track.points[shuffle, :4], rtol=1e-4, atol=1e-5).all(-1)
    assert same.float().mean() > 0.999


def test_sensors_own_directions_and_pattern_are_used() -> None:
    lidar = replace(LIDAR, directions=torch.tensor([[1.0, 0.0, -0.05], [1.0, 0.1, -0.05]]))
    assert lidar_view(test_track(), lidar).points.shape == (2, 5)
    lidar = Lidar(wavelength_nm=905.0, elevations_deg=(-5.0, -10.0), columns=36)
    view = lidar_view(test_track(), lidar)
    assert view.grid == (2, 36)
    elevation = torch.rad2deg(torch.asin(view.directions[:, 2])).reshape(2, 36)
    torch.testing.assert_close(elevation, torch.tensor([[-5.0], [-10.0]]).expand(2, 36), rtol=1e-5, atol=0)
    assert torch.equal(view.points[:, 4], torch.arange(2.0).repeat_interleave(36))


def test_no_beams_give_no_points() -> None:
    assert lidar_view(test_track(), LIDAR, directions=torch.zeros(0, 3)).points.shape == (0, 5)


@pytest.mark.parametrize(
    "pose",
    [
        torch.eye(3),
        torch.diag(torch.tensor([2.0, 1.0, 1.0, 1.0])),
        torch.diag(torch.tensor([1.0, -1.0, 1.0, 1.0])),
        torch.full((4, 4), math.nan),
    ],
    ids=["3 x 3", "stretched", "mirrored", "not a number"],
)
def test_what_is_no_pose_is_refused(pose: Tensor) -> None:
    with pytest.raises(ValueError, match=r"T_vehicle_from_lidar must be a finite \(4, 4\) matrix of a rotation"):
        lidar_view(test_track(), LIDAR, directions=AHEAD, T_vehicle_from_lidar=pose)


def test_wrong_directions_are_refused() -> None:
    with pytest.raises(ValueError, match=r"\(N, 3\) or \(rings, columns, 3\)"):
        lidar_view(test_track(), LIDAR, directions=torch.ones(2, 2, 2, 3))
    with pytest.raises(ValueError, match="directions must be"):
        lidar_view(test_track(), LIDAR, directions=torch.ones(4, 2))


@pytest.mark.gpu
@pytest.mark.skipif(not torch.cuda.is_available(), reason="no CUDA device")
def test_cuda_sees_what_the_processor_sees(track: LidarView) -> None:
    view = lidar_view(test_track(), LIDAR, directions=scan().cuda())
    same = torch.isclose(view.points.cpu()[:, :4], track.points[:, :4], rtol=1e-4, atol=1e-5).all(-1)
    assert same.float().mean() > 0.998


@pytest.mark.parametrize(("column", "width"), [(4, 5), (5, 6), (7, 8)])
def test_a_sensor_of_speeds_sees_a_scene_at_rest(column: int, width: int) -> None:
    directions = torch.tensor([[1.0, 0.0, -0.04], [1.0, 0.0, 0.5]])
    plain = lidar_view(test_track(), LIDAR, directions=directions).points
    points = lidar_view(test_track(), replace(LIDAR, speed_column=column), directions=directions).points
    assert points.shape == (2, width)
    assert torch.equal(points[:, :4], plain[:, :4])
    assert not points[:, column].any()
