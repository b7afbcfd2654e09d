"""Scenes that are steady in time: no popping, no smearing across moving edges and cuts, bounded memory."""

from __future__ import annotations

import gc
import math
import weakref
from collections.abc import Iterator
from itertools import pairwise

import pytest
import torch
from torch import Tensor

from tests.recordings import recording
from torchweather.camera.depth import COMPLETED, GUESSED, SceneDepth, ScenePrior
from torchweather.camera.depth.steady import common_near_mask, is_cut, reach_of, steady_scenes
from torchweather.sensors import Camera

BLUE, LEAF = 0.7, 0.3  # grey values


def flat(value: float, height: int = 8, width: int = 12) -> Tensor:
    return torch.full((1, height, width), value)


def picture(value: float = BLUE) -> Tensor:
    return flat(value).expand(3, 8, 12)


def guessed(depth_m: float = 20.0, sky: float = 0.0, **more: object) -> SceneDepth:
    return SceneDepth(flat(depth_m), GUESSED, sky=flat(sky), **more)  # type: ignore[arg-type]


def steady(images: list[Tensor], scenes: list[SceneDepth], reach: int = 3) -> list[SceneDepth]:
    out = list(steady_scenes(zip(range(len(images)), images, scenes, strict=True), reach=reach))
    assert [number for number, _ in out] == list(range(len(images)))
    return [scene for _, scene in out]


def test_scenes_that_do_not_change_come_back() -> None:
    scenes = [guessed(20.0, 0.25, horizon_row=4.5, near_mask=flat(0.5))] * 9
    for scene in steady([picture()] * 9, scenes):
        assert torch.allclose(scene.depth_m, flat(20.0))
        assert scene.sky is not None
        assert torch.allclose(scene.sky, flat(0.25))
        assert scene.near_mask is not None
        assert torch.allclose(scene.near_mask, flat(0.5))
        assert scene.horizon_row == pytest.approx(4.5)
        assert scene.confidence == GUESSED


def test_one_frames_mistake_does_not_show() -> None:
    for wrong in (0.0, 0.6):
        sky = [1.0] * 7 + [wrong] + [1.0] * 7
        for scene in steady([picture()] * 15, [guessed(20.0, share) for share in sky]):
            assert scene.sky is not None
            assert torch.equal(scene.sky, flat(1.0))
            assert bool(torch.isinf(scene.depth_m).all())


def test_sky_that_comes_to_stay_stays() -> None:
    scenes = [guessed(20.0, float(number >= 7)) for number in range(15)]
    shares = [float(scene.sky_share.mean()) for scene in steady([picture()] * 15, scenes)]
    assert shares == [0.0] * 7 + [1.0] * 8


def test_depth_is_averaged_in_the_logarithm() -> None:
    scenes = [guessed(10.0 if number % 2 else 40.0) for number in range(12)]
    out = steady([picture()] * 12, scenes)
    # Even and odd frames have the weights 1 + 2/4 * 2 = 2 and (3/4 + 1/4) * 2 = 2.
    for scene in out[3:9]:
        assert torch.allclose(scene.depth_m, flat(20.0), rtol=1e-4)


def test_leaves_that_move_in_front_of_the_sky_keep_their_edge() -> None:
    images, scenes, edges = [], [], []
    for number in range(9):
        edge = 2 + number
        leaf = torch.arange(12)[None, None].expand(1, 8, 12) < edge
        image = torch.where(leaf, LEAF, BLUE).expand(3, 8, 12)
        sky = torch.where(leaf, 0.0, 1.0)
        images.append(image)
        scenes.append(SceneDepth(torch.where(leaf, 30.0, torch.inf), GUESSED, sky=sky))
        edges.append(sky)
    for scene, sky in zip(steady(images, scenes), edges, strict=True):
        # The guide is averaged over 3 x 3 px, so that the column at the edge sees both.
        assert scene.sky is not None
        assert (scene.sky - sky).abs().amax() < 0.02
        assert torch.equal(torch.isinf(scene.depth_m), scene.sky == 1.0)


def test_where_sky_comes_and_goes_the_depth_stays_finite() -> None:
    scenes = [SceneDepth(flat(math.inf if n % 2 else 30.0), GUESSED, sky=flat(float(n % 2))) for n in range(8)]
    for scene in steady([picture()] * 8, scenes)[3:5]:
        assert scene.sky is not None
        assert torch.equal(scene.sky, flat(0.5))  # both have half of the weight
        assert torch.allclose(scene.depth_m, flat(30.0))


def test_nothing_is_taken_over_across_a_cut() -> None:
    images = [picture(0.2)] * 6 + [picture(0.8)] * 6
    scenes = [guessed(10.0, 0.0, horizon_row=2.0)] * 6 + [guessed(80.0, 1.0, horizon_row=6.0)] * 6
    for number, scene in enumerate(steady(images, scenes)):
        assert scene.horizon_row == pytest.approx(2.0 if number < 6 else 6.0)
        assert float(scene.sky_share.mean()) == pytest.approx(float(number >= 6))
    assert is_cut(images[5], images[6])
    assert not is_cut(images[5], picture(0.25))


def test_the_window_follows_a_trend_without_lag() -> None:
    scenes = [guessed(20.0, horizon_row=100.0 + number) for number in range(15)]
    rows = [scene.horizon_row for scene in steady([picture()] * 15, scenes)]
    assert rows[3:12] == pytest.approx([100.0 + number for number in range(3, 12)], abs=1e-4)


def test_measured_depth_passes_untouched() -> None:
    scenes = [SceneDepth(flat(10.0 + number), COMPLETED) for number in range(7)]
    out = steady([picture()] * 7, scenes)
    assert all(after is before for before, after in zip(scenes, out, strict=True))


@pytest.mark.parametrize("count", [1, 2, 4, 7])
def test_short_sequences_come_out_whole(count: int) -> None:
    assert len(steady([picture()] * count, [guessed()] * count)) == count


def test_a_frame_depends_on_its_neighbours_alone() -> None:
    generator = torch.Generator().manual_seed(3)
    images = [(picture(0.5) + 0.02 * torch.rand(3, 8, 12, generator=generator)) for _ in range(14)]
    scenes = [
        SceneDepth(5 + 50 * torch.rand(1, 8, 12, generator=generator), GUESSED, sky=flat(0.1), horizon_row=4.0 + n)
        for n in range(14)
    ]
    whole = steady(images, scenes)
    late = steady(images[4:], scenes[4:])
    for number in range(4 + 3, 14):
        assert torch.equal(whole[number].depth_m, late[number - 4].depth_m)
        assert whole[number].horizon_row == late[number - 4].horizon_row


def test_memory_is_bounded_by_the_window() -> None:
    held: list[weakref.ref[Tensor]] = []

    def frames() -> Iterator[tuple[int, Tensor, SceneDepth]]:
        for number in range(40):
            image = picture().clone()
            held.append(weakref.ref(image))
            yield number, image, guessed()
            del image

    most = 0
    gc.freeze()  # only what is made from here on is looked through
    for _ in steady_scenes(frames(), reach=3):
        gc.collect()
        most = max(most, sum(one() is not None for one in held))
    gc.unfreeze()
    assert len(held) == 40
    assert most == 7


def test_the_own_vehicle_is_what_most_frames_show() -> None:
    masks = [flat(1.0), flat(1.0), flat(0.0), flat(1.0), flat(0.2)]
    common = common_near_mask([guessed(near_mask=mask) for mask in masks])
    assert common is not None
    assert torch.equal(common, flat(1.0))
    assert common_near_mask([guessed()] * 3) is None
    # Two frames of five see a bonnet: three do not.
    common = common_near_mask([*[guessed(near_mask=flat(1.0))] * 2, *[guessed()] * 3])
    assert common is not None
    assert torch.equal(common, flat(0.0))


def test_the_reach_is_a_fifth_of_a_second_within_bounds() -> None:
    assert [reach_of(rate) for rate in (1.0, 10.0, 15.0, 25.0, 30.0, 120.0)] == [2, 2, 3, 5, 6, 6]
    with pytest.raises(ValueError, match="reach"):
        list(steady_scenes([], reach=-1))


@pytest.mark.real_data
def test_a_highway_drive_does_not_flicker() -> None:
    """Frames of the second half of the clip; the constants were chosen on the first half."""
    clip = recording("dashcam_highway/test_video.mp4")
    pytest.importorskip("av", reason="PyAV is not installed: no videos here (pip install 'torchweather[video]')")
    from torchweather.io.video import VideoReader

    lens = {"k1": -0.2517, "k2": 0.0204, "p1": -0.0004, "k3": -0.0630}
    camera = Camera(width=1280, height=720, fx=1158.6, fy=1155.4, cx=669.2, cy=390.8, height_m=1.3, **lens)
    images = [frame.rgb for number, frame in enumerate(VideoReader(clip)) if 19 <= number < 24]
    scenes = [ScenePrior(near_mask=None).scene(camera, 720, 1280, image=image) for image in images]
    calm = steady(images, scenes, reach=reach_of(25.0))

    def of_frames(some: list[SceneDepth]) -> tuple[float, float]:
        """Sky that changes where the picture does not, pixels a frame; largest step of the horizon, pixels."""
        changes, steps = [], []
        for (image, before), (next_image, after) in pairwise(zip(images, some, strict=True)):
            alike = (image.int() - next_image.int()).abs().amax(0, keepdim=True) <= 4
            changes.append(float((after.sky_share - before.sky_share).abs()[alike].sum()))
            assert before.horizon_row is not None
            assert after.horizon_row is not None
            steps.append(abs(after.horizon_row - before.horizon_row))
        return sum(changes) / len(changes), max(steps)

    (sky, horizon), (calm_sky, calm_horizon) = of_frames(scenes), of_frames(calm)
    assert calm_sky < 0.4 * sky
    assert calm_horizon < 0.5 * horizon
