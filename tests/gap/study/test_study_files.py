"""The folder of a study: round trips, and files that are broken, hostile or elsewhere."""

from __future__ import annotations

import contextlib
import copy
import io
import os
import pickle
import zipfile
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from tests.gap.studies import KINDS, SENSORS, arguments, lidar_frame, links, series, study
from torchweather.atmosphere.weather import Fog, Rain
from torchweather.core.errors import TorchweatherError
from torchweather.gap.study.study import Study
from torchweather.sensors import Camera

every_kind = pytest.mark.parametrize("kind", KINDS)
EditYaml = Callable[[dict[str, Any]], None]


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A LiDAR study on disk."""
    study("lidar", clear=2, frames=2).write(tmp_path / "study")
    return tmp_path / "study"


def edit(folder: Path, change: EditYaml) -> None:
    path = folder / "study.yaml"
    values = yaml.safe_load(path.read_text())
    change(values)
    path.write_text(yaml.safe_dump(values))


def read_all(folder: Path) -> None:
    found = Study.read(folder)
    for frames in (*(one.clear for one in found.scenes.values()), *(one.frames for one in found.conditions)):
        assert all(frames)


def refused(folder: Path, message: str) -> None:
    with pytest.raises(TorchweatherError, match=f"(?s){message}"):
        read_all(folder)


# ---- round trips -----------------------------------------------------------------------------------------------------


@every_kind
def test_what_is_written_is_read_back_exactly(kind: str, tmp_path: Path) -> None:
    before = study(kind)
    if kind == "camera":
        lit = replace(before.conditions[0], airlight=(0.31, 0.33, 0.36), exposure_gain=0.62)
        before = replace(before, conditions=(lit, *before.conditions[1:]))
    before.write(tmp_path / "study")
    after = Study.read(tmp_path / "study")
    assert after.sha256 == before.sha256
    assert after.sensor == before.sensor
    assert (after.kind, list(after.scenes)) == (before.kind, list(before.scenes))
    for one, two in zip(before.conditions, after.conditions, strict=True):
        stated = ("id", "scene", "weather", "rel_sd", "split")
        for name in (*stated, "ego_speed_m_per_s", "exposure_s", "airlight", "exposure_gain"):
            assert getattr(one, name) == getattr(two, name), name
        assert np.array_equal(np.array(one.time_s), np.array(two.time_s))
        for frame, again in zip(one.frames, two.frames, strict=True):
            for key, array in frame.items():
                assert np.array_equal(array, again[key], equal_nan=True)
                assert (array.dtype, array.shape) == (again[key].dtype, again[key].shape)
    # A second writing gives the same files, byte for byte.
    after.write(tmp_path / "again")
    for file in sorted((tmp_path / "study").rglob("*.*")):
        assert file.read_bytes() == (tmp_path / "again" / file.relative_to(tmp_path / "study")).read_bytes()


@pytest.mark.parametrize("kind", list(SENSORS))
def test_the_file_names_the_nearest_preset_and_the_fields_that_differ(kind: str, tmp_path: Path) -> None:
    study(kind, clear=2, frames=1).write(tmp_path / "study")
    sensor = yaml.safe_load((tmp_path / "study" / "study.yaml").read_text())["sensor"]
    assert sensor["kind"] == kind
    assert sensor["preset"] in SENSORS[kind].presets()
    assert type(SENSORS[kind]).preset(sensor["preset"], **sensor["overrides"]) == SENSORS[kind]
    if kind == "radar":
        assert sensor["overrides"] == {"detection_snr_db": 9.0}


def test_a_camera_whose_centre_is_another_sizes_centre_comes_back(tmp_path: Path) -> None:
    preset = Camera.preset("lucid-triton")
    camera = Camera.preset("lucid-triton", width=6, height=4, cx=preset.cx)
    Study.from_arrays(**{**arguments("camera", clear=2, frames=1), "sensor": camera}).write(tmp_path / "study")
    assert Study.read(tmp_path / "study").sensor == camera


def test_every_field_of_a_weather_comes_back(tmp_path: Path) -> None:
    values = arguments("lidar", clear=2, frames=1)
    rain = Rain(25.0, close_rate=True, temperature_c=4.0, wind_m_per_s=(1.0, -2.0, 0.5))
    values["conditions"] = [
        {"id": "c0", "scene": "s0", "weather": rain, "frames": [lidar_frame(np.random.default_rng(0))]},
        {"id": "c1", "scene": "s0", "weather": Fog(float("inf")), "frames": [lidar_frame(np.random.default_rng(1))]},
    ]
    Study.from_arrays(**values).write(tmp_path / "study")
    assert [one.weather for one in Study.read(tmp_path / "study").conditions] == [rain, Fog(float("inf"))]


def test_the_specification_s_own_example_is_read(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    (tmp_path / "frames").mkdir()
    given_values = arguments("lidar", clear=2, frames=1)
    np.savez(tmp_path / "beams.npz", **given_values["beams"])
    for name in ("s0-000", "s0-001", "c00-000", "c00-001"):
        np.savez(tmp_path / "frames" / f"{name}.npz", **lidar_frame(rng))
    np.savez(tmp_path / "frames" / "s0-geometry.npz", **given_values["scenes"][0]["geometry"])
    (tmp_path / "study.yaml").write_text(
        """format: torchweather-study/1
sensor: {kind: lidar, preset: ouster-os1-128, overrides: {range_at_10_percent_m: 40.0}, beams: beams.npz}
scenes:
  - {id: s0, clear: [frames/s0-000.npz, frames/s0-001.npz], geometry: frames/s0-geometry.npz}
conditions:
  - id: c00
    scene: s0
    weather: {kind: rain, rate_mm_per_h: 25.0, rate_rel_sd: 0.1}
    frames: [frames/c00-000.npz, frames/c00-001.npz]
    time_s: [0.0, 0.1]
    split: fit
"""
    )
    found = Study.read(tmp_path)
    assert found.conditions[0].weather == Rain(25.0)
    assert found.conditions[0].rel_sd == 0.1
    assert found.scenes["s0"].geometry["up"].shape == (4, 6)
    assert found.sensor is not None
    assert found.sensor.to_dict()["range_at_10_percent_m"] == 40.0


@pytest.mark.parametrize(
    "text",
    [
        "sensor: {kind: link}\nlinks: links.npz\nseries: series.npz\n",
        "sensor: {kind: link, links: links.npz}\nseries: series.npz\n",
        "sensor: {kind: link, links: links.npz}\nconditions: [{id: series, frames: [series.npz]}]\n",
    ],
)
def test_links_are_named_in_the_sensor_or_beside_it(tmp_path: Path, text: str) -> None:
    rng = np.random.default_rng(0)
    np.savez(tmp_path / "links.npz", **links(rng))
    np.savez(tmp_path / "series.npz", **series(rng))
    (tmp_path / "study.yaml").write_text("format: torchweather-study/1\n" + text)
    assert Study.read(tmp_path).sha256 == study("link").sha256


def test_aliases_as_safe_dump_writes_them_for_shared_values_are_read(folder: Path) -> None:
    def share(values: dict[str, Any]) -> None:
        values["conditions"][0]["weather"] = values["conditions"][4]["weather"]

    edit(folder, share)
    assert "&id001" in (folder / "study.yaml").read_text()
    found = Study.read(folder)
    assert found.conditions[0].weather == found.conditions[4].weather


def test_frames_are_read_when_asked_for_and_not_kept(folder: Path) -> None:
    found = Study.read(folder)
    first = found.conditions[0].frames[0]
    path = folder / "frames" / "condition-00-000.npz"
    np.savez(path, range_m=np.full((4, 6), 7.0), intensity=np.zeros((4, 6)))
    assert first["range_m"][0, 0] != 7.0
    assert found.conditions[0].frames[0]["range_m"][0, 0] == 7.0
    path.unlink()
    with pytest.raises(TorchweatherError, match=r"condition-00-000\.npz"):
        found.conditions[0].frames[0]


# ---- writing whole or not at all -------------------------------------------------------------------------------------


def test_a_folder_that_holds_something_is_not_written_to(folder: Path, tmp_path: Path) -> None:
    before = sorted(folder.rglob("*"))
    with pytest.raises(TorchweatherError, match="expected a new or an empty folder"):
        study("lidar", clear=2, frames=2).write(folder)
    assert sorted(folder.rglob("*")) == before
    (tmp_path / "file").write_text("")
    with pytest.raises(TorchweatherError, match="expected a folder to write to; got a file"):
        study("lidar", clear=2, frames=2).write(tmp_path / "file")


def test_nothing_is_left_of_a_study_whose_frame_breaks_while_it_is_written(folder: Path, tmp_path: Path) -> None:
    found = Study.read(folder)
    (folder / "frames" / "condition-04-001.npz").write_bytes(b"PK")
    with pytest.raises(TorchweatherError, match="condition-04-001"):
        found.write(tmp_path / "deep" / "copy")
    assert sorted(path.name for path in tmp_path.iterdir()) == ["study"]


# ---- files that are broken, hostile or elsewhere ---------------------------------------------------------------------


def set_in(*path: Any, to: Any) -> EditYaml:
    def change(values: dict[str, Any]) -> None:
        place: Any = values
        for key in path[:-1]:
            place = place[key]
        if to is ...:
            del place[path[-1]]
        else:
            place[path[-1]] = to

    return change


BROKEN = [
    (set_in("format", to="torchweather-study/2"), r"study.yaml: format must be 'torchweather-study/1'; got 'torchw"),
    (set_in("sensro", to={}), r"study.yaml: unknown key 'sensro'.*Did you mean 'sensor'"),
    (set_in("sensor", to="lidar"), r"sensor must be keys with values"),
    (set_in("sensor", "kind", to="lidr"), r"sensor.kind must be one of.*Did you mean 'lidar'"),
    (set_in("sensor", "kind", to="camera"), r"study.yaml: unknown key 'sensor.overrides"),
    (set_in("sensor", "preset", to="ouster-os1-129"), r"preset must be one of.*Did you mean 'ouster-os1-128'"),
    (set_in("sensor", "presets", to="x"), r"unknown key 'sensor.presets'.*Did you mean 'preset'"),
    (set_in("sensor", "overrides", to={"max_rang_m": 3}), r"'sensor.overrides.max_rang_m'.*Did you mean 'max_range_m'"),
    (set_in("sensor", "overrides", to={"directions": [1]}), r"unknown key 'sensor.overrides.directions'"),
    (set_in("sensor", "overrides", to={"wavelength_nm": -1}), r"study.yaml: sensor: Lidar: wavelength_nm must lie"),
    (set_in("sensor", "overrides", to=[1]), r"sensor.overrides must be keys with values"),
    (set_in("sensor", "beams", to=...), r"study.yaml: beams is missing"),
    (set_in("scenes", to={"s0": 1}), r"scenes must be a list of entries with keys; got"),
    (set_in("scenes", 0, "clear", to="frames/scene-00-000.npz"), r"scenes\[0\].clear must be a list of .npz files"),
    (set_in("scenes", 0, "clear", 1, to="frames/none.npz"), r"scenes\[0\].clear\[1\]: .*none.npz: no such file"),
    (set_in("scenes", 0, "clear", 1, to="frames"), r"clear\[1\]: .*frames: no such file"),
    (set_in("scenes", 0, "clear", 1, to=None), r"clear\[1\] must be the path of a .npz file; got None"),
    (
        set_in("scenes", 0, "clear", 1, to="../study/frames/scene-00-000.npz/../../../x"),
        r"must stay inside|no such file",
    ),
    (set_in("scenes", 0, "clear", 1, to="../../etc/passwd"), r"clear\[1\] must stay inside the study's folder"),
    (set_in("scenes", 0, "clear", 1, to="/etc/passwd"), r"clear\[1\] must be a path relative.*got the absolute"),
    (set_in("scenes", 0, "clear", 1, to="C:\\x.npz"), r"clear\[1\] must be a path relative"),
    (set_in("scenes", 0, "clear", 1, to="a\0b"), r"clear\[1\]: 'a\\x00b' cannot be a file"),
    (set_in("scenes", 0, "geometry", to="../g.npz"), r"scenes\[0\].geometry must stay inside"),
    (set_in("sensor", "beams", to="../beams.npz"), r"sensor.beams must stay inside"),
    (set_in("conditions", 2, "frames", 0, to="../../x.npz"), r"conditions\[2\].frames\[0\] must stay inside"),
    (set_in("conditions", 2, "frames", to=...), r"conditions\[2\].frames must be a list"),
    (set_in("conditions", 2, "weather", to=...), r"conditions\[2\].weather is missing"),
    (set_in("conditions", 2, "weather", to=None), r"conditions\[2\].weather is missing"),
    (set_in("conditions", 2, "rel_sd", to=0.1), r"conditions\[2\].rel_sd'; in a file it is mor_rel_sd or rate_rel_sd"),
    (set_in("conditions", 2, "scene", to="s9"), r"conditions\[2\].scene must be one of s0, s1; got 's9'"),
    (set_in("conditions", 2, "time_s", to=[1.0]), r"conditions\[2\].time_s must have one value in seconds for each"),
    (set_in("series", to="beams.npz"), r"series is the one condition of a study of links; this one is lidar"),
    (set_in("links", to="beams.npz"), r"links belongs to a study of kind link"),
]


@pytest.mark.parametrize(("change", "message"), BROKEN, ids=[message for _, message in BROKEN])
def test_a_broken_study_is_refused_with_file_and_key(folder: Path, change: EditYaml, message: str) -> None:
    edit(folder, change)
    refused(folder, message)


def test_a_missing_folder_and_a_missing_file_are_told() -> None:
    refused(Path("no/such"), r"no/such/study\.yaml: no such file")


def test_a_link_out_of_the_folder_is_refused_and_one_inside_is_read(folder: Path, tmp_path: Path) -> None:
    outside = tmp_path / "outside.npz"
    np.savez(outside, **lidar_frame(np.random.default_rng(0)))
    target = folder / "frames" / "condition-00-000.npz"
    target.unlink()
    target.symlink_to(outside)
    refused(folder, r"conditions\[0\].frames\[0\] must stay inside the study's folder")
    target.unlink()
    target.symlink_to(folder / "frames" / "condition-00-001.npz")
    assert np.array_equal(*(frame["range_m"] for frame in Study.read(folder).conditions[0].frames))
    # A link to the folder itself is no way out.
    (tmp_path / "linked").symlink_to(folder)
    assert Study.read(tmp_path / "linked").sha256 == Study.read(folder).sha256


def test_a_link_to_itself_and_a_pipe_are_no_frames(folder: Path) -> None:
    target = folder / "frames" / "condition-00-000.npz"
    target.unlink()
    target.symlink_to(target)
    refused(folder, r"condition-00-000")
    target.unlink()
    os.mkfifo(target)
    refused(folder, r"no such file")


class Runs:
    def __reduce__(self) -> Any:
        return os.mkdir, ("was-run",)


def npy(array: Any, **more: Any) -> bytes:
    held = io.BytesIO()
    np.save(held, array, **more)
    return held.getvalue()


def frame_contents() -> dict[str, tuple[bytes, str]]:
    """Bytes of the array range_m, and what is said."""
    header = b"{'descr': '<f8', 'fortran_order': False, 'shape': (400000, 600000), }"
    padded = header.ljust(118 - 1) + b"\n"
    huge = b"\x93NUMPY\x01\x00" + len(padded).to_bytes(2, "little") + padded + b"\0" * 64
    return {
        "pickled": (npy(np.array([Runs()], dtype=object), allow_pickle=True), "cannot be read.*pickled"),
        "bare pickle": (pickle.dumps(Runs()), "cannot be read"),
        "truncated": (npy(np.ones((4, 6)))[:-40], "truncated|cannot hold|cannot be read"),
        "huge": (huge, r"needs 1920000000000 bytes"),
        "text": (npy(np.full((4, 6), "x")), "range_m must be real numbers"),
        "dates": (npy(np.zeros((4, 6), "datetime64[s]")), "range_m must be real numbers"),
        "complex": (npy(np.zeros((4, 6), complex)), "range_m must be real numbers"),
        "structured": (npy(np.zeros((4, 6), [("a", "f4")])), "range_m must be real numbers"),
    }


@pytest.mark.parametrize("case", list(frame_contents()))
def test_a_hostile_frame_is_refused_by_name_and_nothing_of_it_runs(
    folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, case: str
) -> None:
    monkeypatch.chdir(tmp_path)
    content, message = frame_contents()[case]
    path = folder / "frames" / "condition-00-000.npz"
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("range_m.npy", content)
        archive.writestr("intensity.npy", npy(np.ones((4, 6))))
    refused(folder, rf"condition-00-000\.npz.*({message})")
    assert not (tmp_path / "was-run").exists()


def test_a_file_that_is_no_archive_is_refused_by_name(folder: Path) -> None:
    path = folder / "frames" / "condition-00-000.npz"
    whole = path.read_bytes()
    for content in (b"", b"no zip", whole[: len(whole) // 2], npy(np.ones(3))):
        path.write_bytes(content)
        refused(folder, r"condition-00-000\.npz: expected arrays as numpy.savez writes them")


# ---- YAML ------------------------------------------------------------------------------------------------------------


def bomb() -> str:
    """Aliases of aliases: a few lines that stand for 10^12 values."""
    lines = ["format: torchweather-study/1", "a0: &a0 [x, x, x, x, x, x, x, x, x, x]"]
    lines += [f"a{k}: &a{k} [{', '.join([f'*a{k - 1}'] * 10)}]" for k in range(1, 12)]
    return "\n".join([*lines, "sensor: *a11"])


HOSTILE_YAML = {
    "bomb": (bomb(), "aliases unfold into more"),
    "merge bomb": (bomb().replace("sensor: *a11", "sensor: {<<: *a11}"), "aliases unfold into more"),
    "itself": ("format: torchweather-study/1\nsensor: &s {kind: *s}", "an alias holds itself"),
    "object": ("format: !!python/object/apply:os.mkdir [was-run]", "is none of plain values"),
    "name": ("format: !!python/name:os.system", "is none of plain values"),
    "twice": ("format: torchweather-study/1\nsensor: {kind: lidar, kind: radar}", "the key 'kind' stands twice"),
    "two documents": ("format: torchweather-study/1\n---\na: 1", "expected a single document"),
    "deep": ("[" * 5_000, "nested more than 50 levels deep"),
    "list as key": ("? [1, 2]\n: 3", "a key must be text"),
    "empty": ("", "format must be"),
    "text": ("hello", "format must be.*got 'str'"),
    "tabs": ("a:\n\t- 1", "cannot be read"),
    "date out of range": ("format: 2020-99-99", "is no date"),
}


@pytest.mark.parametrize("case", list(HOSTILE_YAML))
def test_hostile_yaml_is_refused_at_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, case: str) -> None:
    monkeypatch.chdir(tmp_path)
    text, message = HOSTILE_YAML[case]
    (tmp_path / "study.yaml").write_text(text)
    refused(tmp_path, rf"study\.yaml: .*({message})")
    assert not (tmp_path / "was-run").exists()


def test_yaml_that_is_no_text_is_refused(tmp_path: Path) -> None:
    (tmp_path / "study.yaml").write_bytes(b"\xff\xfe\x00format")
    refused(tmp_path, r"study\.yaml: expected YAML with a study; it cannot be read")


VALUES = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=6),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=6), inner, max_size=3),
    max_leaves=6,
)


@settings(max_examples=60, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(data=st.data())
def test_whatever_stands_in_the_file_gives_a_study_or_one_clear_error(folder: Path, data: st.DataObject) -> None:
    """One value of a good file is replaced by anything."""
    path = folder / "study.yaml"
    kept = path.read_text()
    values = yaml.safe_load(kept)
    place: Any = values
    while True:
        keys = list(place) if isinstance(place, dict) else list(range(len(place)))
        key = data.draw(st.sampled_from(keys))
        if isinstance(place[key], (dict, list)) and place[key] and data.draw(st.booleans()):
            place = place[key]
        else:
            break
    place[key] = data.draw(VALUES)
    try:
        path.write_text(yaml.safe_dump(copy.deepcopy(values), allow_unicode=True), encoding="utf-8")
        with contextlib.suppress(TorchweatherError):
            Study.read(folder)
    finally:
        path.write_text(kept)
