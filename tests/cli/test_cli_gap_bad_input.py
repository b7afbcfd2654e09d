"""``torchweather gap`` on broken studies: exit code 2, one line with file and key, nothing written, no search begun."""

from __future__ import annotations

import io
import math
import shutil
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from tests.gap.studies import H, W, study
from torchweather.cli import main
from torchweather.gap.sensors.lidar.frames import LidarFrames

Capture = pytest.CaptureFixture[str]
Break = Callable[[Path], object]
MEASURED, CLEAR = "frames/condition-00-001.npz", "frames/scene-00-001.npz"


class SearchBegun(Exception):
    """The first frame is simulated."""


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A study on disk that lacks nothing which the search needs."""
    folder = tmp_path_factory.mktemp("whole") / "study"
    study("lidar", clear=3, frames=3).write(folder)
    return folder


@pytest.fixture
def folder(whole: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A copy to break, and a search that says when it begins."""

    def begun(*_: Any, **__: Any) -> None:
        raise SearchBegun

    monkeypatch.setattr(LidarFrames, "simulated", begun)
    return Path(shutil.copytree(whole, tmp_path / "study"))


# ---- ways to break it ------------------------------------------------------------------------------------------------


def value(*path: Any, to: Any) -> Break:
    """Another value in ``study.yaml``; ``...`` takes the key away."""

    def change(folder: Path) -> None:
        file = folder / "study.yaml"
        values = yaml.safe_load(file.read_text())
        place = values
        for key in path[:-1]:
            place = place[key]
        if to is ...:
            del place[path[-1]]
        else:
            place[path[-1]] = to
        file.write_text(yaml.safe_dump(values))

    return change


def text(content: str) -> Break:
    return lambda folder: (folder / "study.yaml").write_text(content)


def key_renamed(old: str, new: str) -> Break:
    def change(folder: Path) -> None:
        file = folder / "study.yaml"
        file.write_text(file.read_text().replace(f"{old}:", f"{new}:", 1))

    return change


def array(pattern: str, key: str, make: Callable[[Any], Any]) -> Break:
    """Another array in the files of a pattern."""

    def change(folder: Path) -> None:
        for path in sorted(folder.glob(pattern)):
            with np.load(path) as file:
                held = dict(file)
            np.savez(path, **{**held, key: make(held[key])})

    return change


def missing(name: str) -> Break:
    return lambda folder: (folder / name).unlink()


def copied(source: str, target: str) -> Break:
    return lambda folder: shutil.copyfile(folder / source, folder / target)


def linked_out(folder: Path) -> None:
    outside = folder.parent / "outside.npz"
    shutil.move(folder / MEASURED, outside)
    (folder / MEASURED).symlink_to(outside)


def pickled(folder: Path) -> None:
    np.savez(folder / MEASURED, range_m=np.array([[print]], dtype=object), intensity=np.zeros((H, W)))


def header_of(shape: tuple[int, ...]) -> bytes:
    """A ``.npy`` header that promises numbers, and none of them."""
    file = io.BytesIO()
    np.lib.format.write_array_header_1_0(file, {"descr": "<f8", "fortran_order": False, "shape": shape})
    return file.getvalue()


def huge_promise(folder: Path) -> None:
    with zipfile.ZipFile(folder / MEASURED, "w") as archive:
        archive.writestr("range_m.npy", header_of((40_000, 60_000)))


def bomb(folder: Path) -> None:
    """An archive whose directory states 5 GiB."""
    with zipfile.ZipFile(folder / MEASURED, "w") as archive:
        archive.writestr("range_m.npy", header_of((H, W)))
        archive.filelist[0].file_size = 5 * 2**30  # into the directory, which is written at the end


def counts(folder: Path) -> None:
    """Counts of 16 bit for a sensor that has 8."""
    value("sensor", "overrides", "intensity_unit", to="uint8_calibrated")(folder)
    array("frames/*-0?-00?.npz", "intensity", lambda held: 65_535 * held)(folder)


def no_returns(folder: Path) -> None:
    for number, path in enumerate(sorted((folder / "frames").glob("scene-00-00*.npz"))):
        np.savez(path, range_m=np.zeros((H, W)), intensity=np.full((H, W), 0.1 * number))


def all_conditions(key: str, to: Any) -> Break:
    def change(folder: Path) -> None:
        for place in range(5):
            value("conditions", place, key, to=to)(folder)

    return change


CASES: dict[str, tuple[Break, tuple[str, ...]]] = {
    # The file as a whole.
    "no study.yaml": (missing("study.yaml"), ("study.yaml: no such file",)),
    "empty": (text(""), ("study.yaml: format",)),
    "a list": (text("[1, 2]"), ("study.yaml: format", "got 'list'")),
    "no YAML": (text("sensor: {kind: lidar"), ("study.yaml", "cannot be read")),
    "a key twice": (text("sensor: {}\nsensor: {}"), ("study.yaml", "'sensor' stands twice")),
    "another format": (value("format", to="torchweather-study/2"), ("study.yaml: format", "'torchweather-study/2'")),
    # Keys.
    "an unknown key": (key_renamed("  weather", "  wheather"), ("study.yaml", "'conditions[0].wheather'", "'weather'")),
    "no weather": (value("conditions", 1, "weather", to=...), ("study.yaml: conditions[1].weather is missing",)),
    "weather in words": (
        value("conditions", 1, "weather", to={"kind": "hail"}),
        ("study.yaml: conditions[1].weather",),
    ),
    "weather without a rate": (
        value("conditions", 0, "weather", to={"kind": "rain"}),
        ("study.yaml: conditions[0].weather.rate_mm_per_h is missing",),
    ),
    "an unknown split": (value("conditions", 1, "split", to="test"), ("study.yaml: conditions[1].split", "'test'")),
    "an id twice": (value("conditions", 1, "id", to="c0"), ("study.yaml: conditions[1].id", "'c0' stands twice")),
    "an unknown scene": (value("conditions", 1, "scene", to="s7"), ("study.yaml: conditions[1].scene", "'s7'")),
    "no scenes": (value("scenes", to=[]), ("study.yaml: scenes must hold",)),
    "no frames": (value("conditions", 1, "frames", to=[]), ("study.yaml: conditions[1].frames must hold",)),
    # Numbers.
    "a negative spread": (
        value("conditions", 0, "weather", "rate_rel_sd", to=-0.1),
        ("study.yaml: conditions[0].weather.rate_rel_sd must lie in 0..1", "-0.1"),
    ),
    "a spread in percent": (
        value("conditions", 0, "weather", "rate_rel_sd", to=10.0),
        ("study.yaml: conditions[0].weather.rate_rel_sd must lie in 0..1", "got 10"),
    ),
    "a rate as text": (
        value("conditions", 0, "weather", "rate_mm_per_h", to="25 mm/h"),
        ("study.yaml: conditions[0].weather.rate_mm_per_h must be a number", "25 mm/h"),
    ),
    "too few times": (value("conditions", 0, "time_s", to=[0.0]), ("study.yaml: conditions[0].time_s", "3 frames")),
    "times that fall": (
        value("conditions", 0, "time_s", to=[0.0, 0.2, 0.1]),
        ("study.yaml: conditions[0].time_s must not fall", "0.1 at 2 after 0.2"),
    ),
    # The sensor.
    "a sensor of another kind": (
        value("sensor", to={"kind": "camera", "preset": "lucid-triton"}),
        ("scene-00-geometry.npz: the array 'depth_m' is missing", "got cos_incidence, up"),
    ),
    "a preset of another kind": (
        value("sensor", "preset", to="lucid-triton"),
        ("study.yaml: sensor: Lidar: preset must be one of", "'lucid-triton'"),
    ),
    "an intensity unit of another sensor": (
        counts,
        ("scene-00-000.npz: intensity must be at most 255 in the sensor's intensity_unit", "overrides"),
    ),
    "no beams": (value("sensor", "beams", to=...), ("study.yaml: beams is missing", "direction (H, W, 3)")),
    "beams that are no unit vectors": (
        array("beams.npz", "direction", lambda held: 2 * held),
        ("beams.npz: direction must be unit vectors",),
    ),
    "beams of another size": (
        array("beams.npz", "direction", lambda held: held[:, :-1]),
        (".npz: ", f"shape (H, W) = ({H}, {W - 1})", f"got ({H}, {W})"),
    ),
    # Files.
    "a missing frame": (missing(MEASURED), ("study.yaml: conditions[0].frames[1]", MEASURED, "no such file")),
    "a missing clear frame": (missing(CLEAR), ("study.yaml: scenes[0].clear[1]", CLEAR, "no such file")),
    "a path out of the folder": (
        value("conditions", 0, "frames", 1, to="../study/../secret.npz"),
        ("study.yaml: conditions[0].frames[1] must stay inside", "'../study/../secret.npz'"),
    ),
    "an absolute path": (
        value("sensor", "beams", to="/beams.npz"),
        ("study.yaml: sensor.beams must be a path relative", "'/beams.npz'"),
    ),
    "a link out of the folder": (linked_out, ("study.yaml: conditions[0].frames[1] must stay inside",)),
    "pickled arrays": (pickled, ("condition-00-001.npz", "pickled objects, which are never loaded")),
    "no archive": (
        lambda folder: (folder / MEASURED).write_bytes(b"no archive"),
        ("condition-00-001.npz", "cannot be read"),
    ),
    "a header that promises too much": (huge_promise, ("condition-00-001.npz", "range_m", "19200000000 bytes")),
    "an archive that unpacks into too much": (bomb, ("condition-00-001.npz", "5368709120")),
    # Arrays.
    "frames of another size": (
        array(MEASURED, "range_m", lambda held: held[:-1]),
        ("condition-00-001.npz: range_m must have shape", f"got ({H - 1}, {W})"),
    ),
    "geometry of another size": (
        array("frames/scene-01-geometry.npz", "up", lambda held: held.T),
        ("scene-01-geometry.npz: up must have shape",),
    ),
    "NaN everywhere": (
        array(MEASURED, "range_m", lambda held: np.full_like(held, math.nan)),
        ("condition-00-001.npz: range_m must be 0 m (no return) or more, finite; got nan",),
    ),
    "a negative intensity": (
        array(CLEAR, "intensity", lambda held: held - 1),
        ("scene-00-001.npz: intensity must be 0 or more",),
    ),
    "an array under another name": (
        lambda folder: np.savez(folder / MEASURED, ranges_m=np.ones((H, W)), intensity=np.ones((H, W))),
        ("condition-00-001.npz: unknown array 'ranges_m'", "'range_m'"),
    ),
    # What is there does not allow an answer.
    "one clear frame": (
        value("scenes", 0, "clear", to=["frames/scene-00-000.npz"]),
        ("not enough data to decide", "one clear frame", "study.yaml: scenes[0].clear"),
    ),
    "clear frames without noise": (
        value("scenes", 0, "clear", to=3 * ["frames/scene-00-000.npz"]),
        ("not enough data to decide", "are the same", "study.yaml: scenes[0].clear"),
    ),
    "duplicated frames": (
        copied("frames/condition-00-000.npz", "frames/condition-00-002.npz"),
        ("not enough data to decide", "c0 has 1 of 3", "study.yaml: conditions[0].frames[2] repeats [0]"),
    ),
    "a frame named twice": (
        value("conditions", 2, "frames", 1, to="frames/condition-02-000.npz"),
        ("not enough data to decide", "c2 has 1 of 3", "study.yaml: conditions[2].frames[1] repeats [0]"),
    ),
    "a clear frame sold as weather": (
        copied(CLEAR, MEASURED),
        ("not enough data to decide", "clear frames of the scene s0", "study.yaml: conditions[0].frames"),
    ),
    "a frame of two conditions": (
        copied("frames/condition-04-000.npz", MEASURED),
        ("not enough data to decide", "c0 and c4 share frames", "study.yaml: conditions[4].frames"),
    ),
    "clear air alone": (
        all_conditions("weather", {"kind": "clear"}),
        ("not enough data to decide", "No condition has weather", "study.yaml: conditions[].weather"),
    ),
    "nothing to fit to": (
        all_conditions("split", "holdout"),
        ("not enough data to decide", "held out", "study.yaml: conditions[].split"),
    ),
    "nothing held out": (all_conditions("split", "fit"), ("conditions in weather", "others held out; got 4 and 0")),
    "no returns in clear air": (
        no_returns,
        ("not enough data to decide", "clear frames of s0 have no return", "study.yaml: scenes[0].clear"),
    ),
    "no intensity": (
        array("frames/*-0?-00?.npz", "intensity", np.zeros_like),
        ("not enough data to decide", "no intensity", "study.yaml: scenes[0].clear", "intensity_unit: none"),
    ),
}


@pytest.mark.parametrize("case", list(CASES))
def test_a_broken_study_is_refused_in_one_line_and_nothing_is_written(
    case: str, folder: Path, tmp_path: Path, capsys: Capture
) -> None:
    break_it, said = CASES[case]
    break_it(folder)
    before = {path: path.lstat().st_mtime_ns for path in tmp_path.rglob("*")}
    assert main(["gap", str(folder), "--out", str(tmp_path / "out"), "--quiet"]) == 2
    told = capsys.readouterr()
    assert told.out == ""
    assert told.err.startswith("torchweather: error: ")
    assert told.err.count("\n") == 1
    for words in said:
        assert words in told.err
    assert {path: path.lstat().st_mtime_ns for path in tmp_path.rglob("*")} == before


def test_the_same_study_whole_is_searched(folder: Path, tmp_path: Path) -> None:
    with pytest.raises(SearchBegun):
        main(["gap", str(folder), "--out", str(tmp_path / "out"), "--quiet"])


@pytest.mark.parametrize("change", [value("sensor", "overrides", "intensity_unit", to="none"), None])
def test_frames_without_intensity_need_a_unit_that_says_so(change: Break | None, folder: Path, tmp_path: Path) -> None:
    array("frames/*-0?-00?.npz", "intensity", np.zeros_like)(folder)
    arguments = ["gap", str(folder), "--out", str(tmp_path / "out"), "--quiet"]
    if change is None:
        assert main(arguments) == 2
    else:
        change(folder)
        with pytest.raises(SearchBegun):
            main(arguments)
