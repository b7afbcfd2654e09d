"""Archives that are damaged or inflate, and what is read through them: masks of the own vehicle, chains of stages."""

from __future__ import annotations

import struct
import zipfile
from pathlib import Path

import numpy as np
import pytest

from torchweather.core.archives import read_archive, read_array
from torchweather.core.errors import InputValueError, TorchweatherError
from torchweather.io import read_points
from torchweather.lidar import OwnVehicleMask
from torchweather.stages import Chain, Quantise


def test_text_that_is_no_unicode_is_refused(tmp_path: Path) -> None:
    """Python fails with a SystemError where such a name is used."""
    names = np.array(["x", "y", "z", "i"])
    content = names.view(np.uint32).copy()
    content[2] = 0x110000
    np.savez(tmp_path / "a.npz", points=np.ones((2, 4), np.float32), columns=content.view(names.dtype))
    with pytest.raises(TorchweatherError, match="array columns holds text that is no Unicode"):
        read_points(tmp_path / "a.npz")
    np.savez(tmp_path / "b.npz", columns=names.astype(">U1"))
    assert read_archive(tmp_path / "b.npz")[0]["columns"].tolist() == names.tolist()


@pytest.mark.parametrize(
    "content", [b"\x93NUMPY\x02\x00" + struct.pack("<I", 1 << 31) + b"{'descr'", b"\x93NUMPY\xfb\xcf%\x869\x8a"]
)
def test_a_header_longer_than_its_file_takes_no_memory(tmp_path: Path, content: bytes) -> None:
    (tmp_path / "a.npy").write_bytes(content)
    with pytest.raises(TorchweatherError, match="cannot be read"):
        read_array(tmp_path / "a.npy", [])


def inflating(path: Path, name: str, length: int) -> None:
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr(name, bytes(length))


def test_a_mask_of_the_own_vehicle_is_read_without_trust(tmp_path: Path) -> None:
    arrays = {"blocked": np.zeros((2, 3), bool), "nearest_m": np.ones((2, 3)), "farthest_m": np.ones((2, 3))}
    np.savez(tmp_path / "good.npz", **arrays, sweeps=6, views=3.0)
    assert OwnVehicleMask.load(tmp_path / "good.npz").sweeps == 6
    np.savez(tmp_path / "nan.npz", **{**arrays, "nearest_m": np.full((2, 3), np.nan)}, sweeps=6, views=3.0)
    np.savez(tmp_path / "views.npz", **arrays, sweeps=6, views=np.inf)
    inflating(tmp_path / "bomb.npz", "blocked.npy", 100 << 20)
    (tmp_path / "cut.npz").write_bytes((tmp_path / "good.npz").read_bytes()[:200])
    for name in ("nan", "views", "bomb", "cut", "missing"):
        with pytest.raises(InputValueError, match=rf"{name}\.npz: expected a mask of the own vehicle"):
            OwnVehicleMask.load(tmp_path / f"{name}.npz")


def test_a_chain_is_read_without_trust(tmp_path: Path) -> None:
    Chain({"quantise": Quantise()}).save(tmp_path / "good.zip")
    assert list(Chain.load(tmp_path / "good.zip").stages) == ["quantise"]
    inflating(tmp_path / "bomb.zip", "chain.yaml", 100 << 20)
    with pytest.raises(TorchweatherError, match="would inflate"):
        Chain.load(tmp_path / "bomb.zip")
    (tmp_path / "cut.zip").write_bytes((tmp_path / "good.zip").read_bytes()[:200])
    with pytest.raises(TorchweatherError, match=r"cut\.zip: expected a chain"):
        Chain.load(tmp_path / "cut.zip")
