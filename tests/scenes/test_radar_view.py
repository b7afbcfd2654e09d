"""The radar's view of the scenes: what stands where, how strong, how fast."""

from __future__ import annotations

import math

import pytest
import torch
from torch import Tensor

from torchweather.radar import FmcwRadar, Scatterers, car_scatterers
from torchweather.scenes import SCENES, CornerReflector, RadarView, Scene, SceneLabel, fog_tunnel, radar_view
from torchweather.scenes import test_track as track
from torchweather.scenes.lighting import DiffuseLight
from torchweather.scenes.radar_view import BUMPER_MOUNT_M, GENERIC_RCS_DBSM, NEGLIGIBLE
from torchweather.sensors import Radar

RADAR = Radar.preset("imaging-77ghz")
SMALL = Radar.preset("awr1843-like")
EMPTY = Scene("empty", (), DiffuseLight())


@pytest.fixture(scope="module")
def view() -> RadarView:
    return radar_view(track(), RADAR)


def of(view: RadarView, name: str) -> Scatterers:
    mine = view.of(name)
    every = view.scatterers
    return Scatterers(every.position_m[mine], every.speed_m_per_s[mine], every.field_m[mine])


def inside(position: Tensor, box: Tensor, margin_m: float) -> Tensor:
    """Which positions lie in a box grown by a margin."""
    x, y, _ = (position - box[:3]).unbind(-1)
    cos, sin = torch.cos(box[6]), torch.sin(box[6])
    along, across = cos * x + sin * y, cos * y - sin * x
    up = position[:, 2] - box[2]
    return torch.stack([along, across, up], -1).abs().le(box[3:6] / 2 + margin_m).all(-1)


@pytest.mark.parametrize(("name", "range_m"), [("corner 20 m", 20.0), ("corner 45 m", 45.0)])
def test_corner_reflectors_have_their_range_and_cross_section(view: RadarView, name: str, range_m: float) -> None:
    corner = of(view, name)
    assert corner.range_m.tolist() == pytest.approx([range_m], abs=1e-3)
    assert corner.rcs_dbsm.tolist() == pytest.approx([10.0], abs=0.01)
    assert int(view.label[view.of(name)]) == SceneLabel.BOARD
    # A corner is a thing of metal: at another carrier its cross section goes with the inverse square of the wavelength.
    higher = of(radar_view(track(), Radar.preset("imaging-77ghz", frequency_ghz=81.0)), name)
    assert float(higher.rcs_dbsm) - float(corner.rcs_dbsm) == pytest.approx(20 * math.log10(81 / 77), abs=1e-6)


@pytest.mark.parametrize(
    ("name", "rear_m", "yaw_rad"), [("car 28 m", (28.0, -0.15), 0.0), ("car 56 m", (60.30, 3.6), math.pi)]
)
def test_cars_stand_where_the_scene_has_them_and_look_the_same_way(
    view: RadarView, name: str, rear_m: tuple[float, float], yaw_rad: float
) -> None:
    car = of(view, name)
    (box,) = view.boxes[view.box_object_id == view.names.index(name)]
    assert bool(inside(car.position_m, box, 0.05).all())
    nearest = 28.0 if yaw_rad == 0 else 56.0
    assert nearest - 0.01 < float(car.range_m.min()) < nearest + 0.3
    whole = car_scatterers(rear_m, RADAR.wavelength_m, yaw_rad=yaw_rad, radar_height_m=BUMPER_MOUNT_M[2])
    found, wanted = (float(one.field_m.abs().square().sum()) for one in (car, whole))
    assert 1 - NEGLIGIBLE <= found / wanted <= 1 + 1e-9
    # What is left is a part of the same scatterers, place by place.
    gap = torch.linalg.vector_norm(car.position_m[:, None] - whole.position_m, dim=-1)
    assert float(gap.amin(1).max()) < 1e-9


def test_all_else_is_points_of_the_stated_cross_section(view: RadarView) -> None:
    for name in ("pedestrian", "cyclist"):
        one = of(view, name)
        (box,) = view.boxes[view.box_object_id == view.names.index(name)]
        assert len(one.range_m) == 1
        assert bool(inside(one.position_m, box, 0.0).all())
    posts = of(view, "guard rail").position_m
    height_m = BUMPER_MOUNT_M[2]
    assert posts[:, 0].tolist() == pytest.approx([12.0 + 4.0 * k for k in range(len(posts))])
    assert posts[:, 2].tolist() == pytest.approx([0.36 - height_m] * len(posts))
    assert int(view.of("tree 0").sum()) == 6
    rest = ~torch.stack([view.of(name) for name in view.names if name.startswith(("car", "corner"))]).any(0)
    wanted = [GENERIC_RCS_DBSM[SceneLabel(label)] for label in view.label[rest].tolist()]
    assert view.scatterers.rcs_dbsm[rest].tolist() == pytest.approx(wanted, abs=1e-9)


def test_labels_and_names_belong_together(view: RadarView) -> None:
    scene = track()
    for number, label in zip(view.object_id.tolist(), view.label.tolist(), strict=True):
        if number < len(scene.objects):
            assert view.names[number] == scene.objects[number].name
            assert label == scene.objects[number].label
    assert {"road", "lawn", "kerb", "wood"}.isdisjoint(view.names[k] for k in view.object_id.tolist())


def test_everything_stands_still_unless_told(view: RadarView) -> None:
    assert not view.scatterers.speed_m_per_s.any()


def test_with_the_vehicle_moving_still_things_come_at_its_speed_times_the_cosine(view: RadarView) -> None:
    moving = radar_view(track(), RADAR, ego_speed_m_per_s=3.0).scatterers
    cosine = moving.position_m[:, 0] / moving.range_m
    assert torch.allclose(moving.speed_m_per_s, -3.0 * cosine, atol=1e-12)
    assert torch.equal(moving.position_m, view.scatterers.position_m)


def test_what_moves_has_its_velocity_along_the_line_of_sight() -> None:
    velocity = {"car 28 m": (3.0, 0.0, 0.0), "pedestrian": (0.0, 1.5, 0.0), "corner 20 m": (-1.0, 0.0, 0.0)}
    still, driving = (
        radar_view(track(), RADAR, ego_speed_m_per_s=speed, velocity_m_per_s=velocity) for speed in (0.0, 3.0)
    )
    assert float(of(still, "car 28 m").speed_m_per_s.min()) == pytest.approx(3.0, abs=0.02)
    assert float(of(driving, "car 28 m").speed_m_per_s.abs().max()) < 1e-12  # as fast as the radar
    walker = of(still, "pedestrian")
    along = float(walker.position_m[0, 1] / walker.range_m[0])
    assert float(walker.speed_m_per_s) == pytest.approx(1.5 * along)
    assert float(walker.speed_m_per_s) < 0  # from the right towards the middle: nearer
    assert float(of(still, "corner 20 m").speed_m_per_s) < -0.9


def test_a_turned_radar_sees_the_same_things_turned(view: RadarView) -> None:
    angle, tilt = 0.3, -0.05
    turn = torch.tensor(
        [
            [math.cos(angle) * math.cos(tilt), -math.sin(angle), math.cos(angle) * math.sin(tilt)],
            [math.sin(angle) * math.cos(tilt), math.cos(angle), math.sin(angle) * math.sin(tilt)],
            [-math.sin(tilt), 0.0, math.cos(tilt)],
        ],
        dtype=torch.float64,
    )
    pose = torch.eye(4, dtype=torch.float64)
    pose[:3, :3], pose[:3, 3] = turn, torch.tensor(BUMPER_MOUNT_M)
    turned = radar_view(track(), RADAR, T_vehicle_from_radar=pose, ego_speed_m_per_s=2.0)
    for name in ("car 28 m", "corner 20 m", "cyclist"):
        before, after = of(view, name), of(turned, name)
        assert torch.allclose(after.position_m @ turn.T, before.position_m, atol=1e-9)
        assert torch.equal(after.field_m, before.field_m)
        # The vehicle goes along its own x, wherever the radar looks.
        ahead = before.position_m[:, 0] / before.range_m
        assert torch.allclose(after.speed_m_per_s, -2.0 * ahead, atol=1e-9)
    (box,) = turned.boxes[turned.box_object_id == turned.names.index("cyclist")]
    assert bool(inside(of(turned, "cyclist").position_m, box, 0.0).all())


def test_a_radar_elsewhere_is_nearer_to_things() -> None:
    pose = torch.eye(4, dtype=torch.float64)
    pose[:3, 3] = torch.tensor([3.5, 0.6, 0.5])
    moved = radar_view(track(), RADAR, T_vehicle_from_radar=pose.tolist())
    corner = of(moved, "corner 20 m")
    wanted = torch.tensor([19.692 - 3.5, -3.5 - 0.6, 0.0], dtype=torch.float64)
    assert torch.allclose(corner.position_m[0], wanted, atol=1e-12)
    assert float(corner.rcs_dbsm) == pytest.approx(10.0, abs=0.01)  # it faces the radar, wherever that is


def test_nothing_behind_the_radar_or_beyond_its_range(view: RadarView) -> None:
    assert float(view.scatterers.range_m.max()) <= RADAR.max_range_m
    back = torch.diag(torch.tensor([-1.0, -1.0, 1.0, 1.0], dtype=torch.float64))
    assert len(radar_view(track(), RADAR, T_vehicle_from_radar=back).object_id) == 0
    near = Radar.preset("imaging-77ghz", samples=128)  # 19.2 m
    few = radar_view(track(), near)
    assert 0 < len(few.object_id) < 10
    assert {"pedestrian", "cyclist"} <= {few.names[k] for k in few.object_id.tolist()}


def test_what_recedes_stays_in_range_during_the_frame() -> None:
    edge = CornerReflector("edge", (RADAR.max_range_m - 0.05, 0.0, 0.5), 0.08)
    for speed, seen in ((0.0, 1), (3.0, 0)):  # 3 m/s in 19 ms is 6 cm
        found = radar_view(EMPTY, RADAR, reflectors=[edge], velocity_m_per_s={"edge": (speed, 0.0, 0.0)})
        assert len(found.object_id) == seen


def test_every_scene_has_a_view_and_the_same_one_each_time() -> None:
    for name, scene in SCENES.items():
        first, again = (radar_view(scene(), SMALL) for _ in range(2))
        assert len(first.object_id) > 10, name
        for one, other in zip(vars(first.scatterers).values(), vars(again.scatterers).values(), strict=True):
            assert torch.equal(one, other)
    tunnel = radar_view(fog_tunnel(), SMALL)
    assert {"car", "pedestrian dummy"} <= {tunnel.names[k] for k in tunnel.object_id.tolist()}
    assert not any(name.startswith("corner") for name in tunnel.names)


def test_an_empty_scene_has_no_scatterers() -> None:
    nothing = radar_view(EMPTY, SMALL)
    assert nothing.scatterers.position_m.shape == (0, 3)
    assert nothing.boxes.shape == (0, 7)


def test_the_chain_gives_the_corners_of_the_scene_back() -> None:
    from torchweather.scenes.radar_view import REFLECTORS

    velocity = {"corner 20 m": (1.5, 0.0, 0.0), "corner 45 m": (-2.0, 0.0, 0.0)}
    seen = radar_view(EMPTY, SMALL, reflectors=REFLECTORS["test-track"], velocity_m_per_s=velocity)
    points = FmcwRadar(SMALL, noise=False)(seen.scatterers, {})
    assert isinstance(points, Tensor)
    for name in velocity:
        corner = of(seen, name)
        gap = torch.linalg.vector_norm(points[:, :3] - corner.position_m[0], dim=-1)
        row = points[gap.argmin()].double()
        # Half a bin of range and speed, half a dB.
        assert abs(float(row[:3].norm()) - float(corner.range_m)) < SMALL.range_resolution_m / 2
        assert abs(float(row[3]) - float(corner.speed_m_per_s)) < SMALL.speed_resolution_m_per_s / 2
        assert float(row[5]) == pytest.approx(float(corner.rcs_dbsm), abs=0.5)
        azimuth = math.atan2(float(row[1]), float(row[0]))
        assert azimuth == pytest.approx(float(corner.azimuth_rad), abs=math.radians(1.0))


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ({"velocity_m_per_s": {"car": (1.0, 0.0, 0.0)}}, "car 28 m"),
        ({"velocity_m_per_s": {"car 28 m": (1.0, 0.0)}}, "x, y, z"),
        ({"velocity_m_per_s": {"car 28 m": (math.nan, 0.0, 0.0)}}, "finite"),
        ({"ego_speed_m_per_s": math.inf}, "ego_speed_m_per_s"),
        ({"T_vehicle_from_radar": torch.eye(3)}, "T_vehicle_from_radar"),
        ({"T_vehicle_from_radar": torch.diag(torch.tensor([1.0, 1.0, -1.0, 1.0]))}, "rotation"),
    ],
)
def test_wrong_arguments_are_named(options: dict[str, object], said: str) -> None:
    with pytest.raises(ValueError, match=said):
        radar_view(track(), RADAR, **options)  # type: ignore[arg-type]


def test_an_unknown_name_is_refused(view: RadarView) -> None:
    with pytest.raises(ValueError, match="corner 20 m"):
        view.of("corner")
