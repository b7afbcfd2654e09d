"""Views of the scenes against what geometry and light say they must be."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest
import torch

from torchweather.camera.bayer import mosaic
from torchweather.scenes import SCENES, Scene, SceneLabel, SceneView, fog_tunnel, test_track
from torchweather.scenes.scene import Part, SceneObject
from torchweather.sensors import Camera

FULL = Camera.preset("lucid-triton")
CAMERA = FULL.resized(242, 184)
# Windows of the full frame that hold what a test looks at: small, so the tests are quick.
CARS = FULL.cropped(700, 860, 110, 170)
TRACK_BOARDS = FULL.cropped(726, 1270, 80, 340)
TRACK_CHECKER = FULL.cropped(726, 396, 90, 90)
TUNNEL_BOARD = FULL.cropped(730, 1140, 130, 130)


@pytest.fixture(scope="module")
def track_view() -> SceneView:
    return test_track().view(CAMERA)


@pytest.fixture(scope="module")
def tunnel_view() -> SceneView:
    return fog_tunnel().view(CAMERA)


def test_shapes_and_dtypes(track_view: SceneView) -> None:
    size = (CAMERA.height, CAMERA.width)
    assert track_view.bayer.shape == track_view.depth_m.shape == track_view.label.shape == (1, *size)
    assert track_view.rgb.shape == track_view.normal.shape == (3, *size)
    assert track_view.bayer.dtype == track_view.depth_m.dtype == torch.float32
    assert track_view.label.dtype == torch.int64


@pytest.mark.parametrize("name", SCENES)
def test_light_stays_between_black_and_saturation(name: str, track_view: SceneView, tunnel_view: SceneView) -> None:
    made = {"test-track": track_view, "fog-tunnel": tunnel_view}
    view = made[name] if name in made else SCENES[name]().view(CAMERA)
    assert view.bayer.min() >= 0
    # Exposed so that nothing clips; and a frame that uses the sensor's range.
    assert 0.5 < view.bayer.max() < 0.8
    assert torch.equal(view.bayer, mosaic(view.rgb, CAMERA.bayer_pattern))


def test_sky_is_infinitely_far_and_has_no_normal(track_view: SceneView) -> None:
    sky = track_view.label == SceneLabel.SKY
    assert torch.equal(sky, torch.isinf(track_view.depth_m))
    assert torch.equal(sky, track_view.object_id == -1)
    assert (track_view.normal[:, sky[0]] == 0).all()
    # The top row sees sky or crowns, the bottom row none.
    assert sky[0, 0].any()
    assert not sky[0, -1].any()


def test_normals_have_unit_length_and_face_the_camera(track_view: SceneView) -> None:
    hit = torch.isfinite(track_view.depth_m[0])
    normal = track_view.normal[:, hit]
    torch.testing.assert_close(normal.norm(dim=0), torch.ones(normal.shape[1]), rtol=1e-5, atol=0)
    to_camera = torch.tensor(CAMERA.camera_from_vehicle()).T
    rays = (to_camera @ CAMERA.ray_directions().flatten(1)).reshape(3, *hit.shape)[:, hit]
    assert ((normal * rays).sum(0) <= 1e-6).all()


@pytest.mark.parametrize("pitch_deg", [0.0, -6.0, 4.0])
def test_depth_of_the_road_is_the_closed_form_of_flat_ground(pitch_deg: float) -> None:
    camera = replace(
        CAMERA.resized(120, 92), pitch_rad=math.radians(pitch_deg), roll_rad=0.1, k1=-0.2, k2=0.03, height_m=1.7
    )
    view = test_track().view(camera, supersample=1, dtype=torch.float64)
    flat = torch.isin(view.label[0], torch.tensor([int(SceneLabel.ROAD), int(SceneLabel.LANE_MARKING)]))
    # Height under the camera over the ray's fall for one metre along the axis.
    down = torch.tensor(camera.down_direction(), dtype=torch.float64)
    fall = (camera.ray_directions(dtype=torch.float64) * down[:, None, None]).sum(0)
    assert flat.sum() > 500
    torch.testing.assert_close(view.depth_m[0][flat], (1.7 / fall)[flat], rtol=1e-9, atol=0)


@pytest.mark.parametrize(("name", "depth_m"), [("car 28 m", 28.0), ("car 56 m", 56.0)])
def test_nearest_face_of_each_car_stands_at_its_named_distance(name: str, depth_m: float) -> None:
    scene = test_track()
    view = scene.view(CARS, supersample=1)
    seen = view.depth_m[view.object_id == scene.object_id(name)]
    # float32 holds 56 m to 4 micrometres; the oncoming car's bumper slants by 10 cm over its height.
    assert float(seen.min()) == pytest.approx(depth_m, abs=0.02 if name == "car 56 m" else 1e-4)
    assert float(seen.max()) < depth_m + 4.4


@pytest.mark.parametrize(
    ("name", "board", "camera", "depth_m"),
    [
        ("test-track", "board 50 %", TRACK_BOARDS, 21.0),
        ("test-track", "board checker", TRACK_CHECKER, 15.0),
        ("fog-tunnel", "board 90 %", TUNNEL_BOARD, 8.0),
    ],
)
def test_board_faces_are_flat_at_their_distance(name: str, board: str, camera: Camera, depth_m: float) -> None:
    scene = SCENES[name]()
    view = scene.view(camera, supersample=1)
    face = (view.object_id == scene.object_id(board))[0] & (view.normal[0] < -0.999)
    depth, counts = view.depth_m[0][face].unique(return_counts=True)
    # float32 holds 21 m to 2 micrometres.
    assert float(depth[counts.argmax()]) == pytest.approx(depth_m, abs=1e-5)


def test_boards_of_known_reflectance_keep_their_ratio_in_the_picture() -> None:
    scene = test_track()
    view = scene.view(TRACK_BOARDS, supersample=1)
    level = {}
    for percent in (10, 50, 90):
        face = (view.object_id == scene.object_id(f"board {percent} %"))[0] & (view.normal[0] < -0.999)
        # The board's own pixels outnumber those of its stand.
        level[percent] = float(view.rgb[1][face].median())
    assert level[50] / level[10] == pytest.approx(5, rel=1e-4)
    assert level[90] / level[50] == pytest.approx(1.8, rel=1e-4)


def test_cropped_camera_sees_the_crop_of_the_view(track_view: SceneView) -> None:
    crop = test_track().view(CAMERA.cropped(60, 80, 70, 90))
    rows, columns = slice(60, 130), slice(80, 170)
    depth, whole = crop.depth_m[0], track_view.depth_m[0, rows, columns]
    # Rounding of the ray may move a leaf's edge or a texture's cell: 1 pixel in 1000.
    same = torch.isclose(depth, whole, rtol=1e-4)
    assert same.float().mean() > 0.999
    close = torch.isclose(crop.rgb, track_view.rgb[:, rows, columns], atol=1e-3).all(0)
    assert close.float().mean() > 0.995
    assert (crop.label[0] == track_view.label[0, rows, columns]).float().mean() > 0.999


def test_resized_camera_sees_the_same_depth(track_view: SceneView) -> None:
    # Three times the pixels: the centre of every middle one is the centre of an old one. A window of it is enough.
    top, left, height, width = 60, 60, 50, 100
    fine_camera = CAMERA.resized(3 * CAMERA.width, 3 * CAMERA.height).cropped(3 * top, 3 * left, 3 * height, 3 * width)
    fine = test_track().view(fine_camera, supersample=1)
    coarse = track_view.depth_m[0, top : top + height, left : left + width]
    same = torch.isclose(fine.depth_m[0, 1::3, 1::3], coarse, rtol=1e-4)
    assert same.float().mean() > 0.998


@pytest.mark.parametrize("name", SCENES)
def test_every_object_kind_is_labelled_in_the_view(name: str) -> None:
    scene = SCENES[name]()
    view = scene.view(CAMERA, supersample=1)
    expected = {int(thing.label) for thing in scene.objects} | ({0} if name == "test-track" else set())
    assert set(view.label.unique().tolist()) == expected
    by_object = torch.tensor([*(int(thing.label) for thing in scene.objects), 0])
    assert torch.equal(view.label, by_object[view.object_id])


def test_tunnel_is_closed_in_every_direction() -> None:
    generator = torch.Generator().manual_seed(3)
    direction = torch.randn(20_000, 3, generator=generator)
    hit = fog_tunnel().cast((0.0, 0.0, 1.5), direction)
    assert torch.isfinite(hit.range_m).all()
    assert hit.range_m.max() < 31.0


def test_cast_gives_range_along_the_ray_whatever_the_length_of_the_direction() -> None:
    scene = test_track()
    direction = torch.tensor([[[1.0, 0.1, -0.2]], [[0.2, -0.1, -1.0]]])
    once, scaled = (scene.cast((0.0, 0.0, 1.5), factor * direction) for factor in (1.0, 7.0))
    assert once.range_m.shape == (2, 1)
    torch.testing.assert_close(once.range_m, scaled.range_m)
    torch.testing.assert_close(once.range_m, 1.5 / (-direction[..., 2] / direction.norm(dim=-1)))
    assert once.reflectance.shape == (2, 1, 3)


def test_culling_loses_no_hit() -> None:
    # One ray at a time has the tightest cone, scattered rays have none: both must find the same.
    scene = test_track()
    generator = torch.Generator().manual_seed(4)
    direction = torch.randn(150, 3, generator=generator) * torch.tensor([0.2, 0.5, 0.25]) + torch.tensor(
        [1.0, 0.0, 0.0]
    )
    together = scene.cast((0.0, 0.0, 1.5), direction)
    alone = torch.stack([scene.cast((0.0, 0.0, 1.5), ray).t for ray in direction])
    torch.testing.assert_close(together.t, alone)


def test_empty_cast_is_empty() -> None:
    assert test_track().cast((0.0, 0.0, 1.5), torch.zeros(0, 3)).t.shape == (0,)


def test_ground_under_a_car_is_darker_than_the_open_road() -> None:
    scene = test_track()
    # From close above the road, so that the car's body does not hide its own shade.
    origin = torch.tensor([26.0, -0.15, 0.05])
    rays = torch.stack([torch.tensor([30.0, -0.15, 0.0]) - origin, torch.tensor([20.0, -0.15, 0.0]) - origin])
    hit = scene.cast(origin, rays, pixel_angle_rad=1.0)
    assert (hit.label == SceneLabel.ROAD).all()
    under, open_road = scene.radiance(hit, rays).mean(-1)
    assert under < 0.2 * open_road


def test_noise_belongs_to_its_seed_and_has_the_sensors_size(track_view: SceneView) -> None:
    scene = test_track()
    noisy = scene.view(CAMERA, shot_noise_seed=5)
    small = CAMERA.resized(16, 12)
    again, other = (scene.view(small, shot_noise_seed=seed).bayer for seed in (5, 6))
    assert torch.equal(again, scene.view(small, shot_noise_seed=5).bayer)
    assert not torch.equal(again, other)
    difference = noisy.bayer - track_view.bayer
    expected = (track_view.bayer / 10_000 + (4 / 10_000) ** 2).sqrt()
    # 44528 pixels: the standard deviation is known to 1 / sqrt(2 n) = 0.34 %; three of it.
    assert float((difference / expected).std()) == pytest.approx(1, abs=0.0101)


@pytest.mark.parametrize("pattern", ["BGGR", "RCCB"])
def test_other_colour_filters_see_the_same_scene(pattern: str) -> None:
    small = CAMERA.resized(24, 18)
    view = test_track().view(replace(small, bayer_pattern=pattern))
    assert torch.equal(view.rgb, test_track().view(small).rgb)
    assert torch.equal(view.bayer, mosaic(view.rgb, pattern))


def test_threads_of_torch_are_given_back() -> None:
    before = torch.get_num_threads()
    test_track().view(CAMERA.resized(16, 12))
    assert torch.get_num_threads() == before


def test_two_objects_of_one_name_are_refused() -> None:
    thing = SceneObject("twin", SceneLabel.BOARD, ())
    with pytest.raises(ValueError, match="twin more than once"):
        Scene("bad", (thing, thing))


def test_unknown_names_and_wrong_rays_are_refused() -> None:
    with pytest.raises(ValueError, match="no object 'lorry'"):
        test_track().find("lorry")
    with pytest.raises(ValueError, match=r"shape \(\.\.\., 3\)"):
        test_track().cast((0.0, 0.0, 1.5), torch.zeros(4, 2))
    with pytest.raises(ValueError, match="supersample"):
        test_track().view(CAMERA, supersample=0)


@pytest.mark.gpu
@pytest.mark.skipif(not torch.cuda.is_available(), reason="no CUDA device")
def test_cuda_sees_what_the_processor_sees(track_view: SceneView) -> None:
    view = test_track().view(CAMERA, device="cuda")
    same = torch.isclose(view.depth_m.cpu(), track_view.depth_m, rtol=1e-4)
    assert same.float().mean() > 0.998


def test_parts_name_known_materials() -> None:
    for build in SCENES.values():
        parts: list[Part] = [part for thing in build().objects for part in thing.parts]
        assert all(part.surface.rgb for part in parts)
