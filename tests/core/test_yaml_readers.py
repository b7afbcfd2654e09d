"""Every reader of YAML against every attack: each is refused with the file and the key, or the line."""

from __future__ import annotations

import io
import zipfile
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from torchweather.core.errors import TorchweatherError
from torchweather.core.yaml_file import MAX_ALIASED, parse_json, parse_yaml, read_yaml
from torchweather.datasets import read_camera
from torchweather.evaluation.robustness import read_declaration
from torchweather.gap import Study
from torchweather.gap.model_file import read_model
from torchweather.io import read_sensor_pose
from torchweather.io.map_layout import map_layout
from torchweather.lidar.effects.all import LidarWindowLoss
from torchweather.pipeline.chain import Chain
from torchweather.recipes import load_recipe
from torchweather.sensors import Camera

HOLE = "@"


@dataclass(frozen=True)
class Reader:
    """How one kind of file is read.

    Args:
        read: of the package.
        text: a good file, with a hole where a number is expected.
        number: that fills the hole.
        key: dotted key of the hole.
        file: name of the file.
        foreign: other programs write it: keys that are not used are no error.
    """

    read: Callable[[Path], Any]
    text: str
    number: str
    key: str
    file: str = "mine.yaml"
    foreign: bool = False

    def write(self, folder: Path, text: str) -> Path:
        """A file of this kind with a text."""
        path = folder / self.file
        if self.file.endswith(".zip"):
            state = io.BytesIO()
            arrays = Chain({"window_loss": LidarWindowLoss(loss_db=3.0)}).state_dict()
            np.savez(state, **{key: value.numpy() for key, value in arrays.items()})
            with zipfile.ZipFile(path, "w") as archive:
                archive.writestr("chain.yaml", text)
                archive.writestr("state.npz", state.getvalue())
        else:
            path.write_text(text)
        return path


CAMERA = "{kind: camera, preset: lucid-triton}"
RECIPE = "format: torchweather-recipe/2\ntitle: mine\n"
STUDY = (
    "format: torchweather-study/1\nsensor: {kind: link}\n"
    "conditions:\n- {id: a, rain_rel_sd: @, frames: [a.npz]}\nlinks: a.npz\n"
)
MATRIX = "[[1.0, 0.0, 0.0, @], [0.0, 1.0, 0.0, 0.0], [0.0, 0.0, 1.0, 2.0]]"


def study(path: Path) -> Any:
    """A study of links, whose files are there."""
    split = np.array([0, 0])
    of_links: dict[str, Any] = {
        "length_km": np.ones(2),
        "frequency_ghz": np.full(2, 20.0),
        "polarisation": split,
        "split": split,
    }
    np.savez(path.parent / "a.npz", **of_links)
    return Study.read(path.parent)


READERS = {
    "transform": Reader(
        load_recipe,
        f"{RECIPE}kind: transform\ntransform: BayerFog\nsensor: {CAMERA}\n"
        "weather: {kind: fog, mor_m: @, size_distribution: advection}\n",
        "50.0",
        "weather.mor_m",
    ),
    "multi_sensor": Reader(
        load_recipe,
        f"{RECIPE}kind: multi_sensor\nweather: {{kind: fog, mor_m: 50.0}}\np: @\n"
        f"transforms: {{image: {{transform: BayerFog, sensor: {CAMERA}}}}}\n",
        "0.5",
        "p",
    ),
    "suite": Reader(
        load_recipe,
        f"{RECIPE}kind: suite\nsensor: {{kind: camera}}\nweathers: {{fog: {{mor_m: [@, 400.0, 300.0, 200.0, 100]}}}}\n",
        "500.0",
        "weathers.fog.mor_m[0]",
    ),
    "study": Reader(study, STUDY, "0.1", "conditions[0].rain_rel_sd", "study.yaml"),
    "declaration": Reader(
        read_declaration,
        "format: torchweather-detector/1\ntitle: cars\nsensor: camera\ninput: {name: images, scale: @}\n"
        "decoder: boxes\noutputs: {boxes: b, scores: s}\nclasses: {0: car}\n",
        "1.0",
        "input.scale",
    ),
    "sensor": Reader(lambda path: Camera.preset(str(path)), "preset: kitti\nheight_m: @\n", "1.5", "height_m"),
    "chain": Reader(
        Chain.load,
        "format: torchweather-chain/1\nstages:\n- {name: window_loss, stage: LidarWindowLoss, loss_db: @}\n",
        "3.0",
        "stages[0].loss_db",
        "chain.zip",
    ),
    "model": Reader(
        read_model,
        "format: torchweather-model/1\neffects:\n- {effect: lidar.window_loss, loss_db: @}\n",
        "3.0",
        "effects[0].loss_db",
    ),
    "pose": Reader(
        read_sensor_pose, f"T_cloud_from_sensor: {MATRIX}\n", "1.5", "T_cloud_from_sensor[0][3]", foreign=True
    ),
    "calibration": Reader(
        read_camera,
        "image_width: 640\nimage_height: 480\nK: [@, 0.0, 320.0, 0.0, 500.0, 240.0, 0.0, 0.0, 1.0]\n",
        "500.0",
        "K[0]",
        foreign=True,
    ),
    "layout": Reader(
        lambda path: map_layout(str(path)),
        "dims: [range]\nscale: db\nrange_m: {first: @, step: 0.2}\n",
        "0.1",
        "range_m.first",
    ),
}
BOMB = "\n".join(
    ["b0: &b0 [x, x, x, x, x, x, x, x, x, x]"]
    + [f"b{k}: &b{k} [{', '.join([f'*b{k - 1}'] * 10)}]" for k in range(1, 12)]
)
# What fills the hole, and the refusal; each has the whole key of the hole.
VALUES = {
    "integer of 30 digits": ("1" * 30, "64 bits at most; got 30 digits"),
    "integer of 400 digits": ("1" * 400, "64 bits at most; got 400 digits"),
    "integer beyond Python's limit": ("1" * 5_000, "64 bits at most; got 5000 digits"),
    "number of 400 digits": ("1" * 400 + ".0", "expected a number; got 111"),
    "no date": ("2024-13-45", "'2024-13-45' is no date"),
    "object": ("!!python/object/apply:os.mkdir [was-run]", "the tag !!python/object/apply:os.mkdir"),
    "name": ("!!python/name:os.system ''", "the tag !!python/name:os.system"),
    "binary": ("!!binary aGVsbG8=", "the tag !!binary"),
    "deep": ("[" * 5_000, "nested more than 50 levels deep"),
    "integer of no digits": ("!!int ''", "'' is no int"),
    "itself": ("&s {a: *s}", "an alias holds itself"),
    "twice inside": ("{a: 1, a: 2}", "the key 'a' stands twice"),
    "key of no text": ("{no: 1}", "a key must be text; got 'no'"),
    "list as key": ("{? [1] : 2}", "a key must be text; got a list"),
}
# Values that a reader of YAML takes and its file does not: the last name of the key is enough.
WRONG = {"date": "2024-12-31", "text": "many", "NaN": ".nan", "mapping": "{a: 1.0}", "time": "10:30"}


def refused(reader: Reader, folder: Path, text: str) -> str:
    path = reader.write(folder, text)
    with pytest.raises(TorchweatherError) as caught:
        reader.read(path)
    assert str(path) in str(caught.value)
    return str(caught.value)


@pytest.fixture(params=list(READERS))
def reader(request: pytest.FixtureRequest) -> Reader:
    return READERS[request.param]


def test_the_good_file_is_read(reader: Reader, tmp_path: Path) -> None:
    """Otherwise an attack could be refused for another reason."""
    assert reader.read(reader.write(tmp_path, reader.text.replace(HOLE, reader.number))) is not None


@pytest.mark.parametrize("attack", list(VALUES))
def test_a_hostile_value_is_refused_with_file_and_key(
    reader: Reader, attack: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    value, said = VALUES[attack]
    message = refused(reader, tmp_path, reader.text.replace(HOLE, value))
    assert said in message
    assert f": {reader.key}" in message
    assert not (tmp_path / "was-run").exists()


@pytest.mark.parametrize("wrong", list(WRONG))
def test_a_value_of_the_wrong_type_is_refused_with_file_and_key(reader: Reader, wrong: str, tmp_path: Path) -> None:
    message = refused(reader, tmp_path, reader.text.replace(HOLE, WRONG[wrong]))
    name = reader.key.rpartition(".")[2].partition("[")[0]
    assert (name if name != "K" else "camera matrix") in message


def test_a_hostile_file_is_refused_with_key_or_line(reader: Reader, tmp_path: Path) -> None:
    good = reader.text.replace(HOLE, reader.number)
    first = good.partition(":")[0]
    assert f": {first}: " in (message := refused(reader, tmp_path, f"{good}{first}: 1\n"))
    assert f"the key {first!r} stands twice (line " in message
    message = refused(reader, tmp_path, f"{good}{BOMB}\nb: *b11\n")
    assert f"aliases unfold into more than {MAX_ALIASED} values" in message
    assert ": b" in message
    assert "aliases unfold" in refused(reader, tmp_path, f"{good}{BOMB}\nb: {{<<: {{a: *b11}}}}\n")
    chain = "\n".join(["c0: &c0 [x]", *(f"c{k}: &c{k} [*c{k - 1}]" for k in range(1, 400))])
    assert "nested more than 50 levels deep" in refused(reader, tmp_path, f"{good}{chain}\n")
    message = refused(reader, tmp_path, f"{good}---\na: 1\n")
    assert "expected a single document" in message
    assert f"(line {good.count(chr(10)) + 1})" in message
    assert "(line " in refused(reader, tmp_path, f"{good}broken: [1,\n")


def test_a_misspelt_key_is_refused_with_the_nearest(reader: Reader, tmp_path: Path) -> None:
    good = reader.text.replace(HOLE, reader.number)
    first = good.partition(":")[0]
    if not reader.foreign:
        assert f"Did you mean '{first}'" in refused(reader, tmp_path, f"{good}{first}x: 1\n")


# Each in the place of every value of a good file.
ANYTHING: tuple[Any, ...] = (
    *(None, 5, True, "x", "", [], {}, [5], [None], {"a": 1}, [{"a": 1}], 1e300, {"kind": "fog"}, {"choice": [5]}),
    *({"kind": "mixture", "parts": [5]}, {"choice": [{"kind": "mixture", "parts": 5}]}, {"uniform": ["a", "b"]}),
)


def places(values: Any) -> Iterator[tuple[Any, Any]]:
    """Every mapping or list in plain values with each of its keys."""
    for key, value in values.items() if isinstance(values, dict) else enumerate(values):
        yield values, key
        if isinstance(value, (dict, list)):
            yield from places(value)


@pytest.mark.filterwarnings("ignore::torchweather.core.errors.TorchweatherWarning")
def test_whatever_stands_in_the_place_of_a_value_is_read_or_refused_with_the_file(
    reader: Reader, tmp_path: Path
) -> None:
    values, refusals = yaml.safe_load(reader.text.replace(HOLE, reader.number)), list[str]()
    for holder, key in list(places(values)):
        kept = holder[key]
        for value in ANYTHING:
            holder[key] = value
            path = reader.write(tmp_path, yaml.safe_dump(values))
            try:
                reader.read(path)
            except TorchweatherError as error:
                refusals.append(str(error))
        holder[key] = kept
    assert [message for message in refusals if str(tmp_path) not in message] == []
    assert len(refusals) > len(ANYTHING)


def test_a_file_that_is_missing_or_no_text_is_named(tmp_path: Path) -> None:
    with pytest.raises(TorchweatherError, match=r"none\.yaml: no such file; expected YAML with a recipe"):
        read_yaml(tmp_path / "none.yaml", "a recipe")
    (tmp_path / "binary.yaml").write_bytes(b"\xff\xfe\x00format")
    with pytest.raises(TorchweatherError, match=r"binary\.yaml: expected YAML with a recipe; it cannot be read"):
        read_yaml(tmp_path / "binary.yaml", "a recipe")
    (tmp_path / "long.yaml").write_text("a: 1\n" * 100)
    with pytest.raises(TorchweatherError, match=r"long\.yaml: .*100 bytes at most; got 500 bytes"):
        read_yaml(tmp_path / "long.yaml", "a recipe", max_bytes=100)


def test_what_is_plain_is_read_as_it_stands() -> None:
    text = "a: &a {x: 1, y: 2.5}\nb: [*a, {<<: *a, y: 3}]\n"
    text += "c: [2024-12-31, '1', 10:30, .inf, ~, true, 0xffffffffffffffff]"
    found = parse_yaml(text, "a.yaml", "values")
    assert found["b"] == [{"x": 1, "y": 2.5}, {"x": 1, "y": 3}]
    assert found["c"] == ["2024-12-31", "1", "10:30", float("inf"), None, True, 2**64 - 1]
    assert found["b"][0] is not found["a"]
    assert parse_yaml("classes: {0: car}", "a.yaml", "values", number_keys=["classes"]) == {"classes": {0: "car"}}
    assert parse_yaml("", "a.yaml", "values") is None


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ('{"a": {"b": 1, "b": 2}}', "the key 'b' stands twice"),
        ("[" * 100_000, "nested too deep"),
        ('{"a": ' + "1" * 400 + "}", "an integer has 400 digits"),
        ('{"a": ', "cannot be read"),
    ],
)
def test_hostile_json_is_refused_with_the_file(text: str, said: str) -> None:
    with pytest.raises(TorchweatherError, match=rf"a\.json: expected JSON with a camera; .*{said}"):
        parse_json(text, "a.json", "a camera")
