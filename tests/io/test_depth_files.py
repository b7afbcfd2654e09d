"""Depth files in metres, whatever they were packed in."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
import torch

from torchweather.core.errors import TorchweatherError
from torchweather.io import read_depth, write_image
from torchweather.io.depth import read_disparity


@pytest.mark.parametrize("shape", [(4, 6), (1, 4, 6), (2, 1, 4, 6)])
def test_float_arrays_are_metres(tmp_path: Path, shape: tuple[int, ...]) -> None:
    np.save(tmp_path / "d.npy", np.full(shape, 12.5))
    depth = read_depth(tmp_path / "d.npy")
    assert depth.dtype == torch.float32
    assert depth.shape == (*((1,) if len(shape) == 2 else ()), *shape)
    assert (depth == 12.5).all()


def test_npz_takes_the_depth_among_several_arrays(tmp_path: Path) -> None:
    np.savez(tmp_path / "d.npz", bayer=np.zeros((2, 2)), depth=np.full((2, 2), 3.0))
    assert (read_depth(tmp_path / "d.npz") == 3).all()


@pytest.mark.parametrize(
    ("encoding", "code", "metres"),
    [("millimetre", 2560, 2.56), ("kitti", 2560, 10.0), ("centimetre", 2560, 25.6), ("metre", 25, 25.0)],
)
def test_sixteen_bit_png_needs_its_encoding(tmp_path: Path, encoding: str, code: int, metres: float) -> None:
    write_image(tmp_path / "d.png", torch.full((1, 2, 2), code, dtype=torch.uint16))
    assert read_depth(tmp_path / "d.png", encoding)[0, 0, 0].item() == pytest.approx(metres, rel=1e-6)
    with pytest.raises(TorchweatherError, match=r"need 'millimetre', 'kitti'"):
        read_depth(tmp_path / "d.png")


@pytest.mark.parametrize(("encoding", "metres"), [("millimetre", 12.5), ("centimetre", 125.0)])
def test_float_maps_may_be_in_other_units_of_length(tmp_path: Path, encoding: str, metres: float) -> None:
    np.save(tmp_path / "d.npy", np.array([[12500.0, math.nan, math.inf]], dtype=np.float32))
    depth = read_depth(tmp_path / "d.npy", encoding)[0, 0]
    assert depth[0].item() == pytest.approx(metres)
    assert math.isnan(depth[1])
    assert math.isinf(depth[2])


@pytest.mark.parametrize("encoding", ["millimetre", "centimetre", "kitti", "metre"])
def test_zero_of_integers_is_unknown_unless_told_otherwise(tmp_path: Path, encoding: str) -> None:
    write_image(tmp_path / "d.png", torch.zeros(1, 2, 2, dtype=torch.uint16))
    assert read_depth(tmp_path / "d.png", encoding).isnan().all()
    assert (read_depth(tmp_path / "d.png", encoding, missing_m=80.0) == 80).all()
    assert torch.isposinf(read_depth(tmp_path / "d.png", encoding, missing_m=math.inf)).all()


def test_nan_minus_inf_and_zero_of_floats_are_unknown_and_inf_is_sky(tmp_path: Path) -> None:
    np.save(tmp_path / "d.npy", np.array([[5.0, math.nan, -math.inf, 0.0, math.inf]]))
    depth = read_depth(tmp_path / "d.npy")[0, 0]
    assert depth.isnan().tolist() == [False, True, True, True, False]
    assert torch.isposinf(depth).tolist() == [False, False, False, False, True]
    assert read_depth(tmp_path / "d.npy", missing_m=math.inf)[0, 0].tolist() == [5.0] + [math.inf] * 4


def test_negative_depth_is_refused(tmp_path: Path) -> None:
    np.save(tmp_path / "d.npy", np.array([[1.0, math.nan, -1.0]]))
    with pytest.raises(TorchweatherError, match=r"d.npy.*got 1 negative of 3 pixels. .* write NaN or 0 there"):
        read_depth(tmp_path / "d.npy")


def test_disparity_in_pixels_and_in_256ths_becomes_depth(tmp_path: Path) -> None:
    write_image(tmp_path / "d.png", torch.tensor([[[0, 9216]]], dtype=torch.uint16))  # 36 px
    np.save(tmp_path / "d.npy", np.array([[36.0, 0.0, -1.0, math.nan, math.inf]], dtype=np.float32))
    for name, encoding, known in [("d.png", "disparity_kitti", 1), ("d.npy", "disparity", 0)]:
        depth = read_depth(tmp_path / name, encoding, fx_px=720.0, baseline_m=0.5)[0, 0]
        assert depth[known].item() == pytest.approx(10.0)
        assert int(depth.isnan().sum()) == len(depth) - 1
    with pytest.raises(ValueError, match=r"'disparity' needs fx_px \(pixels\) and baseline_m"):
        read_depth(tmp_path / "d.npy", "disparity", fx_px=720.0)
    with pytest.raises(TorchweatherError, match="Steps of 1/256 are integers"):
        read_depth(tmp_path / "d.npy", "disparity_kitti", fx_px=720.0, baseline_m=0.5)
    with pytest.raises(TorchweatherError, match="Check fx"):
        read_depth(tmp_path / "d.png", "disparity", fx_px=720.0, baseline_m=0.5)  # 9216 px: 4 cm
    with pytest.raises(ValueError, match="encoding must be one of disparity"):
        read_disparity(tmp_path / "d.png", "kitti")


@pytest.mark.parametrize(
    ("code", "encoding", "message"),
    [
        (12500, "metre", r"'millimetre' would give a median of 12.5 m, 'kitti' would give a median of 48.8 m"),
        (12, "millimetre", r"half of it is nearer than 0.2 m.*Likely encoding: 'metre' would give a median of 12 m"),
        (60000, "centimetre", r"farther than 500 m.*'millimetre' would give a median of 60 m"),
    ],
)
def test_integers_of_another_unit_are_refused_with_the_likely_one(
    tmp_path: Path, code: int, encoding: str, message: str
) -> None:
    write_image(tmp_path / "d.png", torch.tensor([[[0, code, code]]], dtype=torch.uint16))
    with pytest.raises(TorchweatherError, match=message):
        read_depth(tmp_path / "d.png", encoding)
    # With pixels of usual depth the map may be right: the sky may be coded as a large number.
    usual = {"metre": 30, "millimetre": 30000, "centimetre": 3000}[encoding]
    write_image(tmp_path / "d.png", torch.tensor([[[0, code, usual, usual]]], dtype=torch.uint16))
    assert read_depth(tmp_path / "d.png", encoding)[0, 0, 2].item() == pytest.approx(30.0)


def test_float_millimetres_are_refused_but_a_renderers_far_plane_is_not(tmp_path: Path) -> None:
    np.save(tmp_path / "d.npy", np.array([[900.0, 12500.0, 30000.0, math.inf]]))
    with pytest.raises(TorchweatherError, match=r"half of it is farther than 1000 m.*'millimetre' .* 12.5 m"):
        read_depth(tmp_path / "d.npy")
    np.save(tmp_path / "d.npy", np.array([[10.0, 20.0, 10000.0]]))
    assert read_depth(tmp_path / "d.npy")[0, 0, 2] == 10000
    np.save(tmp_path / "d.npy", np.array([[0.01, 0.19]]))
    with pytest.raises(TorchweatherError, match=r"nearer than 0.2 m.*up to scale"):
        read_depth(tmp_path / "d.npy")


@pytest.mark.parametrize("name", ["decimetre", "kilometre", "inch", "mm", "cm"])
def test_another_unit_gets_no_nearest_name(tmp_path: Path, name: str) -> None:
    np.save(tmp_path / "d.npy", np.ones((2, 2)))
    with pytest.raises(TorchweatherError, match=r"kitti \(1/256 m\)") as refused:
        read_depth(tmp_path / "d.npy", name)
    assert "Did you mean" not in str(refused.value)


def test_carla_colours_hold_24_bits_of_1000_metres(tmp_path: Path) -> None:
    # CARLA's sensor reference: normalised = (R + 256 G + 65536 B) / (256^3 - 1), metres = 1000 normalised.
    code = torch.tensor([0, 1, 256, 65536, 838861, 256**3 - 1])
    colours = torch.stack([code % 256, code // 256 % 256, code // 65536]).to(torch.uint8)[:, None]
    write_image(tmp_path / "d.png", colours)
    depth = read_depth(tmp_path / "d.png", "carla")
    assert depth.shape == (1, 1, 6)
    expected = [1000.0 * c / (256**3 - 1) for c in code.tolist()[:-1]]
    assert depth.flatten().tolist()[:-1] == pytest.approx(expected, rel=1e-6)
    assert depth.flatten()[4].item() == pytest.approx(50.0, abs=1e-4)
    assert math.isinf(depth.flatten()[5])


def test_wrong_encodings_and_shapes_are_refused(tmp_path: Path) -> None:
    write_image(tmp_path / "rgb.png", torch.zeros(3, 2, 2, dtype=torch.uint8))
    write_image(tmp_path / "grey.png", torch.zeros(1, 2, 2, dtype=torch.uint8))
    np.save(tmp_path / "float.npy", np.ones((2, 2)))
    np.save(tmp_path / "deep.npy", np.ones((3, 2, 2), dtype=np.uint16))
    for name, encoding, message in [
        ("rgb.png", "kitti", 'encoding="carla"'),
        ("grey.png", "carla", r"\(..., 3, H, W\)"),
        ("deep.npy", "carla", "8-bit colour"),
        ("float.npy", "kitti", "floats are metres"),
        ("float.npy", "milimetre", "Did you mean 'millimetre'"),
        ("float.npy", "centimeter", "Did you mean 'centimetre'"),
        ("none.png", "kitti", "no such file"),
    ]:
        with pytest.raises(TorchweatherError, match=message):
            read_depth(tmp_path / name, encoding)
    with pytest.raises(ValueError, match="missing_m"):
        read_depth(tmp_path / "float.npy", missing_m=-1.0)


@pytest.mark.parametrize("encoding", [None, "metre"])
@pytest.mark.parametrize("dtype", [np.float32, np.uint16])
def test_a_street_in_centimetres_is_refused(tmp_path: Path, encoding: str | None, dtype: type) -> None:
    metres = np.geomspace(3.0, 25.0, 400).reshape(20, 20)
    metres[0, 0] = 0.4  # a pixel of the bonnet
    np.save(tmp_path / "d.npy", (100 * metres).astype(dtype))
    read = encoding if dtype == np.float32 else "metre"
    with pytest.raises(TorchweatherError, match=r"95% of it is farther than 100 m.*'centimetre' would give a median"):
        read_depth(tmp_path / "d.npy", read)
    assert read_depth(tmp_path / "d.npy", "centimetre").median() == pytest.approx(np.median(metres), rel=0.01)


@pytest.mark.parametrize("order", ["<", ">"])
def test_portable_float_maps(tmp_path: Path, order: str) -> None:
    metres = np.array([[10.0, 20.0, math.inf], [5.0, 0.0, 40.0]])
    head = f"Pf\n3 2\n{'-1.0' if order == '<' else '1.0'}\n".encode()
    (tmp_path / "d.pfm").write_bytes(head + metres[::-1].astype(f"{order}f4").tobytes())
    depth = read_depth(tmp_path / "d.pfm")
    assert torch.equal(
        torch.where(depth.isnan(), -1.0, depth), torch.tensor([[[10.0, 20.0, math.inf], [5.0, -1.0, 40.0]]])
    )
    disparity = read_disparity(tmp_path / "d.pfm")
    assert int(disparity.isnan().sum()) == 2  # 0 and inf, as Middlebury writes what has no match
    for broken, message in (
        (b"PF\n3 2\n-1.0\n", r"three channels \(PF\)"),
        (b"P5\n3 2\n255\n", "no PFM header"),
        (b"Pf\n3 two\n-1\n", "width, height and scale"),
        (b"Pf\n3 2\n0\n", "scale other than 0"),
        (b"Pf\n3 2\n--1\n", "scale other than 0"),
        (b"Pf\n99999 99999\n-1\n", "truncated"),
    ):
        (tmp_path / "d.pfm").write_bytes(broken + metres.astype("<f4").tobytes())
        with pytest.raises(TorchweatherError, match=message):
            read_depth(tmp_path / "d.pfm")
    with pytest.raises(TorchweatherError, match=r"OpenEXR.*\.npy"):
        read_depth(tmp_path / "d.exr")
