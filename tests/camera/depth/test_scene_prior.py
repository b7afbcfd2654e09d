"""Guessed depth: closed form on ray-cast streets, boxes, sky, own vehicle, and no edge where fog would show one."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest
import torch
from torch import Tensor

from tests.camera.depth.street_corridor import corridor
from torchweather.camera.depth.object_boxes import paint_boxes
from torchweather.camera.depth.scene_prior import ScenePrior
from torchweather.camera.depth.source import scene_of
from torchweather.camera.depth.street_walls import ground_probability, sky_shares, street_depth, view_of_street
from torchweather.sensors import Camera

CAMERA = Camera.from_intrinsics(fx=480.0, fy=480.0, cx=319.5, cy=119.5, width=640, height=240, height_m=1.6)
SIZE = (240, 640)
NO_SKY = torch.zeros(1, *SIZE)


def ratio(depth: Tensor, true: Tensor) -> Tensor:
    """The larger over the smaller, where the truth is a surface within 25 m."""
    there = torch.isfinite(true) & (true < 25.0)
    return torch.maximum(depth / true, true / depth)[there]


@pytest.mark.parametrize(
    ("pitch", "heading", "roll", "lens"),
    [
        (0.0, 0.0, 0.0, {}),
        (0.02, 0.06, 0.0, {}),
        (-0.015, -0.05, 0.06, {}),
        (0.012, 0.04, -0.04, {"k1": -0.25, "k2": 0.02, "k3": -0.05}),
    ],
)
def test_a_street_of_known_width_has_its_depth(
    pitch: float, heading: float, roll: float, lens: dict[str, float]
) -> None:
    camera = replace(CAMERA, pitch_rad=pitch, roll_rad=roll, **lens)
    _, true, _ = corridor(camera, half_width_m=(4.0, 8.0), heading_rad=heading, wall_height_m=30.0)
    view = view_of_street(camera, *SIZE, pitch, heading, None)
    off = ratio(street_depth(view, 1.6, (4.0, 8.0), 200.0)[None], true)
    # Where ground meets wall the fourth powers add up: a factor 2^(1/4) = 1.19 too near at most. The street's axis is
    # rounded over a tangent of 0.04: a wall 4 m aside, 25 m ahead, is sqrt(1 + (0.04 x 25 / 4)^2) = 1.03 times nearer.
    assert float(off.max()) < 1.19 * 1.03
    assert float(off.median()) < 1.03


@pytest.mark.parametrize("heading", [0.0, 0.05])
def test_picture_alone_gives_the_street_of_a_camera_that_looks_up(heading: float) -> None:
    camera = replace(CAMERA, pitch_rad=0.012)
    picture, true, sky = corridor(camera, half_width_m=(4.0, 8.0), heading_rad=heading)
    scene = ScenePrior(street_half_width_m=(4.0, 8.0), farthest_m=200.0, sky=sky).scene(CAMERA, *SIZE, image=picture)
    off = ratio(scene.depth_m, true)
    assert float(off.median()) < 1.2
    assert float((off < 1.25).double().mean()) > 0.7
    assert scene.confidence == "guessed"
    assert scene.horizon_row == pytest.approx(119.5 + 480.0 * math.tan(0.012), abs=3.0)


def test_ground_near_the_camera_lies_at_its_height() -> None:
    depth = ScenePrior(street_half_width_m=20.0, near_mask=None)(CAMERA, *SIZE)
    assert float(depth[0, 239, 320]) == pytest.approx(1.6 * 480.0 / 119.5, rel=1e-3)
    higher = ScenePrior(street_half_width_m=20.0, camera_height_m=3.2, near_mask=None)(CAMERA, *SIZE)
    assert float(higher[0, 239, 320] / depth[0, 239, 320]) == pytest.approx(2.0, rel=1e-3)


def test_fog_shows_no_ruled_line_at_the_horizon() -> None:
    depth = ScenePrior(street_half_width_m=(5.0, 9.0), sky=NO_SKY)(CAMERA, *SIZE)[0]
    for visibility_m in (1000.0, 200.0, 50.0):
        transmission = torch.exp(-3.0 / visibility_m * depth)
        for dim in (0, 1):
            # A kink is a leap of the slope from one pixel to the next: half a level of 255 at most.
            assert float(transmission.diff(dim=dim).diff(dim=dim).abs().max()) < 0.5 / 255.0
    # The plain minimum of ground and far end, which it must beat, has one.
    fall = (torch.arange(240.0) - 119.5).clamp_min(0.0) / 480.0 / 1.6
    plain = torch.exp(-3.0 / 50.0 * torch.minimum(1.0 / fall, torch.tensor(40.0)))
    assert float(plain.diff().diff().abs().max()) > 0.5 / 255.0


def test_more_sky_on_a_side_sets_its_wall_back() -> None:
    picture, _, _ = corridor(CAMERA)
    sky = torch.zeros(1, *SIZE)
    sky[0, :60, 320:] = 1.0
    closed = ScenePrior(sky=NO_SKY, horizon="camera").scene(CAMERA, *SIZE, image=picture)
    open_right = ScenePrior(sky=sky, horizon="camera").scene(CAMERA, *SIZE, image=picture)
    assert float(open_right.depth_m[0, 119, 600]) > 1.2 * float(closed.depth_m[0, 119, 600])
    assert float(open_right.depth_m[0, 119, 40]) == pytest.approx(float(closed.depth_m[0, 119, 40]), rel=0.02)


def test_shares_of_sky_are_counted_above_the_horizon_only() -> None:
    view = view_of_street(CAMERA, *SIZE, 0.0, 0.0, None)
    sky = torch.zeros(SIZE)
    sky[:60, 320:] = 1.0
    left, right, total = sky_shares(view, sky)
    assert (left, right, total) == pytest.approx((0.0, 0.5, 0.25), abs=1e-6)


def test_a_lower_skyline_is_farther() -> None:
    view = view_of_street(CAMERA, *SIZE, 0.0, 0.0, None)

    def beside(rows: int) -> float:
        sky = torch.zeros(SIZE)
        sky[:rows] = 1.0
        return float(street_depth(view, 1.6, (6.0, 6.0), 100.0, sky, (0.5, 0.5, 0.5))[119, 560])

    # Half the sky: a weight of 1.2 x 0.5 for the skyline, which lies 119.5, 79.5 and 19.5 rows above the horizon.
    assert beside(40) / beside(0) == pytest.approx((119.5 / 79.5) ** 0.6, rel=0.02)
    assert beside(100) / beside(40) == pytest.approx((79.5 / 19.5) ** 0.6, rel=0.1)


def test_sky_alone_is_infinite_and_a_mixed_pixel_has_its_surface() -> None:
    picture, _, _ = corridor(CAMERA)
    sky = torch.zeros(1, *SIZE)
    sky[0, :20] = 1.0
    sky[0, 20] = 0.4
    scene = ScenePrior(sky=sky).scene(CAMERA, *SIZE, image=picture)
    assert torch.isinf(scene.depth_m[0, :20]).all()
    assert torch.isfinite(scene.depth_m[0, 20:]).all()
    assert scene.sky is not None
    torch.testing.assert_close(scene.sky, sky)
    by_function = ScenePrior(sky=lambda rgb: sky if rgb.shape[0] == 3 else NO_SKY).scene(CAMERA, *SIZE, image=picture)
    assert torch.equal(by_function.depth_m, scene.depth_m)


def test_a_box_takes_its_depth_from_its_lower_edge() -> None:
    boxes = torch.tensor([[200.0, 100.0, 260.0, 167.5], [240.0, 90.0, 330.0, 215.5], [400.0, 20.0, 420.0, 60.0]])
    scene = ScenePrior(boxes=boxes, sky=NO_SKY).scene(CAMERA, *SIZE)
    # 48 and 96 rows below the horizon.
    assert float(scene.depth_m[0, 134, 222]) == pytest.approx(1.6 * 480.0 / 48.0, rel=1e-4)
    assert float(scene.depth_m[0, 150, 285]) == pytest.approx(1.6 * 480.0 / 96.0, rel=1e-4)
    # The nearer one covers where they overlap; the third hangs above the horizon and counts for nothing.
    assert float(scene.depth_m[0, 152, 256]) < 10.0
    without = ScenePrior(boxes=boxes[:2], sky=NO_SKY)(CAMERA, *SIZE)
    assert torch.equal(scene.depth_m, without)
    assert "2 of 3 boxes stand on the ground and give the depth of objects" in scene.notes


def test_a_box_does_not_show_as_a_rectangle() -> None:
    fall = (torch.arange(100.0) / 300.0)[:, None].expand(100, 200)
    depth, used = paint_boxes(torch.full((100, 200), 40.0), fall, torch.tensor([[60.0, 20.0, 140.0, 80.0]]), 1.5, 60.0)
    assert used == 1
    object_m = 1.5 * 300.0 / 80.0
    assert float(depth[50, 100]) == pytest.approx(object_m, rel=1e-5)
    assert float(depth[21, 61]) == 40.0  # a corner shows the background
    slope = depth.log().diff(dim=1).abs().max()
    assert float(slope) < 0.25 * math.log(40.0 / object_m)  # no leap from one pixel to the next


def test_the_own_vehicle_is_near_and_neither_road_nor_sky() -> None:
    picture, _, _ = corridor(CAMERA)
    near = torch.zeros(1, *SIZE)
    near[0, 225:] = 1.0
    near[0, :30, :50] = 1.0  # a mirror, before the sky
    sky = torch.zeros(1, *SIZE)
    sky[0, :60] = 1.0
    scene = ScenePrior(near_mask=near, sky=sky).scene(CAMERA, *SIZE, image=picture)
    assert float(scene.depth_m[near > 0.5].max()) <= 1.0
    assert scene.sky is not None
    assert float(scene.sky[near > 0.5].max()) == 0.0
    assert scene.near_mask is not None
    assert torch.equal(scene.near_mask, near)
    assert any(note.startswith("the own vehicle covers") for note in scene.notes)


def test_the_own_bonnet_is_found_unless_there_is_said_to_be_none() -> None:
    picture, _, _ = corridor(CAMERA)
    noise = 0.02 * torch.randn(picture.shape, generator=torch.Generator().manual_seed(0))
    picture = (picture + noise).clamp(0.0, 1.0)
    picture[:, 226:] = 0.1
    found = ScenePrior(sky=NO_SKY).scene(CAMERA, *SIZE, image=picture)
    assert found.near_mask is not None
    assert float(found.depth_m[0, 230:].max()) <= 1.0
    none = ScenePrior(sky=NO_SKY, near_mask=None).scene(CAMERA, *SIZE, image=picture)
    assert none.near_mask is None
    assert float(none.depth_m[0, 230:].min()) > 2.0


def test_without_a_picture_the_camera_alone_gives_ground_and_walls() -> None:
    scene = ScenePrior().scene(replace(CAMERA, pitch_rad=0.02), *SIZE)
    assert torch.isfinite(scene.depth_m).all()
    assert scene.sky is None
    assert scene.horizon_row is None
    assert scene.notes[0].startswith("depth is guessed: flat ground 1.6 m below the camera, side walls 6.36 m")
    assert scene.notes[1] == "no colour picture was given: the horizon is the camera's own"
    mosaic = ScenePrior().scene(replace(CAMERA, pitch_rad=0.02), *SIZE, image=torch.rand(1, *SIZE))
    assert torch.equal(mosaic.depth_m, scene.depth_m)


def test_called_it_gives_the_depth_of_its_scene_in_the_wanted_dtype() -> None:
    picture, _, sky = corridor(CAMERA)
    prior = ScenePrior(sky=sky)
    scene = prior.scene(CAMERA, *SIZE, image=picture, dtype=torch.float64)
    assert scene.depth_m.dtype == torch.float64
    assert torch.equal(prior(CAMERA, *SIZE, image=picture, dtype=torch.float64), scene.depth_m)


def test_a_batch_is_guessed_picture_by_picture() -> None:
    first, _, _ = corridor(CAMERA)
    second, _, _ = corridor(replace(CAMERA, pitch_rad=0.015))
    prior = ScenePrior(sky=lambda rgb: torch.zeros(1, *rgb.shape[-2:]))
    together = scene_of(prior, CAMERA, *SIZE, image=torch.stack([first, second]))
    for index, picture in enumerate((first, second)):
        assert torch.equal(together.depth_m[index], prior(CAMERA, *SIZE, image=picture))
    with pytest.raises(ValueError, match="ScenePrior: expected one image"):
        prior(CAMERA, *SIZE, image=torch.stack([first, second]))


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"street_half_width_m": -1.0}, "street_half_width_m"),
        ({"street_half_width_m": (1.0, 2.0, 3.0)}, "left, right"),
        ({"camera_height_m": 0.0}, "camera_height_m"),
        ({"farthest_m": math.nan}, "farthest_m"),
        ({"horizon": "level"}, "horizon"),
        ({"near_mask": "bonnet"}, "near_mask"),
        ({"boxes": torch.zeros(3, 5)}, "boxes: expected"),
        ({"boxes": torch.tensor([[5.0, 5.0, 1.0, 9.0]])}, "boxes: expected left <= right"),
    ],
)
def test_wrong_options_are_refused(options: dict[str, object], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        ScenePrior(**options)  # type: ignore[arg-type]


@pytest.mark.parametrize("name", ["sky", "near_mask"])
def test_masks_of_another_size_or_range_are_refused(name: str) -> None:
    with pytest.raises(ValueError, match=f"ScenePrior.{name}: expected the picture's size"):
        ScenePrior(**{name: torch.zeros(1, 10, 10)})(CAMERA, *SIZE)
    with pytest.raises(ValueError, match=f"ScenePrior.{name}: expected shares"):
        ScenePrior(**{name: torch.full((1, *SIZE), 255.0)})(CAMERA, *SIZE)


def test_sky_below_an_unsure_horizon_lowers_it() -> None:
    height, width, truth = 120, 320, 66
    camera = Camera.from_intrinsics(fx=250, fy=250, cx=159.5, cy=59.5, width=width, height=height, height_m=1.5)
    picture = torch.full((3, height, width), 0.2)
    picture[:, : truth + 1] = torch.tensor([0.5, 0.7, 0.9])[:, None, None]
    scene = ScenePrior(near_mask=None).scene(camera, height, width, image=picture)
    assert scene.sky is not None
    assert float(scene.sky[0, truth - 3].min()) > 0.99, "sky above the true horizon"
    assert any(f"row {truth}" in note for note in scene.notes)
    assert float(scene.depth_m[0, truth + 20].min()) > 10.0, "the ground starts at the lower horizon"
    kept = ScenePrior(near_mask=None, horizon="camera").scene(camera, height, width, image=picture)
    assert kept.sky is not None
    assert float(kept.sky[0, truth - 3].max()) == 0.0, "a horizon that is given stays"


def test_the_ground_of_a_guess_is_as_probable_as_walls_drawn_at_other_distances_leave_it() -> None:
    view = view_of_street(CAMERA, *SIZE, 0.0, 0.03, None)
    probability = ground_probability(street_depth(view, 1.6, (5.0, 9.0), 80.0), view, 1.6)
    wall = 0.5 * (view.lateral.square() + 0.04**2).log()  # the street's rounded axis
    right = 0.5 + 0.5 * torch.tanh(view.lateral / 0.08)
    wall_m = (math.log(5.0) * (1.0 - right) + math.log(9.0) * right - wall).exp()
    other_m = (wall_m**-4 + 80.0**-4) ** -0.25
    ground_m = torch.where(view.fall > 0, 1.6 / view.fall.clamp_min(1e-9), torch.inf)
    samples = 400
    log_off = 0.4 * torch.randn(samples, generator=torch.Generator().manual_seed(3))
    nearest = torch.stack([ground_m < other_m * off for off in log_off.exp()]).double().mean(0)
    # All pixels share the draws: a binomial share is off by 4 deviations, 4 x 0.5 / sqrt(400), at most.
    assert float((nearest - probability).abs().max()) < 0.1
    assert float((nearest - probability).abs().mean()) < 0.02


def test_the_ground_of_a_guess_ends_along_the_edges_of_the_picture_and_at_boxes() -> None:
    picture, true, sky = corridor(CAMERA, half_width_m=(4.0, 8.0))
    boxes = torch.tensor([[300.0, 110.0, 380.0, 190.0]])
    prior = ScenePrior(street_half_width_m=(5.0, 6.0), farthest_m=200.0, sky=sky, horizon="camera", near_mask=None)
    scene = prior.scene(CAMERA, *SIZE, image=picture)
    assert scene.ground is not None
    road = (torch.arange(240.0)[:, None] - 119.5) / 480.0 * true[0] > 1.6 - 1e-2  # 1.6 m below the camera
    # The walls stand 1 m and 2 m elsewhere than guessed.
    assert float(scene.ground[0][road & (true[0] < 20.0)].mean()) > 0.85
    assert float(scene.ground[0][~road].mean()) < 0.1
    assert float(scene.ground[0, :118].max()) < 0.05
    with_car = replace(prior, boxes=boxes).scene(CAMERA, *SIZE, image=picture)
    assert with_car.ground is not None
    assert float(with_car.ground[0, 140:155, 335:346].max()) < 0.15
    assert float(scene.ground[0, 145:155, 335:346].min()) > 0.8
    assert torch.equal(with_car.ground[0, :, :200], scene.ground[0, :, :200])
