"""A known camera on frames of another size: square pixels, the same rays, and what is said about it."""

from __future__ import annotations

import argparse
import math
from pathlib import Path

import pytest
import torch
from PIL import Image

from torchweather.cli.frames import add_camera_arguments, add_depth_arguments, fitted_camera, gathered
from torchweather.core.errors import TorchweatherError
from torchweather.sensors import Camera, fit_camera

PLAIN = Camera(width=640, height=480, fx=500.0, fy=500.0, cx=310.0, cy=250.0)
KITTI_TEXT = "P2: 721.5377 0 609.5593 44.85728 0 721.5377 172.854 0.2163791 0 0 1 0.002745884"


def parsed(*argv: object) -> argparse.Namespace:
    parser = argparse.ArgumentParser()
    add_camera_arguments(parser)
    add_depth_arguments(parser)
    return parser.parse_args([str(word) for word in argv])


def test_kitti_frames_get_square_pixels_and_the_presets_horizontal_view() -> None:
    preset = Camera.preset("lucid-triton")
    fit = fit_camera(preset, 1242, 375)
    assert fit.how == "cropped"
    assert fit.camera.fx == fit.camera.fy == pytest.approx(preset.fx * 1242 / 1936)
    assert fit.horizontal_view_deg == pytest.approx(80.8, abs=1e-4)
    # Stretched into the frame, ground would lie 2.3 times too near.
    assert preset.resized(1242, 375).fy < 0.44 * fit.camera.fy
    assert preset.fitted_to(1242, 375) == fit.camera


@pytest.mark.parametrize(("height", "how"), [(360, "cropped"), (600, "extended")])
def test_rows_are_cropped_or_added_and_rays_stay(height: int, how: str) -> None:
    fit = fit_camera(PLAIN, 640, height)
    assert fit.how == how
    assert (fit.camera.cy + 0.5) / height == pytest.approx((PLAIN.cy + 0.5) / 480)
    rays, own = fit.camera.ray_directions(dtype=torch.float64), PLAIN.ray_directions(dtype=torch.float64)
    # The row of the principal point differs; columns see along the same directions.
    assert torch.allclose(rays[0, 0], own[0, 0], atol=1e-14)
    assert torch.allclose(rays[1].diff(dim=0)[0], own[1].diff(dim=0)[0], atol=1e-14)


def test_half_the_width_of_a_crop_halves_the_focal_length() -> None:
    whole, half = fit_camera(PLAIN, 640, 300).camera, fit_camera(PLAIN, 320, 150).camera
    assert half.fx == half.fy == whole.fx / 2
    assert half.ray_directions(dtype=torch.float64)[0, 0, 0].item() == pytest.approx(
        whole.ray_directions(dtype=torch.float64)[0, 0, :2].mean().item()
    )


def test_frames_of_the_same_shape_are_rescaled_as_they_are() -> None:
    squeezed = Camera(width=640, height=480, fx=500.0, fy=540.0)
    assert fit_camera(squeezed, 640, 480).camera is squeezed
    for width, height in ((320, 240), (1280, 960), (322, 240)):  # the last is 0.6 % off
        fit = fit_camera(squeezed, width, height)
        assert fit.how == "scaled"
        assert fit.camera == squeezed.resized(width, height)
    assert fit_camera(squeezed, 327, 240).how == "cropped"  # 2 %
    with pytest.raises(ValueError, match="width must be 1 px or more; got 0"):
        fit_camera(squeezed, 0, 240)


def test_portrait_frames_keep_the_view_of_the_longer_side() -> None:
    fit = fit_camera(PLAIN, 480, 1280)
    assert fit.how == "turned"
    assert fit.camera.fx == fit.camera.fy == 1000.0
    assert fit.camera.principal_point_px == (239.5, 639.5)
    upright = Camera(width=480, height=640, fx=500.0, fy=505.0)
    assert fit_camera(upright, 1280, 300).camera.fx == 1010.0


def test_lens_distortion_is_kept_inside_what_the_camera_saw_alone() -> None:
    lens = Camera.preset("waymo-front")
    assert fit_camera(lens, 1920, 800).camera.k2 == lens.k2
    for size in ((1920, 1800), (1080, 1920)):
        assert not fit_camera(lens, *size).camera.distorted


def test_a_disk_of_blur_is_rescaled_with_the_pixels() -> None:
    soft = Camera(width=640, height=480, fx=500.0, fy=500.0, lens_blur_px=2.0)
    assert fit_camera(soft, 320, 100).camera.lens_blur_px == pytest.approx(1.0)
    assert fit_camera(soft, 240, 640).camera.lens_blur_px == pytest.approx(2.0)


def test_what_is_said_of_each_fit() -> None:
    camera = Camera.preset("lucid-triton")
    for (width, height), words in {
        (1936, 1464): "",
        (968, 732): "is scaled to them",
        (
            1242,
            375,
        ): "keeps its horizontal view of 80.8 degrees, its vertical one is cropped, square pixels, fx = fy = 729.7",
        (1080, 1920): "keeps the view along its longer side",
        (5000, 600): "A panorama is no pinhole",
    }.items():
        said = fitted_camera(camera, height, width, parsed())[1]
        assert words in said
        assert bool(words) == bool(said)
        assert ("panorama" in said) == (width == 5000)


def photograph(path: Path, millimetres: int, size: tuple[int, int] = (80, 60)) -> Path:
    tags = Image.Exif()
    tags.get_ifd(0x8769)[0xA405] = millimetres
    Image.new("RGB", size).save(path, exif=tags)
    return path


def test_a_photograph_gets_the_camera_of_its_exif(tmp_path: Path) -> None:
    file = photograph(tmp_path / "x.jpg", 26)
    preset = Camera.preset("waymo-front", exposure_s=0.01)
    camera, said = fitted_camera(preset, 60, 80, parsed(), frame=file)
    assert camera.fx == camera.fy == pytest.approx(26 * 100 / math.hypot(36, 24))
    assert camera.principal_point_px == (39.5, 29.5)
    assert (camera.distorted, camera.exposure_s) == (False, 0.01)
    assert "EXIF (FocalLengthIn35mmFilm 26 mm" in said
    assert fitted_camera(preset, 60, 80, parsed())[0] != camera  # no file, no tags
    assert fitted_camera(preset, 60, 80, parsed("--fx", 70), frame=file)[0].intrinsics == (70.0, 70.0, 39.5, 29.5)


def test_a_calibration_comes_before_exif_and_below_fx(tmp_path: Path) -> None:
    (tmp_path / "calib.txt").write_text(KITTI_TEXT)
    file = photograph(tmp_path / "x.jpg", 26, (1242, 375))
    argv = ("--camera", tmp_path / "calib.txt")
    camera, said = fitted_camera(Camera.preset("waymo-front"), 375, 1242, parsed(*argv), frame=file)
    assert camera.intrinsics == (721.5377, 721.5377, 609.5593, 172.854)
    assert (camera.distorted, camera.height_m) == (False, 2.12)
    assert "calib.txt" in said
    args = parsed(*argv, "--fx", 700, "--cy", 180)
    assert fitted_camera(PLAIN, 375, 1242, args)[0].intrinsics == (700.0, 700.0, 609.5593, 180.0)
    with pytest.raises(TorchweatherError, match=r"cx = 609\.559 px is not near the middle of a width of 621 px"):
        fitted_camera(PLAIN, 188, 621, parsed(*argv))


def test_dot_files_of_a_folder_are_left_alone(tmp_path: Path) -> None:
    Image.new("RGB", (4, 4)).save(tmp_path / "0.png")
    for name in ("._0.png", ".DS_Store", ".hidden.jpg"):
        (tmp_path / name).write_bytes(b"\x00\x05\x16\x07")
    assert gathered([tmp_path]) == [tmp_path / "0.png"]
    (tmp_path / "0.png").unlink()
    with pytest.raises(ValueError, match="no images"):
        gathered([tmp_path])
    assert gathered([tmp_path / "._0.png"]) == [tmp_path / "._0.png"]  # who names one gets its error
