"""The folder of a study: ``study.yaml`` and ``.npz`` files, read without trust and written whole."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path, PureWindowsPath
from typing import Any

from torchweather.core.errors import TorchweatherError, check_one_of
from torchweather.core.schema import (
    ANY,
    MAPPING,
    NUMBER,
    ROWS,
    TEXT,
    check_format,
    check_keys,
    check_value,
    field_keys,
    one_of,
)
from torchweather.core.yaml_file import dump_yaml, read_yaml
from torchweather.gap.sensors.all import KINDS
from torchweather.gap.study.conditions import Condition, StudyContent, StudySensor
from torchweather.gap.study.content_hash import plain
from torchweather.gap.study.frames import Frame, Frames, NpzFile
from torchweather.gap.study.kinds import StudyKind
from torchweather.gap.study.parts import CLEAR, WEATHERS
from torchweather.io import atomic_folder
from torchweather.io.arrays import write_archive

__all__ = ["FORMAT", "STUDY_FILE", "StudyValues", "read_values", "write_folder"]

FORMAT = "torchweather-study/1"
STUDY_FILE = "study.yaml"
KEYS = {"format": TEXT, "sensor": MAPPING.needed, "scenes": ROWS, "conditions": ROWS, "links": ANY, "series": ANY}
OF_ANY = {"kind": one_of(KINDS).needed, "links": ANY}
OF_SENSOR = {**OF_ANY, "preset": ANY, "overrides": MAPPING.or_null, "beams": ANY}
# A file of a hundred thousand frames has a tenth of it.
MOST_BYTES = 64 * 2**20
SERIES = "series"


@dataclass(frozen=True)
class StudyValues:
    """Values of ``study.yaml``, with the sensor built and each file found.

    Args:
        owner: path of ``study.yaml``, for messages.
        kind: of the sensor.
        sensor: ``None`` for links.
        beams, links: files.
        scenes, conditions: as ``Study.from_arrays`` takes them, with files for frames.
    """

    owner: str
    kind: str
    sensor: StudySensor | None
    beams: NpzFile | None
    links: NpzFile | None
    scenes: list[dict[str, Any]]
    conditions: list[dict[str, Any]]


# ---- reading ---------------------------------------------------------------------------------------------------------


def read_values(folder: Path) -> StudyValues:
    """Values of the folder's ``study.yaml``; every path lies inside the folder and is a file."""
    path = folder / STUDY_FILE
    owner, values = str(path), read_yaml(path, "a study", max_bytes=MOST_BYTES)
    check_format(values, FORMAT, owner, "a study")
    check_keys(values, KEYS, owner)
    sensor = values["sensor"]
    without = sensor.get("kind") in [name for name, kind in KINDS.items() if kind.sensor_class is None]
    check_keys(sensor, OF_ANY if without else OF_SENSOR, owner, "sensor")
    kind = KINDS[sensor["kind"]]
    files = _Files(folder, owner)
    links = {"sensor.links": sensor.get("links"), "links": values.get("links")}
    given = {key: value for key, value in links.items() if value is not None}
    if len(given) > 1:
        raise TorchweatherError(f"{owner}: links stands twice, in sensor and by itself; name it once.")
    return StudyValues(
        owner=owner,
        kind=kind.name,
        sensor=_sensor(sensor, kind, owner),
        beams=None if sensor.get("beams") is None else files.one(sensor["beams"], "sensor.beams"),
        links=next((files.one(value, key) for key, value in given.items()), None),
        scenes=[
            {
                **row,
                "clear": files.several(row.get("clear"), f"scenes[{place}].clear"),
                "geometry": None
                if row.get("geometry") is None
                else files.one(row["geometry"], f"scenes[{place}].geometry"),
            }
            for place, row in enumerate(values.get("scenes", []))
        ],
        conditions=_conditions(values, kind, files, owner),
    )


def _conditions(values: Mapping[str, Any], kind: StudyKind, files: _Files, owner: str) -> list[dict[str, Any]]:
    rows, rel_sd_key = values.get("conditions", []), kind.rel_sd_key
    for place, row in enumerate(rows):
        if rel_sd_key:
            check_value(row.get(rel_sd_key), NUMBER.or_null, owner, f"conditions[{place}].{rel_sd_key}")
        if "rel_sd" in row:
            known = rel_sd_key or f"{' or '.join(sorted({spread for _, spread in WEATHERS.values()}))} of weather"
            raise TorchweatherError(f"{owner}: unknown key 'conditions[{place}].rel_sd'; in a file it is {known}.")
    built = [
        # A key without a value counts as absent.
        {
            **{"rel_sd" if key == rel_sd_key else key: value for key, value in row.items() if value is not None},
            "frames": files.several(row.get("frames"), f"conditions[{place}].frames"),
        }
        for place, row in enumerate(rows)
    ]
    if values.get(SERIES) is None:
        return built
    if kind.has_scenes or built:
        raise TorchweatherError(
            f"{owner}: series is the one condition of a study of links; this one is {kind.name} with {len(built)} "
            "conditions. Name the file in conditions."
        )
    return [{"id": SERIES, "frames": [files.one(values[SERIES], SERIES)]}]


@dataclass(frozen=True)
class _Files:
    """The files of a folder, by the paths of its ``study.yaml``."""

    folder: Path
    owner: str

    def one(self, text: Any, key: str) -> NpzFile:
        """A file that lies inside the folder, links followed."""
        if not isinstance(text, str) or not text:
            raise TorchweatherError(f"{self.owner}: {key} must be the path of a .npz file; got {text!r}.")
        windows = PureWindowsPath(text)
        if Path(text).is_absolute() or windows.drive or windows.root:
            raise TorchweatherError(
                f"{self.owner}: {key} must be a path relative to the study's folder; got the absolute {text!r}."
            )
        try:
            found = (self.folder / text).resolve()
            inside = found.is_relative_to(self.folder.resolve())
            there = inside and found.is_file()
        except (OSError, ValueError, RuntimeError) as error:  # loops of links, names that no file can have
            raise TorchweatherError(f"{self.owner}: {key}: {text!r} cannot be a file ({error}).") from error
        if not inside:
            raise TorchweatherError(
                f"{self.owner}: {key} must stay inside the study's folder; {text!r} leads out of it. Copy the file in."
            )
        if not there:
            raise TorchweatherError(f"{self.owner}: {key}: {self.folder / text}: no such file.")
        return NpzFile(found)

    def several(self, texts: Any, key: str) -> list[NpzFile]:
        """Files of a list."""
        if not isinstance(texts, list):
            raise TorchweatherError(f"{self.owner}: {key} must be a list of .npz files; got {texts!r}.")
        return [self.one(text, f"{key}[{place}]") for place, text in enumerate(texts)]


def _sensor(values: Mapping[str, Any], kind: StudyKind, owner: str) -> StudySensor | None:
    preset, overrides = values.get("preset"), values.get("overrides") or {}
    sensor = kind.sensor_class
    if sensor is None:
        return None
    known = {name: key for name, key in field_keys(sensor).items() if name != "directions"}
    check_keys(overrides, known, owner, "sensor.overrides")
    try:
        if preset is None:
            return sensor.from_dict(overrides)
        check_one_of("preset", preset, sensor.presets(), owner=sensor)
        return sensor.preset(str(preset), **overrides)
    except (TypeError, ValueError) as error:
        raise TorchweatherError(f"{owner}: sensor: {error}") from error


# ---- writing ---------------------------------------------------------------------------------------------------------


def write_folder(study: StudyContent, folder: Path) -> None:
    """Write ``study.yaml`` and one ``.npz`` file per frame; nothing is left where it fails."""
    if folder.is_dir() and any(folder.iterdir()):
        raise TorchweatherError(f"{folder}: expected a new or an empty folder; it holds files. Choose another one.")
    with atomic_folder(folder) as unfinished:
        (unfinished / "frames").mkdir()
        write = _Writer(unfinished)
        sensor: dict[str, Any] = {"kind": study.kind}
        if study.sensor is not None:
            sensor |= _preset_and_overrides(study.sensor)
        if study.beams:
            sensor["beams"] = write.one(study.beams, "beams.npz")
        if study.links:
            sensor["links"] = write.one(study.links, "links.npz")
        values: dict[str, Any] = {"format": FORMAT, "sensor": sensor}
        if study.scenes:
            values["scenes"] = [
                {
                    "id": scene.id,
                    "clear": write.several(scene.clear, f"scene-{place:02d}"),
                    **(
                        {"geometry": write.one(scene.geometry, f"frames/scene-{place:02d}-geometry.npz")}
                        if scene.geometry
                        else {}
                    ),
                }
                for place, scene in enumerate(study.scenes.values())
            ]
        values["conditions"] = [
            _condition_values(one, KINDS[study.kind], write.several(one.frames, f"condition-{place:02d}"))
            for place, one in enumerate(study.conditions)
        ]
        (unfinished / STUDY_FILE).write_text(dump_yaml(values), encoding="utf-8")


@dataclass(frozen=True)
class _Writer:
    """Writes frames into a folder and gives their paths."""

    folder: Path

    def one(self, frame: Frame, name: str) -> str:
        write_archive(self.folder / name, frame, compressed=True)
        return name

    def several(self, frames: Frames, stem: str) -> list[str]:
        return [self.one(frame, f"frames/{stem}-{place:03d}.npz") for place, frame in enumerate(frames)]


def _condition_values(one: Condition, kind: StudyKind, frames: Sequence[str]) -> dict[str, Any]:
    values: dict[str, Any] = {"id": one.id}
    if one.scene:
        values["scene"] = one.scene
    if one.weather is not None:
        values["weather"] = plain(one.weather.to_dict())
        if one.rel_sd:
            values["weather"][WEATHERS[one.weather.kind][1]] = one.rel_sd
    elif one.scene:
        values["weather"] = {"kind": CLEAR}
    elif one.rel_sd:
        values[kind.rel_sd_key] = one.rel_sd
    values["frames"] = list(frames)
    if one.time_s is not None:
        values["time_s"] = one.time_s.tolist()
    values["split"] = one.split
    for name in ("ego_speed_m_per_s", "exposure_s", "exposure_gain"):
        if getattr(one, name) is not None:
            values[name] = getattr(one, name)
    if one.airlight is not None:
        values["airlight"] = list(one.airlight)
    return values


def _preset_and_overrides(sensor: StudySensor) -> dict[str, Any]:
    """The preset with the fewest other fields, and those fields."""
    mine = plain({key: value for key, value in sensor.to_dict().items() if key != "directions"})
    choices = []
    for name in sensor.presets():
        preset = plain(sensor.preset(name).to_dict())
        choices.append((name, {key: value for key, value in mine.items() if value != preset[key]}))
    name, overrides = min(choices, key=lambda choice: len(choice[1]))
    if type(sensor).preset(name, **overrides) != sensor:  # fields that follow from others, such as a camera's centre
        overrides = mine
    return {"preset": name, "overrides": overrides}
