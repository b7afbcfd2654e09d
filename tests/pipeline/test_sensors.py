"""Camera, Lidar, Radar: geometry against closed forms, presets, refused values."""

from __future__ import annotations

import math
import re
from importlib import resources
from pathlib import Path
from typing import Any

import pytest
import torch
import yaml

from torchweather.core.errors import TorchweatherError
from torchweather.pipeline.sensor import _preset, _preset_texts
from torchweather.sensors import BAYER_PATTERNS, Camera, Lidar, Radar, Sensor, sensor_preset

PLAIN: dict[str, Any] = {"width": 32, "height": 24, "fx": 100.0, "fy": 90.0}


@pytest.mark.parametrize("kind", [Camera, Lidar, Radar])
def test_every_preset_builds_names_its_source_and_survives_yaml(kind: type[Sensor]) -> None:
    for name, source in kind.presets().items():
        sensor = kind.preset(name)
        assert len(source) > 20
        assert type(sensor).from_dict(yaml.safe_load(yaml.safe_dump(sensor.to_dict()))) == sensor


@pytest.mark.parametrize(("kind", "preset"), [(Camera, "kitti"), (Lidar, "velodyne-hdl-32e"), (Radar, "awr1843-like")])
def test_a_sensor_is_itself_its_plain_values_or_a_preset(kind: type[Sensor], preset: str) -> None:
    sensor = kind.preset(preset)
    assert kind.of(sensor) is sensor
    assert kind.of(sensor.to_dict()) == kind.of(preset) == sensor
    with pytest.raises(ValueError, match="preset must be one of"):
        kind.of(None)


def test_lucid_triton_has_the_field_of_view_of_rehearse() -> None:
    camera = Camera.preset("lucid-triton")
    assert math.degrees(2 * math.atan(camera.width / 2 / camera.fx)) == pytest.approx(80.8, abs=1e-4)
    assert math.degrees(2 * math.atan(camera.height / 2 / camera.fy)) == pytest.approx(61.6, abs=1e-4)
    same = Camera.from_field_of_view(math.radians(80.8), math.radians(61.6), 1936, 1464)
    assert same.fx == pytest.approx(camera.fx, rel=1e-7)


def test_presets_take_overrides_and_refuse_unknown_names() -> None:
    assert Camera.preset("lucid-triton", exposure_s=0.01).exposure_s == 0.01
    with pytest.raises(ValueError, match=r"preset must be one of .*Did you mean 'lucid-triton'"):
        Camera.preset("lucid-tritn")
    with pytest.raises(ValueError, match=r"Camera: unknown field 'exposure'. Did you mean 'exposure_s'"):
        Camera.preset("lucid-triton", exposure=0.01)


@pytest.mark.parametrize(
    ("name", "size", "view_deg", "height_m"),
    [
        # Horizontal views: KITTI 81 (Geiger 2013 after rectification), nuScenes 64 to 65, Waymo 50, Cityscapes 49.
        ("kitti", (1242, 375), 81.4, 1.65),
        ("nuscenes-front", (1600, 900), 64.6, 1.51),
        ("waymo-front", (1920, 1280), 50.1, 2.12),
        ("acdc", (1920, 1080), 82.3, 1.3),
        ("cityscapes", (2048, 1024), 48.7, 1.22),
        ("argoverse2", (1550, 2048), 49.4, 1.68),
    ],
)
def test_cameras_of_data_sets(name: str, size: tuple[int, int], view_deg: float, height_m: float) -> None:
    camera = Camera.preset(name)
    assert (camera.width, camera.height, camera.height_m) == (*size, height_m)
    assert math.degrees(2 * math.atan(camera.width / 2 / camera.fx)) == pytest.approx(view_deg, abs=0.05)
    assert camera.fx == pytest.approx(camera.fy, rel=0.002)
    assert sensor_preset(f"camera:{name}") == (f"camera:{name}", camera)
    # What no calibration file was compared with says so.
    verified = name in ("kitti", "nuscenes-front")
    source = Camera.presets()[name]
    assert ("Verified against" in source) == verified
    assert verified or "unverified" in source


def test_a_sensor_of_ones_own_in_yaml(tmp_path: Path) -> None:
    camera = Camera.preset("kitti", response_knots=((0.0, 0.0), (0.5, 0.7), (1.0, 1.0)), k1=-0.1)
    lidar = Lidar.preset("velodyne-vlp-16", return_mode="dual")
    radar = Radar.preset("awr1843-like")
    for sensor in (camera, lidar, radar):
        path = tmp_path / f"{sensor.kind}.yaml"
        path.write_text(yaml.safe_dump(sensor.to_dict()))
        name, back = sensor_preset(f"{sensor.kind}:{path}")
        assert name == f"{sensor.kind}:{path}"
        assert back == sensor
        hash(back)  # transforms are kept by their camera
        path.write_text(yaml.safe_dump({sensor.kind: {"kind": sensor.kind, **sensor.to_dict()}}))
        assert type(sensor).preset(str(path)) == sensor


def test_a_file_may_start_from_a_preset_and_be_overridden(tmp_path: Path) -> None:
    path = tmp_path / "my.yml"
    path.write_text("kind: camera\npreset: kitti\nheight_m: 1.4\nsource: my car\n")
    assert Camera.preset(str(path)) == Camera.preset("kitti", height_m=1.4)
    assert Camera.preset(str(path), height_m=1.2, fx=700.0) == Camera.preset("kitti", height_m=1.2, fx=700.0)


@pytest.mark.parametrize(
    ("kind", "text", "message"),
    [
        (Camera, "", "it must be keys with values: kind, preset, source, width, height"),
        (Camera, "- 1", "got [1]"),
        (Camera, "a: [", "expected YAML with the fields of a camera"),
        (Camera, "x: !!python/object/apply:os.getcwd []", "expected YAML"),
        (Camera, "fx: 700", "a camera needs width, height, fx, fy; missing width, height, fy"),
        (Camera, "width: 4\nheight: 4\nfx: 1\nfyy: 1", "unknown key 'fyy'; known are kind, preset"),
        (
            Camera,
            "camera_matrix: [1]",
            "unknown key 'camera_matrix': no field of a camera. A calibration of OpenCV or ROS is read by",
        ),
        (Camera, "fx: seven", "fx must be a number; got 'seven'. It is text; a number has a point: 1.0e-3, not 1e-3"),
        (Camera, "fx: [1]", "fx must be a number; got [1]"),
        (Camera, "fx: true", "fx must be a number; got True"),
        (Camera, "width: 640.5", "width must be a whole number; got 640.5"),
        (Camera, "bayer_pattern: 3", "bayer_pattern must be text; got 3"),
        (Camera, "wavelengths_nm: [a]", "wavelengths_nm must be a list of numbers; got ['a']"),
        (Camera, "kind: lidar\nfx: 1", "kind must be camera; got 'lidar'"),
        (Camera, "preset: kity", "preset must be one of"),
        (Camera, "preset: kitti\nfx: -1", "Camera: fx must be above 0 px; got -1"),
        (Lidar, "max_range_m: 100", "a lidar needs wavelength_nm; missing wavelength_nm"),
        (Lidar, "wavelength_nm: 905\nreturn_mode: firstt", "return_mode must be one of"),
        (Lidar, "wavelength_nm: 905\nelevations_deg: 3", "elevations_deg must be a list of numbers; got 3"),
        (Radar, "polarisation: x", "polarisation must be one of h, v"),
    ],
)
def test_wrong_sensor_files_name_file_and_field(tmp_path: Path, kind: type[Sensor], text: str, message: str) -> None:
    path = tmp_path / "my.yaml"
    path.write_text(text)
    with pytest.raises(TorchweatherError, match=re.escape(message)) as raised:
        kind.preset(str(path))
    assert str(raised.value).startswith(f"{path}: ")
    with pytest.raises(TorchweatherError, match="no such file"):
        kind.preset(str(tmp_path / "none.yaml"))


def test_command_line_names() -> None:
    assert sensor_preset("camera")[0] == "camera:lucid-triton"
    assert isinstance(sensor_preset("lidar:ouster-os1-128")[1], Lidar)
    assert isinstance(sensor_preset("radar")[1], Radar)
    with pytest.raises(ValueError, match="sensor must be one of camera, lidar, radar; got 'sonar'"):
        sensor_preset("sonar")


@pytest.mark.parametrize(
    ("field", "value", "wanted"),
    [
        ("bayer_pattern", "RGBG", "bayer_pattern must be one of RGGB, BGGR, GRBG, GBRG, RCCB; got 'RGBG'"),
        ("fx", 0.0, "fx must be above 0 px"),
        ("fy", math.inf, "fy must be a finite number"),
        ("fx", math.nan, "fx must be above 0 px"),
        ("cx", math.nan, "cx must lie in -1e+07..1e+07 px"),
        ("k1", math.nan, "k1 must lie in -1000..1000; got nan"),
        ("exposure_s", 0.0, "exposure_s must be above 0 s"),
        ("exposure_s", math.inf, "exposure_s must be a finite number"),
        ("width", 0, "width must be 1 px or more"),
        ("bit_depth", 0, "bit_depth must lie in 1..32 bits"),
        ("pitch_rad", 2.0, "pitch_rad must lie in"),
        ("white_level", 0.0, "white_level must exceed black_level"),
        ("wavelengths_nm", (460.0, 530.0, 6.0), "wavelengths_nm must lie in 300..2500 nm"),
        ("response_knots", ((0.0, 0.0), (0.5, 0.7), (0.4, 0.8), (1.0, 1.0)), "both rise from (0, 0) to (1, 1)"),
        ("response_knots", ((0.0, 0.0), (1.0, 0.9)), "both rise from (0, 0) to (1, 1)"),
        ("f_number", 2.0, "focal_length_mm must be above 0 mm; got None"),
        ("focus_distance_m", 0.0, "focus_distance_m must be above 0 m"),
    ],
)
def test_impossible_cameras_are_refused(field: str, value: object, wanted: str) -> None:
    with pytest.raises(ValueError, match=re.escape(wanted)):
        Camera(**{**PLAIN, field: value})


def test_impossible_lidars_and_radars_are_refused() -> None:
    with pytest.raises(ValueError, match=r"wavelength_nm must lie in 300..2500 nm"):
        Lidar(0.905)
    with pytest.raises(ValueError, match=r"frequency_ghz must lie in 1..1000 GHz"):
        Radar(77e9)
    with pytest.raises(ValueError, match="polarisation must be one of h, v"):
        Radar(77.0, "x")


def test_a_ray_passes_through_its_pixel() -> None:
    camera = Camera.from_intrinsics(100.0, 90.0, 10.0, 8.0, 32, 24)
    rays = camera.ray_directions(dtype=torch.float64)
    assert rays.shape == (3, 24, 32)
    assert rays[:, 8, 10].tolist() == [0.0, 0.0, 1.0]
    assert rays[0, 8, 20].item() == pytest.approx(10.0 / 100.0)
    assert rays[1, 17, 10].item() == pytest.approx(9.0 / 90.0)


def test_rays_project_back_through_the_lens() -> None:
    camera = Camera(width=64, height=48, fx=50.0, fy=52.0, k1=-0.2, k2=0.03, p1=1e-3, p2=-2e-3, k3=0.001)
    rays = camera.ray_directions(dtype=torch.float64)
    x, y = camera.distort(rays[0], rays[1])
    cx, cy = camera.principal_point_px
    columns = torch.arange(64, dtype=torch.float64).expand(48, 64)
    rows = torch.arange(48, dtype=torch.float64)[:, None].expand(48, 64)
    # The fixed point gains a factor of about 3 an iteration: 12 of them leave 1e-6 of the 0.1 that it begins with.
    assert (camera.fx * x + cx - columns).abs().max() < 1e-3
    assert (camera.fy * y + cy - rows).abs().max() < 1e-3


def test_distortion_agrees_with_opencvs_formula_at_one_point() -> None:
    camera = Camera(**PLAIN, k1=-0.3, k2=0.1, p1=0.01, p2=-0.02, k3=0.05)
    x, y = 0.4, -0.3
    r2 = x * x + y * y
    radial = 1 - 0.3 * r2 + 0.1 * r2**2 + 0.05 * r2**3
    wanted = (
        x * radial + 2 * 0.01 * x * y - 0.02 * (r2 + 2 * x * x),
        y * radial + 0.01 * (r2 + 2 * y * y) + 2 * -0.02 * x * y,
    )
    got = camera.distort(torch.tensor(x, dtype=torch.float64), torch.tensor(y, dtype=torch.float64))
    assert [float(v) for v in got] == pytest.approx(wanted, abs=1e-15)


@pytest.mark.parametrize(("roll", "pitch"), [(0.0, 0.0), (0.3, 0.0), (0.0, -0.2), (0.3, -0.2)])
def test_gravity_is_the_vehicles_down_seen_by_the_camera(roll: float, pitch: float) -> None:
    camera = Camera(**PLAIN, roll_rad=roll, pitch_rad=pitch)
    rotation = torch.tensor(camera.camera_from_vehicle(), dtype=torch.float64)
    down = rotation @ torch.tensor([0.0, 0.0, -1.0], dtype=torch.float64)
    assert down.tolist() == pytest.approx(list(camera.down_direction()), abs=1e-15)
    assert torch.allclose(rotation @ rotation.T, torch.eye(3, dtype=torch.float64), atol=1e-15)
    assert torch.linalg.det(rotation).item() == pytest.approx(1.0)


def test_looking_up_moves_the_horizon_down() -> None:
    camera = Camera(**PLAIN, pitch_rad=0.1)
    forward = torch.tensor(camera.camera_from_vehicle(), dtype=torch.float64) @ torch.tensor(
        [1.0, 0.0, 0.0], dtype=torch.float64
    )
    assert (forward[1] / forward[2]).item() == pytest.approx(math.tan(0.1))  # y points down


def test_rolling_clockwise_lets_drops_fall_to_the_right_of_down() -> None:
    # A camera turned clockwise as seen from behind sees the world turned anticlockwise: down moves to the right.
    assert Camera(**PLAIN, roll_rad=0.2).down_direction()[0] == pytest.approx(math.sin(0.2))


def test_cropped_and_resized_cameras_see_along_the_same_rays() -> None:
    camera = Camera(width=64, height=48, fx=50.0, fy=52.0, cx=30.0, cy=25.0)
    rays = camera.ray_directions(dtype=torch.float64)
    window = camera.cropped(4, 8, 20, 30).ray_directions(dtype=torch.float64)
    assert torch.allclose(window, rays[:, 4:24, 8:38], atol=1e-14)
    halved = camera.resized(32, 24).ray_directions(dtype=torch.float64)
    between = rays.reshape(3, 24, 2, 32, 2).mean((2, 4))  # a pixel of the half size covers four
    assert torch.allclose(halved, between, atol=1e-14)
    with pytest.raises(ValueError, match="even to keep the Bayer phase; got 1, 0"):
        camera.cropped(1, 0, 20, 30)


def test_bands_follow_the_colour_index_red_green_blue() -> None:
    assert Camera(**PLAIN).bands == {"red": 600.0, "green": 530.0, "blue": 460.0}
    assert list(Camera(**PLAIN, bayer_pattern="RCCB").bands) == ["red", "clear", "blue"]
    assert set(BAYER_PATTERNS) == {"RGGB", "BGGR", "GRBG", "GBRG", "RCCB"}


def test_aperture_is_focal_length_over_f_number() -> None:
    assert Camera(**PLAIN).aperture_m == 0.0
    assert Camera(**PLAIN, f_number=2.0, focal_length_mm=6.0).aperture_m == pytest.approx(3e-3)


def test_raw_levels_follow_the_bit_depth() -> None:
    assert Camera(**PLAIN).saturation_level == 4095.0
    assert Camera(**PLAIN, bit_depth=8).saturation_level == 255.0
    assert Camera(**PLAIN, white_level=3800.0).saturation_level == 3800.0


def test_beyond_the_lens_undistorted_coordinates_stay_finite() -> None:
    # A real dashcam's calibration: the polynomial folds back at a distorted radius of 0.70, the corner lies at 0.67.
    lens = {"k1": -0.2517, "k2": 0.0204, "p1": -0.0004, "k3": -0.0630}
    camera = Camera(width=1280, height=720, fx=1158.6, fy=1155.4, cx=669.2, cy=390.8, **lens)
    x = torch.linspace(-1.5, 1.5, 61)[None].expand(61, 61)
    xu, yu = camera.undistort(x, x.T)
    assert bool(torch.isfinite(xu).all() & torch.isfinite(yu).all())
    inside = torch.hypot(x, x.T) < 0.65
    back = torch.stack(camera.distort(xu, yu))[:, inside]
    assert torch.allclose(back, torch.stack([x, x.T])[:, inside], atol=2e-3)


def test_presets_parsed_one_by_one_are_those_of_the_whole_file() -> None:
    text = resources.files("torchweather").joinpath("presets", "sensors.yaml").read_text(encoding="utf-8")
    for kind, presets in yaml.safe_load(text).items():
        assert list(_preset_texts()[kind]) == list(presets)
        assert {name: _preset(kind, name) for name in presets} == presets
