"""Depth files in metres, whatever they were packed in."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
import torch

from torchweather.errors import TorchweatherError
from torchweather.io import read_depth, write_image


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


@pytest.mark.parametrize(("encoding", "metres"), [("millimetre", 2.56), ("kitti", 10.0), ("metre", 2560.0)])
def test_sixteen_bit_png_needs_its_encoding(tmp_path: Path, encoding: str, metres: float) -> None:
    write_image(tmp_path / "d.png", torch.full((1, 2, 2), 2560, dtype=torch.uint16))
    assert read_depth(tmp_path / "d.png", encoding)[0, 0, 0].item() == pytest.approx(metres, rel=1e-6)
    with pytest.raises(TorchweatherError, match=r"need 'millimetre', 'kitti'"):
        read_depth(tmp_path / "d.png")


@pytest.mark.parametrize("encoding", ["millimetre", "kitti"])
def test_zero_is_no_value(tmp_path: Path, encoding: str) -> None:
    write_image(tmp_path / "d.png", torch.zeros(1, 2, 2, dtype=torch.uint16))
    assert torch.isinf(read_depth(tmp_path / "d.png", encoding)).all()
    assert (read_depth(tmp_path / "d.png", encoding, missing_m=80.0) == 80).all()


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


def test_infinite_depth_is_sky_but_nan_and_negative_are_refused(tmp_path: Path) -> None:
    np.save(tmp_path / "d.npy", np.array([[1.0, math.inf]]))
    assert torch.isinf(read_depth(tmp_path / "d.npy")).sum() == 1
    np.save(tmp_path / "d.npy", np.array([[1.0, math.nan, -1.0]]))
    with pytest.raises(TorchweatherError, match=r"d.npy.*got 1 NaN and 1 negative of 3"):
        read_depth(tmp_path / "d.npy")


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
        ("none.png", "kitti", "no such file"),
    ]:
        with pytest.raises(TorchweatherError, match=message):
            read_depth(tmp_path / name, encoding)
    with pytest.raises(ValueError, match="missing_m"):
        read_depth(tmp_path / "float.npy", missing_m=-1.0)
