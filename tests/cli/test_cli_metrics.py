"""``torchweather metrics``: files and folders, images, mosaics and clouds, and what is refused."""

from __future__ import annotations

import csv
import io
import json
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from torch import Tensor

from torchweather.cli.output import spelled
from torchweather.image import mosaic, normalise, quantise
from torchweather.io import read_image, read_points, write_image, write_points
from torchweather.metrics import CLOUD_SCORES, IMAGE_SCORES, Region, bayer_scores, cloud_scores, image_scores

NAMES_OF_IMAGES = [
    *("psnr", "ssim", "ms_ssim", "cw_ssim", "iw_ssim", "dss", "vif"),
    *("vsi", "fsim", "sr_sim", "haarpsi", "gmsd", "ms_gmsd", "mdsi"),
]
NAMES_OF_CLOUDS = ["sdm", "rmse", "mde", "mmde", "hd", "hd95"]


COMMAND = ("metrics",)


@pytest.fixture
def scored(run: Any) -> Any:
    """What was found, of a run without a mistake."""

    def call(*argv: object) -> dict[str, Any]:
        code, out, err = run(*argv, "--json")
        assert (code, err) == (0, "")
        values: dict[str, Any] = json.loads(out, parse_constant=lambda name: pytest.fail(f"{name} is no JSON"))
        return values

    return call


def picture(seed: int = 1, height: int = 32, width: int = 40) -> Tensor:
    """Smooth random colours in [0, 1]."""
    noise = torch.rand(1, 3, 8, 8, generator=torch.Generator().manual_seed(seed))
    return torch.nn.functional.interpolate(noise, (height, width), mode="bicubic").clamp(0, 1)[0]


def cloud(seed: int = 1, rows: int = 60) -> Tensor:
    points = torch.randn(rows, 4, generator=torch.Generator().manual_seed(seed)) * 8.0
    points[:, 3] = 0.5
    return points


def image_pair(folder: Path, dtype: torch.dtype = torch.uint8, height: int = 32, width: int = 40) -> tuple[Path, Path]:
    """A clear colour image and one in a veil."""
    clear = picture(height=height, width=width)
    for name, image in (("clear", clear), ("foggy", 0.6 * clear + 0.3)):
        write_image(folder / f"{name}.png", quantise(image, dtype))
    return folder / "clear.png", folder / "foggy.png"


def raw_pair(folder: Path, pattern: str = "RGGB", white: float = 4095.0, suffix: str = ".png") -> tuple[Path, Path]:
    """Raw mosaics in 16 bits, clear and in a veil."""
    clear = mosaic(picture(), pattern)
    for name, raw in (("raw", clear), ("veiled", 0.6 * clear + 0.2)):
        write_image(folder / f"{name}{suffix}", quantise(raw, torch.uint16, 0.0, white))
    return folder / f"raw{suffix}", folder / f"veiled{suffix}"


def cloud_pair(folder: Path, suffix: str = ".bin") -> tuple[Path, Path]:
    write_points(folder / f"clear{suffix}", cloud())
    write_points(folder / f"rainy{suffix}", cloud()[:50] + torch.tensor([0.1, 0.0, 0.0, 0.0]))
    return folder / f"clear{suffix}", folder / f"rainy{suffix}"


def floats(scores: dict[str, Tensor]) -> dict[str, float]:
    return {name: float(score) for name, score in scores.items()}


# ---- two files -----------------------------------------------------------------------------------------------------


def test_one_pair_of_images_has_the_fourteen_keys_and_the_scores_of_the_functions(scored: Any, tmp_path: Path) -> None:
    reference, distorted = image_pair(tmp_path, height=170, width=200)
    found = scored(reference, distorted)
    assert (found.pop("reference"), found.pop("distorted")) == (str(reference), str(distorted))
    assert list(found) == NAMES_OF_IMAGES == list(IMAGE_SCORES)
    clear, foggy = (read_image(path)[0] for path in (reference, distorted))
    # The reference comes first on the command line and second in Python; float32 of 8 bits in two orders of rounding.
    assert found == pytest.approx(floats(image_scores(foggy, clear, data_range=255.0)), rel=1e-5)
    swapped = scored(distorted, reference)
    assert swapped["vif"] > 1.0 > found["vif"]


def test_one_pair_of_clouds_has_the_six_keys(scored: Any, tmp_path: Path) -> None:
    reference, distorted = cloud_pair(tmp_path)
    found = scored(reference, distorted)
    assert (found.pop("reference"), found.pop("distorted")) == (str(reference), str(distorted))
    assert list(found) == NAMES_OF_CLOUDS == list(CLOUD_SCORES)
    assert found == floats(cloud_scores(read_points(distorted).points, read_points(reference).points))
    assert found["hd"] > 0.1


@pytest.mark.parametrize("suffix", [".bin", ".pcd.bin", ".pcd", ".ply", ".npz", ".csv"])
def test_clouds_of_every_format(scored: Any, tmp_path: Path, suffix: str) -> None:
    for name, points in (("clear", cloud(1)), ("rainy", cloud(2))):
        ringed = torch.cat([points, torch.zeros(60, 1)], 1) if suffix == ".pcd.bin" else points
        write_points(tmp_path / f"{name}{suffix}", ringed)
    found = scored(tmp_path / f"clear{suffix}", tmp_path / f"rainy{suffix}", "--metrics", "mde,chamfer")
    wanted = floats(cloud_scores(cloud(2), cloud(1), names=("mde", "chamfer")))
    assert {name: found[name] for name in ("mde", "chamfer")} == pytest.approx(wanted, rel=1e-6)


@pytest.mark.parametrize("suffix", [".png", ".tif", ".tiff", ".jpg", ".jpeg", ".npy", ".npz"])
def test_images_of_every_format(scored: Any, tmp_path: Path, suffix: str) -> None:
    for name, image in (("a", picture(1)), ("b", picture(2))):
        write_image(tmp_path / f"{name}{suffix}", quantise(image, torch.uint8))
    found = scored(tmp_path / f"a{suffix}", tmp_path / f"b{suffix}", "--metrics", "psnr")
    stored = [read_image(tmp_path / f"{name}{suffix}")[0] for name in "ba"]
    assert found["psnr"] == pytest.approx(float(image_scores(*stored, ["psnr"], data_range=255.0)["psnr"]), rel=1e-5)


def test_numbers_that_are_not_finite_are_texts(scored: Any, run: Any, tmp_path: Path) -> None:
    reference, _ = image_pair(tmp_path)
    found = scored(reference, reference, "--metrics", "psnr,gmsd")
    assert (found["psnr"], found["gmsd"]) == ("inf", 0.0)
    _, out, _ = run(reference, reference, "--metrics", "psnr,gmsd", "--csv")
    assert out.splitlines()[1].endswith(",inf,0.0")
    write_points(tmp_path / "none.pcd", cloud()[:0])
    write_points(tmp_path / "some.pcd", cloud())
    found = scored(tmp_path / "some.pcd", tmp_path / "none.pcd")
    assert [found[name] for name in NAMES_OF_CLOUDS] == [1.0, *["inf"] * 5]
    assert spelled({"a": (-math.inf, math.nan), "b": 1.5}) == {"a": ["-inf", "nan"], "b": 1.5}


def test_empty_clouds_and_clouds_of_one_point_are_defined(scored: Any, tmp_path: Path) -> None:
    for name, rows in (("none", 0), ("one", 1), ("some", 60)):
        write_points(tmp_path / f"{name}.pcd", cloud()[:rows])
    none, one, some = (tmp_path / f"{name}.pcd" for name in ("none", "one", "some"))
    assert {scored(none, none)[name] for name in NAMES_OF_CLOUDS} == {0.0}
    assert {scored(one, one)[name] for name in NAMES_OF_CLOUDS} == {0.0}
    found = scored(some, one)
    assert found["sdm"] == 1.0
    assert 0.0 < found["mde"] < found["hd"] < 60.0


def test_region_and_rmse_by_index(scored: Any, tmp_path: Path) -> None:
    turned = cloud().roll(1, 0)
    write_points(tmp_path / "a.pcd", cloud())
    write_points(tmp_path / "b.pcd", turned)
    pair = tmp_path / "a.pcd", tmp_path / "b.pcd"
    assert scored(*pair, "--metrics", "rmse")["rmse"] == 0.0
    found = scored(*pair, "--metrics", "rmse", "--rmse", "index", "--region", "x=0:,z=-3:7.5")
    region = Region(x_m=(0.0, math.inf), z_m=(-3.0, 7.5))
    wanted = cloud_scores(turned, cloud(), names=("rmse",), correspondence="index", region=region)["rmse"]
    assert found["rmse"] == float(wanted) > 1.0


def test_lines_for_people_say_which_way_is_better(run: Any, tmp_path: Path) -> None:
    code, out, err = run(*image_pair(tmp_path), "--metrics", "psnr,gmsd")
    assert (code, err) == (0, "")
    psnr, gmsd = out.splitlines()[-2:]
    assert "higher is better" in psnr
    assert "lower is better" in gmsd
    _, out, _ = run(*cloud_pair(tmp_path), "--metrics", "hd")
    assert "m, lower is better" in out


# ---- mosaics -------------------------------------------------------------------------------------------------------


def test_a_mosaic_is_demosaiced_as_its_camera_says(run: Any, tmp_path: Path) -> None:
    reference, distorted = raw_pair(tmp_path)
    code, out, err = run(reference, distorted, "--metrics", "psnr,ssim", "--json")
    assert code == 0
    assert "raw mosaic (RGGB)" in err
    light = [normalise(read_image(path)[0], 0.0, 4095.0) for path in (distorted, reference)]  # 12 bits of the preset
    wanted = floats(bayer_scores(*light, ["psnr", "ssim"], pattern="RGGB"))
    found = json.loads(out)
    assert {name: found[name] for name in wanted} == wanted
    assert run(reference, distorted, "--metrics", "psnr", "--quiet")[2] == ""


def test_planes_have_their_own_scores_and_a_mean(scored: Any, run: Any, tmp_path: Path) -> None:
    pair = raw_pair(tmp_path, "GRBG")
    options = ("--metrics", "psnr", "--bayer", "planes", "--pattern", "GRBG", "--encoding", "linear")
    found = scored(*pair, *options)
    light = [normalise(read_image(path)[0], 0.0, 4095.0) for path in reversed(pair)]
    wanted = bayer_scores(*light, ["psnr"], pattern="GRBG", scored_as="planes", encoding="linear")["psnr"]
    assert [found[f"psnr_{plane}"] for plane in ("g1", "r", "b", "g2")] == wanted.tolist()
    assert found["psnr"] == pytest.approx(float(wanted.mean()))
    _, out, _ = run(*pair, *options, "--csv")
    assert out.splitlines()[0] == "reference,distorted,psnr,psnr_g1,psnr_r,psnr_b,psnr_g2"
    clear = scored(*pair, "--metrics", "psnr", "--bayer", "planes", "--sensor", "camera:sekonix-sf3325")
    assert {"psnr_r", "psnr_c1", "psnr_c2", "psnr_b"} <= set(clear)


def test_levels_gains_and_grey(scored: Any, tmp_path: Path) -> None:
    """10 bits with black at 64: the same light as without; one factor of all colours leaves the ratio of error to 1."""
    clear = mosaic(picture(), "RGGB")
    for name, raw in (("a", clear), ("b", 0.5 * clear)):
        write_image(tmp_path / f"{name}.png", quantise(raw, torch.uint16, 64.0, 1023.0))
    pair = tmp_path / "a.png", tmp_path / "b.png"
    levels = ("--metrics", "psnr", "--bayer", "planes", "--encoding", "linear", "--black-level", 64)
    found = scored(*pair, *levels, "--bit-depth", 10)
    error = (clear - 0.5 * clear).reshape(16, 2, 20, 2).square().mean((0, 2))
    wanted = -10.0 * error.log10().flatten()
    # Rounding to steps of 1/959 adds an error of 1/959/sqrt(12) a pixel and image: below 0.01 dB here.
    assert [found[f"psnr_{plane}"] for plane in ("r", "g1", "g2", "b")] == pytest.approx(wanted.tolist(), abs=0.01)
    assert scored(*pair, *levels, "--white-level", 1023) == found
    halved = scored(*pair, *levels, "--bit-depth", 10, "--gains", 0.5, 0.5, 0.5)
    assert halved["psnr"] == pytest.approx(found["psnr"] + 20 * math.log10(2), abs=1e-4)
    grey = scored(*pair, "--metrics", "psnr", "--bayer", "grey", "--white-level", 1023)
    stored = [normalise(read_image(path)[0], 0.0, 1023.0) for path in reversed(pair)]
    assert grey["psnr"] == float(image_scores(*stored, ["psnr"])["psnr"])


def test_mosaics_of_8_bits_and_of_floats(scored: Any, tmp_path: Path) -> None:
    """8 bits of a 12-bit camera are its upper eight; levels that are given are the file's own."""
    clear = mosaic(picture(), "RGGB")
    options = ("--metrics", "psnr", "--bayer", "planes", "--encoding", "linear")
    for suffix, white in ((".png", 255.0), (".npy", 1.0), (".npz", 200.0)):
        for name, raw in (("a", clear), ("b", 0.5 * clear)):
            codes = raw * white if suffix != ".png" else quantise(raw, torch.uint8)
            write_image(tmp_path / f"{name}{suffix}", codes)
        pair = tmp_path / f"a{suffix}", tmp_path / f"b{suffix}"
        given = ("--white-level", white) if suffix != ".npy" else ()
        found = scored(*pair, *options, *given)
        planes = (0.5 * clear).reshape(16, 2, 20, 2).square().mean((0, 2))
        wanted = float((-10.0 * planes.log10()).mean())
        assert found["psnr"] == pytest.approx(wanted, abs=0.02)  # rounding to 1/255: 0.01 dB
        if suffix == ".png":
            assert scored(*pair, *options)["psnr"] == pytest.approx(found["psnr"], abs=1e-4)


# ---- white ---------------------------------------------------------------------------------------------------------


def test_white_is_that_of_each_files_type(scored: Any, tmp_path: Path) -> None:
    """The same picture in 8 bits, in [0, 1] and in 12 of 16 bits: one PSNR, no 48 dB between them."""
    clear, foggy = picture(), 0.6 * picture() + 0.3
    wanted = float(image_scores(foggy, clear, ["psnr"])["psnr"])
    write_image(tmp_path / "clear.png", quantise(clear, torch.uint8))
    write_image(tmp_path / "foggy.npy", foggy)
    found = scored(tmp_path / "clear.png", tmp_path / "foggy.npy", "--metrics", "psnr")
    # Rounding to 1/255 adds (1/255)^2/12 to a mean square error near 0.02: 0.001 dB, and as much by its correlation.
    assert found["psnr"] == pytest.approx(wanted, abs=0.01)
    for name, image in (("clear", clear), ("foggy", foggy)):
        write_image(tmp_path / f"{name}12.npy", quantise(image, torch.uint16, 0.0, 4095.0))
    pair = tmp_path / "clear12.npy", tmp_path / "foggy12.npy"
    found = scored(*pair, "--metrics", "psnr", "--white-level", 4095)
    assert found["psnr"] == pytest.approx(wanted, abs=0.01)


def test_16_bits_that_hold_fewer_are_said_once(run: Any, tmp_path: Path) -> None:
    image = picture()
    for folder in ("a", "b"):
        (tmp_path / folder).mkdir()
        for name in ("0", "1"):
            write_image(tmp_path / folder / f"{name}.npy", quantise(image, torch.uint16, 0.0, 4095.0))
    code, _, err = run(tmp_path / "a", tmp_path / "b", "--metrics", "ssim")
    assert code == 0
    (line,) = err.splitlines()
    assert "no value above 4095" in line
    assert "--white-level" in line


# ---- folders -------------------------------------------------------------------------------------------------------


def folders(tmp_path: Path) -> tuple[Path, Path]:
    """Three pairs (one by another ending), one broken, and files of one side."""
    clear, foggy = tmp_path / "clear", tmp_path / "foggy"
    clear.mkdir()
    foggy.mkdir()
    for number in range(3):
        image = picture(number)
        write_image(clear / f"{number}.png", quantise(image, torch.uint8))
        write_image(foggy / f"{number}{'.npy' if number == 2 else '.png'}", quantise(0.5 * image, torch.uint8))
    (clear / "broken.png").write_bytes((clear / "0.png").read_bytes())
    (foggy / "broken.png").write_bytes((clear / "0.png").read_bytes()[:60])
    write_image(clear / "alone.png", quantise(picture(9), torch.uint8))
    write_image(foggy / "other.png", quantise(picture(9), torch.uint8))
    (clear / "notes.txt").write_text("none of it")
    return clear, foggy


def test_folders_are_matched_by_name_and_a_broken_pair_leaves_the_others(run: Any, tmp_path: Path) -> None:
    clear, foggy = folders(tmp_path)
    code, out, err = run(clear, foggy, "--metrics", "psnr,gmsd", "--json")
    assert code == 2
    found = json.loads(out)
    names = [(Path(row["reference"]).name, Path(row["distorted"]).name) for row in found["files"]]
    assert names == [("0.png", "0.png"), ("1.png", "1.png"), ("2.png", "2.npy"), ("broken.png", "broken.png")]
    good, broken = found["files"][:3], found["files"][3]
    assert all(set(row) == {"reference", "distorted", "psnr", "gmsd"} for row in good)
    assert set(broken) == {"reference", "distorted", "error"}
    assert "broken.png" in broken["error"]
    for name in ("psnr", "gmsd"):
        assert found["mean"][name] == pytest.approx(sum(row[name] for row in good) / 3)
    assert found["unmatched"] == {"reference": ["alone.png"], "distorted": ["other.png"]}
    unmatched, error = err.splitlines()
    assert "alone.png" in unmatched
    assert "other.png" in unmatched
    assert error.startswith(f"torchweather: error: {foggy / 'broken.png'}: ")


def test_csv_has_a_row_a_file_and_the_mean(run: Any, tmp_path: Path) -> None:
    clear, foggy = folders(tmp_path)
    code, out, _ = run(clear, foggy, "--metrics", "psnr,gmsd", "--csv")
    assert code == 2
    rows = list(csv.DictReader(io.StringIO(out)))
    assert list(rows[0]) == ["reference", "distorted", "psnr", "gmsd", "error"]
    assert [Path(row["reference"]).name for row in rows] == ["0.png", "1.png", "2.png", "broken.png", "mean"]
    assert rows[3]["psnr"] == ""
    assert "broken.png" in rows[3]["error"]
    assert float(rows[-1]["psnr"]) == pytest.approx(sum(float(row["psnr"]) for row in rows[:3]) / 3)
    (foggy / "broken.png").unlink()
    code, out, _ = run(clear, foggy, "--metrics", "psnr,gmsd", "--csv")
    assert (code, out.splitlines()[0]) == (0, "reference,distorted,psnr,gmsd")


def test_a_table_for_people_has_the_mean_last(run: Any, tmp_path: Path) -> None:
    code, out, err = run(*folders(tmp_path), "--metrics", "psnr,gmsd", "--quiet")
    assert code == 2
    lines = out.splitlines()
    assert lines[0].split() == ["file", "psnr", "gmsd"]
    assert lines[4].split() == ["broken.png", "error", "error"]
    assert lines[5].startswith("mean")
    assert len(err.splitlines()) == 2  # files of one side and the broken one; no progress


def test_folders_of_clouds(scored: Any, tmp_path: Path) -> None:
    for folder, shift in (("clear", 0.0), ("rainy", 0.25)):
        (tmp_path / folder).mkdir()
        for number in range(2):
            far = torch.cartesian_prod(*[torch.arange(1.0, 5.0)] * 3)  # a grid of 1 m: the nearest point is the shift
            points = torch.cat([far + shift * torch.tensor([1.0, 0.0, 0.0]), torch.ones(64, 1)], 1)
            write_points(tmp_path / folder / f"{number}.pcd", points[number:])
    found = scored(tmp_path / "clear", tmp_path / "rainy", "--metrics", "hd,mde")
    assert [row["hd"] for row in found["files"]] == [0.25, 0.25]
    assert found["mean"] == {"hd": 0.25, "mde": 0.25}


def test_nothing_that_matches_is_a_mistake(run: Any, tmp_path: Path) -> None:
    for name in ("a", "b"):
        (tmp_path / name).mkdir()
        write_image(tmp_path / name / f"{name}.png", quantise(picture(), torch.uint8))
    code, out, err = run(tmp_path / "a", tmp_path / "b")
    assert (code, out) == (2, "")
    (line,) = err.splitlines()
    assert "a.png" in line
    assert "b.png" in line


def test_two_files_of_one_stem_are_no_partner_of_a_third(run: Any, tmp_path: Path) -> None:
    for name in ("a", "b"):
        (tmp_path / name).mkdir()
    for path in ("a/0.png", "a/0.tif", "b/0.npy", "a/1.png", "b/1.png"):
        write_image(tmp_path / path, quantise(picture(), torch.uint8))
    code, out, err = run(tmp_path / "a", tmp_path / "b", "--metrics", "psnr", "--json")
    assert code == 0
    assert [Path(row["reference"]).name for row in json.loads(out)["files"]] == ["1.png"]
    assert "0.png, 0.tif" in err


def test_a_folder_of_both_kinds_takes_the_one_of_the_sensor(run: Any, scored: Any, tmp_path: Path) -> None:
    for name in ("a", "b"):
        (tmp_path / name).mkdir()
        write_image(tmp_path / name / "0.png", quantise(picture(), torch.uint8))
        write_points(tmp_path / name / "0.pcd", cloud())
    pair = tmp_path / "a", tmp_path / "b"
    code, _, err = run(*pair)
    assert code == 2
    assert "--sensor" in err
    assert scored(*pair, "--sensor", "lidar", "--metrics", "hd")["mean"] == {"hd": 0.0}
    assert scored(*pair, "--sensor", "camera", "--metrics", "psnr")["mean"] == {"psnr": "inf"}


def test_radar_detections(scored: Any, tmp_path: Path) -> None:
    head = "range_m,azimuth_deg,elevation_deg,speed_m_per_s,rcs_dbsm"
    for name, rows in (("clear", ["50,0,0,-3,0", "20,90,0,0,5"]), ("rainy", ["50,0,0,-3,0"])):
        (tmp_path / f"{name}.csv").write_text("\n".join([head, *rows, ""]))
    pair = tmp_path / "clear.csv", tmp_path / "rainy.csv"
    found = scored(*pair, "--sensor", "radar:imaging-77ghz", "--metrics", "hd,mde")
    far = math.hypot(50.0, 20.0)  # the lost detection to the one that is left
    assert (found["hd"], found["mde"]) == pytest.approx((far, far / 3), rel=1e-5)


# ---- mistakes ------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("argv", "said"),
    [
        (["{clear}", "{none}"], "no such file"),
        (["{clear}", "{here}"], "two files or two folders"),
        (["{empty}", "{empty}"], "holds no images or point clouds"),
        (["{clear}", "{text}"], "expected images or point clouds"),
        (["{clear}", "{cloud}"], "is an image"),
        (["{archive}", "{archive}"], "--sensor camera"),
        (["{clear}", "{foggy}"], "--metrics psnr,ssim,dss,vsi,fsim,sr_sim,haarpsi,gmsd,ms_gmsd,mdsi"),
        (["{clear}", "{foggy}", "--metrics", "ms_ssim"], "32 px on its short side"),
        (["{raw}", "{raw}", "--bayer", "planes", "--metrics", "psnr,fsim,vif"], "16 px on its short side"),
        (["{clear}", "{foggy}", "--metrics", "pnsr"], "Did you mean 'psnr'"),
        (["{clear}", "{foggy}", "--metrics", "hd"], "--metrics must be one of psnr"),
        (["{cloud}", "{cloud}", "--metrics", "psnr"], "--metrics must be one of sdm"),
        (["{clear}", "{foggy}", "--metrics", ","], "got none"),
        (["{clear}", "{foggy}", "--json", "--csv"], "not both"),
        (["{clear}", "{small}", "--metrics", "psnr"], "expected the size of {clear}, 40 x 32 px"),
        (["{clear}", "{raw}", "--metrics", "psnr"], "with 3 colours per pixel; got 40 x 32 px with one value"),
        (["{clear}", "{cut}", "--metrics", "psnr"], "truncated"),
        (["{clear}", "{undefined}", "--metrics", "psnr"], "{undefined}: expected values from 0 to 1 (white); got nan"),
        (["{clear}", "{codes}", "--metrics", "psnr"], "{codes}: expected values from 0 to 1 (white); got 0"),
        (["{unit}", "{unit}", "--metrics", "psnr", "--white-level", "255"], "no value is above"),
        (["{clear}", "{foggy}", "--metrics", "psnr", "--white-level", "100"], "expected values from 0 to 100"),
        (["{clear}", "{foggy}", "--metrics", "psnr", "--white-level", "300"], "white_level must fit torch.uint8"),
        (["{clear}", "{foggy}", "--metrics", "psnr", "--bayer", "planes"], "--bayer is for raw mosaics"),
        (["{clear}", "{foggy}", "--metrics", "psnr", "--black-level", "4"], "--black-level is for raw mosaics"),
        (["{raw}", "{raw}", "--metrics", "psnr", "--bit-depth", "10"], "expected values from 0 to 1023 (white)"),
        (["{raw}", "{raw}", "--metrics", "psnr", "--pattern", "RGBG"], "must be one of RGGB"),
        (["{raw}", "{raw}", "--metrics", "psnr", "--gains", "1", "0", "1"], "gains must be above 0"),
        (["{odd}", "{odd}", "--metrics", "psnr"], "{odd}: bayer_scores: height and width of a mosaic must be even"),
        (["{batch}", "{batch}", "--metrics", "psnr"], "expected one image (C, H, W); got (2, 3, 32, 40)"),
        (["{clear}", "{foggy}", "--region", "x=0:9"], "--region is for point clouds"),
        (["{cloud}", "{cloud}", "--bayer", "planes"], "--bayer is for images"),
        (["{cloud}", "{cloud}", "--region", "x=0-9"], "--region must be like x=0:60"),
        (["{cloud}", "{cloud}", "--region", "x=0:9,x=1:2"], "--region must be like x=0:60"),
        (["{cloud}", "{cloud}", "--region", "x=a:9"], "--region must be like x=0:60"),
        (["{cloud}", "{cloud}", "--region", "x=9:1"], "x_m must be (lowest, highest) in m; got (9.0, 1.0)"),
        (["{cloud}", "{fewer}", "--rmse", "index"], "expected as many rows as {cloud} has, 60; got 50"),
        (["{clear}", "{foggy}", "--sensor", "sonar"], "camera, lidar or radar"),
        (["{clear}", "{foggy}", "--sensor", "camera:lucid-titron"], "Did you mean 'lucid-triton'"),
        (["{clear}", "{foggy}", "--sensor", "lidar"], "expected point clouds"),
    ],
)
def test_a_mistake_gives_one_line_and_exit_code_2(run: Any, tmp_path: Path, argv: list[str], said: str) -> None:
    clear, foggy = image_pair(tmp_path)
    raw, _ = raw_pair(tmp_path)
    write_image(tmp_path / "small.png", quantise(picture(height=30), torch.uint8))
    (tmp_path / "cut.png").write_bytes(clear.read_bytes()[:-400])
    (tmp_path / "empty").mkdir()
    (tmp_path / "text.txt").write_text("text")
    np.savez(tmp_path / "archive.npz", np.zeros((9, 3)))
    undefined = picture()
    undefined[0, 3, 3] = math.nan
    images = {"undefined": undefined, "codes": 255 * picture(), "unit": picture(), "odd": picture()[:1, :31]}
    for name, image in {**images, "batch": picture().expand(2, 3, 32, 40)}.items():
        write_image(tmp_path / f"{name}.npy", image)
    points, fewer = cloud_pair(tmp_path)
    names = {
        "clear": clear, "foggy": foggy, "raw": raw, "here": tmp_path, "none": tmp_path / "none.png",
        "empty": tmp_path / "empty", "text": tmp_path / "text.txt", "cut": tmp_path / "cut.png",
        "small": tmp_path / "small.png", "archive": tmp_path / "archive.npz", "cloud": points, "fewer": fewer,
        **{name: tmp_path / f"{name}.npy" for name in (*images, "batch")},
    }  # fmt: skip
    code, out, err = run(*(part.format(**names) for part in argv), "--quiet")
    assert (code, out) == (2, "")
    (line,) = err.splitlines()
    assert line.startswith("torchweather: error: ")
    assert said.format(**names) in line


@pytest.mark.parametrize("level", [0, 90, 255])
def test_constant_images_have_defined_scores(scored: Any, tmp_path: Path, level: int) -> None:
    flat = torch.full((3, 170, 170), level, dtype=torch.uint8)
    write_image(tmp_path / "flat.png", flat)
    write_image(tmp_path / "other.png", torch.full_like(flat, 140))
    same = scored(tmp_path / "flat.png", tmp_path / "flat.png")
    assert same["psnr"] == "inf"
    # float32 through filters leaves 1e-6 or so.
    for name in NAMES_OF_IMAGES[1:]:
        assert same[name] == pytest.approx(IMAGE_SCORES[name].ideal, abs=1e-5), name
    other = scored(tmp_path / "flat.png", tmp_path / "other.png")
    assert other["psnr"] == pytest.approx(20 * math.log10(255 / abs(level - 140)), abs=1e-3)
    for name in NAMES_OF_IMAGES[1:]:
        assert isinstance(other[name], float), name  # a finite number
