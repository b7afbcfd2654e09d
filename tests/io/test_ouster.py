"""Ouster recordings: real ones where the SDK and the recordings are, a stand-in for the SDK elsewhere."""

from __future__ import annotations

import importlib.util
import sys
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import torch

from torchweather.cli.clouds import gathered_clouds
from torchweather.core.errors import TorchweatherError
from torchweather.io.ouster import read_ouster

HEIGHT, WIDTH = 3, 4
ORIGIN = np.array([0.01, 0.02, 0.05])


def beams() -> np.ndarray:
    """Directions of the stand-in's beams, ``(H, W, 3)``: rings from 10 degrees down, a turn in 4 columns."""
    elevation = np.radians([10.0, 0.0, -10.0])[:, None]
    azimuth = -2 * np.pi * np.arange(WIDTH)[None] / WIDTH
    ones = np.ones_like(azimuth)
    return np.stack(
        (np.cos(elevation) * np.cos(azimuth), np.cos(elevation) * np.sin(azimuth), np.sin(elevation) * ones), axis=-1
    )


class Frame:
    fields = ("RANGE", "REFLECTIVITY")
    frame_id = 7
    timestamp = np.arange(WIDTH, dtype=np.uint64)

    def field(self, name: str) -> np.ndarray:
        numbers = np.arange(HEIGHT * WIDTH).reshape(HEIGHT, WIDTH)
        return (numbers * 1000).astype(np.uint32) if name == "RANGE" else (numbers + 5).astype(np.uint8)

    def complete(self) -> bool:
        return False


class Recording(list[list[Frame]]):
    sensor_info = (SimpleNamespace(format=SimpleNamespace(pixels_per_column=HEIGHT, columns_per_frame=WIDTH)),)

    def close(self) -> None:
        pass


def table(info: object, use_extrinsics: bool) -> Callable[[np.ndarray], np.ndarray]:
    """As the SDK's: origin + range * direction, and 0 for range 0."""
    return lambda r: np.where(r[..., None] > 0, ORIGIN + r[..., None] / 1000.0 * beams(), 0.0)


@pytest.fixture
def recording(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    core = SimpleNamespace(XYZLut=table, destagger=lambda info, field: np.roll(field, 1, axis=1))
    sdk = SimpleNamespace(core=core, open_source=lambda path, meta: Recording([[Frame()], [Frame()]]))
    monkeypatch.setitem(sys.modules, "ouster", SimpleNamespace(sdk=sdk))
    monkeypatch.setitem(sys.modules, "ouster.sdk", sdk)
    for suffix in (".pcap", ".json"):
        (tmp_path / f"a{suffix}").touch()
    return tmp_path / "a.pcap"


def test_every_beam_has_a_direction_and_a_return_lies_on_it(recording: Path) -> None:
    frames = list(read_ouster(recording))
    assert [frame.frame_id for frame in frames] == [7, 7]
    frame = frames[0]
    assert frame.cloud.grid == (HEIGHT, WIDTH)
    assert frame.cloud.columns == ("x", "y", "z", "intensity", "ring")
    points = frame.cloud.points
    assert frame.directions.dtype == points.dtype == torch.float32
    expected = np.roll(beams(), 1, axis=1).reshape(-1, 3)
    # Float32 of numbers up to 1.
    torch.testing.assert_close(frame.directions.double(), torch.from_numpy(expected), rtol=0, atol=1e-7)
    torch.testing.assert_close(frame.origins_m, torch.tensor(ORIGIN).float().expand(12, 3), rtol=0, atol=1e-7)
    ranges = torch.tensor(np.roll(np.arange(12.0).reshape(HEIGHT, WIDTH), 1, axis=1).reshape(-1))
    on_beam = frame.origins_m + ranges[:, None] * frame.directions
    hit = ranges > 0
    torch.testing.assert_close(points[hit, :3], on_beam[hit].float(), rtol=0, atol=2e-6)
    assert points[~hit].tolist() == [[0, 0, 0, 0, 0]]
    assert torch.equal(points[hit, 3].double(), ranges[hit] + 5)
    assert points[:, 4].reshape(HEIGHT, WIDTH)[:, 0].tolist() == [0, 1, 2]


def test_what_the_recording_lacks_is_named(recording: Path) -> None:
    with pytest.raises(TorchweatherError, match="expected intensity 'signal'; the recording has range, reflectivity"):
        next(read_ouster(recording, intensity="signal"))
    with pytest.raises(ValueError, match="intensity must be one of"):
        read_ouster(recording, intensity="power")
    with pytest.raises(TorchweatherError, match="got no frame"):
        list(read_ouster(recording, incomplete=False))
    recording.with_suffix(".json").unlink()
    with pytest.raises(TorchweatherError, match=r"a\.json: no such file"):
        read_ouster(recording)


def test_without_the_sdk_the_error_names_the_extra(recording: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "ouster.sdk", None)
    with pytest.raises(ImportError, match=r"torchweather\[ouster\]"):
        read_ouster(recording)


@pytest.mark.parametrize(
    ("error", "sentence"),
    [
        (
            ModuleNotFoundError("No module named 'rosbags.highlevel'", name="rosbags.highlevel"),
            r"'rosbags', which ouster-sdk needs .*pip install rosbags,",
        ),
        (
            ModuleNotFoundError("No module named 'ruamel.yaml'", name="ruamel.yaml"),
            r"'ruamel.yaml', which ouster-sdk needs .*pip install ruamel\.yaml,",
        ),
        (ModuleNotFoundError("No module named 'PIL'", name="PIL"), r"'pillow', which .*pip install pillow,"),
        (ModuleNotFoundError("No module named 'ouster'", name="ouster"), r"newer\. .*'torchweather\[ouster\]'"),
        (
            ModuleNotFoundError("No module named 'ouster.sdk'", name="ouster.sdk"),
            r"'ouster' has no ouster\.sdk.* --upgrade 'torchweather\[ouster\]'",
        ),
        (
            ImportError("libGL.so.1: cannot open shared object file", name="ouster.sdk._bindings"),
            r"is installed but cannot be loaded \(libGL.*--force-reinstall ouster-sdk",
        ),
        # What numpy's absence looks like in ouster-sdk 1.0.1.
        (ImportError("Encountered an error while initializing the extension."), r"cannot be loaded \(Encountered"),
    ],
)
def test_the_package_that_is_missing_is_named_in_one_line(
    recording: Path, monkeypatch: pytest.MonkeyPatch, error: ImportError, sentence: str
) -> None:
    def broken(name: str) -> object:
        raise error

    monkeypatch.setattr("torchweather.io.ouster.importlib.import_module", broken)
    with pytest.raises(ImportError, match=sentence) as raised:
        read_ouster(recording)
    assert "\n" not in str(raised.value)


def test_an_osf_is_refused_with_the_way_to_a_pcap(tmp_path: Path) -> None:
    path = tmp_path / "a.osf"
    path.touch()
    with pytest.raises(TorchweatherError, match=r"a\.osf: expected .*\.pcap .*source FILE\.osf save FILE\.pcap"):
        read_ouster(path)
    with pytest.raises(ValueError, match=r"a\.osf: expected .*ouster-cli source"):
        gathered_clouds([path])


def test_the_product_is_named_as_the_metadata_name_it(recording: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    assert next(read_ouster(recording)).product == ""
    (info,) = Recording.sensor_info
    monkeypatch.setattr(info, "prod_line", "OS-2-128", raising=False)
    assert next(read_ouster(recording)).product == "OS-2-128"


RECORDINGS = {"OS-0": ("-0-128-U1_v2.3.0_1024x10", 1, 0.74), "OS-1": ("-1-128_v2.3.0_1024x10_lb_n3", 3, 0.82)}
RECORDINGS["OS-2"] = ("-2-128-U1_v2.3.0_1024x10", 1, 0.91)


@pytest.mark.real_data
@pytest.mark.parametrize("sensor", list(RECORDINGS))
def test_real_recordings(real_data: Callable[[str], Path], sensor: str) -> None:
    if importlib.util.find_spec("ouster") is None:
        pytest.skip("ouster-sdk is not installed (extra ouster)")
    name, count, share = RECORDINGS[sensor]
    frames = list(read_ouster(real_data(f"ouster/OS{name}.pcap")))
    assert len(frames) == count
    for frame in frames:
        points, directions = frame.cloud.points, frame.directions
        assert frame.cloud.grid == (128, 1024)
        hit = points[:, :3].norm(dim=1) > 0
        # SOURCE of the recordings: returns 74, 82 and 91 % of the beams.
        assert hit.double().mean().item() == pytest.approx(share, abs=0.015)
        # Every return lies on its beam: float32 of 250 m.
        away = points[hit, :3] - frame.origins_m[hit]
        along = (away * directions[hit]).sum(dim=1, keepdim=True)
        assert float((away - along * directions[hit]).norm(dim=1).max()) < 1e-4
        assert float(along.min()) > 0
        # As seen from the origin of the frame, offset by less than 9 cm.
        seen = points[hit, :3] / points[hit, :3].norm(dim=1, keepdim=True)
        miss = torch.linalg.cross(seen, directions[hit]).norm(dim=1) * points[hit, :3].norm(dim=1)
        assert float(miss.max()) < 0.09
        torch.testing.assert_close(directions.norm(dim=1), torch.ones(128 * 1024), rtol=0, atol=1e-6)
        # Ring 0 is the top, and a column of the grid has one azimuth within the beams' spread.
        upward = directions[:, 2].reshape(128, 1024)
        assert bool((upward.diff(dim=0) < 0).all())
        azimuth = torch.atan2(directions[:, 1], directions[:, 0]).reshape(128, 1024)
        turn = torch.remainder(azimuth - azimuth[:1] + torch.pi, 2 * torch.pi) - torch.pi
        assert float(turn.abs().max()) < 2 * 2 * torch.pi / 1024
        assert 0 <= float(points[:, 3].min()) <= float(points[:, 3].max()) <= 255
        assert bool((points[~hit][:, :4] == 0).all())
    if sensor == "OS-2":
        (frame,) = read_ouster(real_data(f"ouster/OS{name}.pcap"), intensity="signal")
        assert float(frame.cloud.points[:, 3].max()) > 4000  # photons, up to 4605
    else:
        with pytest.raises(TorchweatherError, match="Low-bandwidth"):
            next(read_ouster(real_data(f"ouster/OS{name}.pcap"), intensity="signal"))
