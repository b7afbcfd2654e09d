"""The halls of REHEARSE against the dimensions that are published, and the rain field against marching rays."""

from __future__ import annotations

import math

import pytest
import torch

from torchweather.scenes import (
    CEREMA_FIELD,
    THI_RAIN_FIELD,
    RainField,
    Scene,
    SceneLabel,
    cerema_tunnel,
    lidar_view,
    radar_view,
    thi_hall,
)
from torchweather.scenes.raw_frame import raw_frame
from torchweather.scenes.rehearse_targets import TARGETS
from torchweather.sensors import Camera, Lidar, Radar

UP, AHEAD, BACK, LEFT = (0.0, 0.0, 1.0), (1.0, 0.0, 0.0), (-1.0, 0.0, 0.0), (0.0, 1.0, 0.0)


def way_m(scene: Scene, *ways: tuple[float, float, float], eye: tuple[float, float, float]) -> list[float]:
    """Metres to what rays meet first."""
    found: list[float] = scene.cast(eye, torch.tensor(ways, dtype=torch.float64)).range_m.tolist()
    return found


def test_the_halls_have_their_published_size() -> None:
    # 1.9 m is above the target; the tunnel is 30 x 5 x 2.2 m, the building of the hall 123 m long.
    ahead, back, left, up = way_m(cerema_tunnel(), AHEAD, BACK, LEFT, UP, eye=(0.0, 0.0, 1.9))
    assert (ahead + back, 2 * left, 1.9 + up) == pytest.approx((30.0, 5.0, 2.2))
    ahead, back = way_m(thi_hall(), AHEAD, BACK, eye=(0.0, 0.0, 3.0))
    assert ahead + back == pytest.approx(123.0)
    size = [high - low for low, high in zip(THI_RAIN_FIELD.low_m, THI_RAIN_FIELD.high_m, strict=True)]
    assert size[:2] == [50.0, 5.0]
    assert size[0] * size[1] == 250.0


@pytest.mark.parametrize("build", [thi_hall, cerema_tunnel])
def test_the_halls_are_closed_in_every_direction(build: type[Scene]) -> None:
    direction = torch.randn(20_000, 3, generator=torch.Generator().manual_seed(3))
    assert torch.isfinite(build().cast((0.0, 0.0, 1.5), direction).range_m).all()


@pytest.mark.parametrize(("build", "distance_m"), [(thi_hall, 28.0), (thi_hall, 56.0), (cerema_tunnel, 15.0)])
@pytest.mark.parametrize("target", TARGETS)
def test_the_nearest_face_of_each_target_stands_at_its_distance(
    build: type[Scene], distance_m: float, target: str
) -> None:
    scene = build(target, distance_m)  # type: ignore[call-arg,arg-type]
    y, z = torch.meshgrid(
        torch.linspace(-2.2, 2.2, 300, dtype=torch.float64),
        torch.linspace(-1.45, 0.4, 120, dtype=torch.float64),
        indexing="ij",
    )
    aim = torch.stack([torch.full_like(y, distance_m), y, z], -1)
    hit = scene.cast((0.0, 0.0, 1.5), aim)
    kinds = {"car": [SceneLabel.CAR], "boards": [SceneLabel.BOARD]}.get(
        target, [SceneLabel.PEDESTRIAN, SceneLabel.CYCLIST]
    )
    mine = torch.isin(hit.label, torch.tensor([int(kind) for kind in kinds]))
    assert int(mine.sum()) > 200
    # People and stands are round, and a stand's foot reaches 0.24 m before its board.
    assert float(hit.point_m[mine][:, 0].min()) == pytest.approx(distance_m, abs=0.01 if target == "car" else 0.3)


def test_masts_stand_beside_the_lane_and_only_where_asked_for() -> None:
    names = [{thing.name for thing in thi_hall(masts=one).objects} for one in (False, True)]
    assert names[1] - names[0] == {"sprinkler masts"}
    aim = torch.tensor([[7.5, 2.75, -0.5]])
    assert [int(thi_hall(masts=one).cast((0.0, 0.0, 1.5), aim).label) for one in (False, True)] == [13, 10]


def test_three_sensors_see_the_halls() -> None:
    camera, lidar = Camera.preset("lucid-triton").resized(96, 72), Lidar.preset("ouster-os1-128")
    few = torch.nn.functional.normalize(torch.tensor([[1.0, y, z] for y in (-0.05, 0.0, 0.05) for z in (-0.03, 0.2)]))
    for scene in (thi_hall(), cerema_tunnel()):
        frame = raw_frame(scene, camera)
        assert torch.isfinite(frame.depth_m).all()
        assert frame.airlight is not None  # no sky in view: walls and roof stand for it
        assert 0.1 < min(frame.airlight) < 0.8
        assert bool(lidar_view(scene, lidar, directions=few).hit.any())
        seen = radar_view(scene, Radar.preset("imaging-77ghz"))
        assert {"car", next(name for name in seen.names if name.startswith("corner"))} <= {
            seen.names[k] for k in seen.object_id.tolist()
        }


def test_the_field_is_what_marching_along_the_rays_finds() -> None:
    """A thousand steps of 0.1 m along each ray; a step is the tolerance."""
    field = RainField((2.0, -2.5, 0.0), (50.0, 2.5, 5.0))
    eye = torch.tensor([0.0, 0.3, 1.7], dtype=torch.float64)
    rays = torch.nn.functional.normalize(
        torch.randn(400, 3, generator=torch.Generator().manual_seed(1), dtype=torch.float64)
        * torch.tensor([1.0, 0.4, 0.2])
        + torch.tensor([0.7, 0.0, 0.0]),
        dim=-1,
    )
    steps = 0.1 * (torch.arange(1000, dtype=torch.float64) + 0.5)
    at = eye + steps[:, None, None] * rays
    inside = ((at > at.new_tensor(field.low_m)) & (at < at.new_tensor(field.high_m))).all(-1)
    enter, leave = field.crossing_m(eye, rays)
    torch.testing.assert_close(leave - enter, 0.1 * inside.sum(0).double(), rtol=0, atol=0.1001)
    met = inside.any(0)
    assert 100 < int(met.sum()) < 400
    first = steps[inside[:, met].int().argmax(0)]
    torch.testing.assert_close(enter[met], first - 0.05, rtol=0, atol=0.1001)


def test_a_ray_along_a_face_and_one_that_misses() -> None:
    enter, leave = THI_RAIN_FIELD.crossing_m((0.0, 0.0, 1.73), torch.tensor([[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0]]))
    assert enter.tolist() == [0.0, 0.0]
    assert leave.tolist() == [2.5, 0.0]
    enter, leave = CEREMA_FIELD.crossing_m((0.0, 0.0, 1.5), torch.tensor([3.0, 0.0, 0.0]))
    assert (float(enter), float(leave)) == (0.0, 27.0)


def test_wrong_arguments_are_named() -> None:
    for build in (thi_hall, cerema_tunnel):
        with pytest.raises(ValueError, match="car, boards, pedestrian"):
            build("lorry")
    with pytest.raises(ValueError, match="distance_m"):
        cerema_tunnel("car", 28.0)
    with pytest.raises(ValueError, match="distance_m"):
        thi_hall("car", math.nan)
    with pytest.raises(ValueError, match="low_m below high_m"):
        RainField((0.0, 0.0, 0.0), (1.0, 0.0, 1.0))
    with pytest.raises(ValueError, match=r"shape \(\.\.\., 3\)"):
        THI_RAIN_FIELD.crossing_m((0.0, 0.0, 1.0), torch.zeros(4, 2))
