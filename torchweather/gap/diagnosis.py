"""What a study lacks, in plain words, and what that costs."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from itertools import chain
from pathlib import PurePath

import numpy as np
import torch

from torchweather.core.errors import check_one_of
from torchweather.gap.study.conditions import Condition
from torchweather.gap.study.content_hash import frame_sha256
from torchweather.gap.study.frames import Frame, Frames
from torchweather.gap.study.simulation import dry_samples
from torchweather.gap.study.splits import condition_group
from torchweather.gap.study.study import Study
from torchweather.lidar.intensity import reflectivity_from_intensity
from torchweather.lidar.sensor import Lidar

__all__ = ["LEVELS", "Finding", "diagnose"]

LEVELS = ("error", "warning", "note")
"""An error: no answer can be trusted. A warning: some answers cannot be given. A note: what more data would tell."""

# GAP.md section 1: advised numbers of frames.
CLEAR_ADVISED, FRAMES_ADVISED = 8, 5
# Depths within a fifth of each other are one depth: light lost on the way differs by less than a tenth where half of it
# is lost (0.5^0.2 = 0.87 of 0.5).
ONE_DEPTH = 1.2
# A path twice as long tells what grows with length from what does not.
SPREAD_OF_LENGTHS = 2.0
# Effects of the catalogue (GAP.md section 2) that show only in the spread between frames, or only in time.
IN_THE_SPREAD = {"lidar": "lidar.patchy_weather", "camera": "camera.patchy_fog", "radar": "radar.fluctuation"}
IN_TIME = {
    "lidar": "a drift of the laser's power passes for lidar.window_loss",
    "camera": "a drift of the exposure passes for camera.exposure_gain",
    "radar": "radar.range_migration, and the drying of radar.wet_radome, cannot be seen",
}
# The darkest calibrated target that is sold (Spectralon) reflects 2 %; half of a scene is never half as dark.
DARKEST = 0.01
SHOWN = 5


@dataclass(frozen=True)
class Finding:
    """Something that a study lacks.

    Args:
        level: ``error``, ``warning`` or ``note``.
        what: what is missing; of an error, with file and key in brackets.
        cost: what that costs.
        advice: what to do.
    """

    level: str
    what: str
    cost: str
    advice: str

    def __post_init__(self) -> None:
        check_one_of("level", self.level, LEVELS, owner=self)

    def __str__(self) -> str:
        return f"{self.level}: {self.what} {self.cost} {self.advice}"


def diagnose(study: Study) -> list[Finding]:
    """What a study lacks, the worst first. Reads every frame once.

    Args:
        study: to look at.

    Returns:
        Findings, sorted by level; empty where nothing is missing.

    Raises:
        TorchweatherError: a frame is broken.

    Note:
        A study with an error is readable; what is computed from it cannot be trusted. A frame differs from the mean of
        n - 1 others by ``sqrt(n / (n - 1))`` of the frames' standard deviation, and n frames give that deviation to
        ``1 / sqrt(2 (n - 1))``.

    Example:
        >>> frames = [{"range_m": np.full((1, 2), r), "intensity": np.array([[0.1, r / 99]])} for r in (9.0, 9.1, 9.2)]
        >>> study = Study.from_arrays(
        ...     sensor="lidar",
        ...     beams={"direction": np.array([[[1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]])},
        ...     scenes=[{"id": "s0", "clear": frames[:1]}],
        ...     conditions=[{"id": "c0", "scene": "s0", "weather": "rain:rate=25", "frames": frames[1:]}],
        ... )
        >>> print(diagnose(study)[0].what)
        The scene s0 has one clear frame (Study.from_arrays: scenes[0].clear).
    """
    if study.kind == "link":
        found: Iterable[Finding] = _of_links(study)
    else:
        clear = {one.id: [_look(study, frame) for frame in one.clear] for one in study.scenes.values()}
        measured = {one.id: [_look(study, frame) for frame in one.frames] for one in study.conditions}
        found = chain(
            _of_clear_frames(study, clear),
            _of_frames(study, measured),
            _of_copies(study, clear, measured),
            _of_weather(study),
            _of_split(study),
            _of_geometry(study),
            _of_signals(study, clear, measured),
        )
    return sorted(found, key=lambda one: LEVELS.index(one.level))


# ---- frames ----------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class _Look:
    """What one look at a frame tells: its hash, how many values are signals, range and median of those, clutter."""

    sha256: str
    signals: int
    low: float
    middle: float
    high: float
    clutter: bool


def _look(study: Study, frame: Frame) -> _Look:
    if study.kind == "lidar":
        values = np.asarray(frame["intensity"])[np.asarray(frame["range_m"]) > 0]
    else:
        values = np.asarray(frame["power_db" if study.kind == "radar" else "bayer"]).reshape(-1)
        values = values[~np.isnan(values)]
    low, middle, high = np.quantile(values, (0.0, 0.5, 1.0)).tolist() if values.size else 3 * (math.nan,)
    return _Look(frame_sha256(frame), int(values.size), low, middle, high, "clutter" in frame)


def _of_clear_frames(study: Study, clear: dict[str, list[_Look]]) -> Iterator[Finding]:
    for name, looks in clear.items():
        n = len(looks)
        if n == 1:
            yield Finding(
                "error",
                f"The scene {name} has one clear frame ({_place(study.scenes[name].clear)}).",
                "How much clear frames differ from each other is unknown, so any difference counts as weather.",
                f"Record {CLEAR_ADVISED} or more clear frames, 2 at least.",
            )
        elif n < CLEAR_ADVISED:
            wider, known = math.sqrt(n / (n - 1)), 1.0 / math.sqrt(2.0 * (n - 1))
            yield Finding(
                "warning",
                f"The scene {name} has {n} clear frames; {CLEAR_ADVISED} or more are advised.",
                f"The floor of any gap is {100 * (wider - 1):.0f} % wider than the frames' own spread, and that spread "
                f"is known to {100 * known:.0f} % only.",
                "Record more clear frames of this scene.",
            )


def _of_frames(study: Study, measured: dict[str, list[_Look]]) -> Iterator[Finding]:
    single = [name for name, looks in measured.items() if len(looks) == 1]
    few = [name for name, looks in measured.items() if 1 < len(looks) < FRAMES_ADVISED]
    advice = f"Record {FRAMES_ADVISED} or more frames of each condition: particles are random."
    if single:
        yield Finding(
            "warning",
            f"{_conditions(single)} one frame.",
            f"The spread between frames is unknown: {IN_THE_SPREAD[study.kind]} cannot be seen, and means are "
            f"uncertain by {math.sqrt(FRAMES_ADVISED):.1f} times as much as with {FRAMES_ADVISED} frames.",
            advice,
        )
    if few:
        least = min(len(measured[name]) for name in few)
        yield Finding(
            "warning",
            f"{_conditions(few)} fewer than {FRAMES_ADVISED} frames (the least: {least}).",
            f"Means are uncertain by up to {math.sqrt(FRAMES_ADVISED / least):.1f} times as much as with "
            f"{FRAMES_ADVISED} frames, and {IN_THE_SPREAD[study.kind]} is hard to see.",
            advice,
        )
    untimed = [one.id for one in study.conditions if one.time_s is None and len(one.frames) > 1]
    if untimed:
        yield Finding(
            "note",
            f"{_conditions(untimed)} no time_s.",
            f"Changes in time cannot be told from chance: {IN_TIME[study.kind]}.",
            "State when each frame was taken.",
        )


def _of_copies(study: Study, clear: dict[str, list[_Look]], measured: dict[str, list[_Look]]) -> Iterator[Finding]:
    for name, looks in clear.items():
        copies = _copies(looks)
        if copies and copies == len(looks) - 1:
            yield Finding(
                "error",
                f"All {len(looks)} clear frames of the scene {name} are the same, bit for bit "
                f"({_place(study.scenes[name].clear)}).",
                "The floor of any gap is zero: every difference, however small, would count.",
                "Give frames that carry the sensor's noise, each its own.",
            )
        elif copies:
            yield _sold_as_replicates(f"The scene {name}", study.scenes[name].clear, looks)
    for one in study.conditions:
        if _copies(measured[one.id]):
            yield _sold_as_replicates(f"The condition {one.id}", one.frames, measured[one.id])
    by_hash = {look.sha256: name for name, looks in clear.items() for look in looks}
    for one in study.conditions:
        shared = [look for look in measured[one.id] if look.sha256 in by_hash]
        if shared and one.weather is not None:
            yield Finding(
                "error",
                f"{len(shared)} frames of the condition {one.id} are clear frames of the scene "
                f"{by_hash[shared[0].sha256]}, bit for bit ({_place(one.frames)}).",
                "What was measured in weather is clear air.",
                "Check which files belong to the condition.",
            )
    owner_of: dict[str, str] = {}
    for one in study.conditions:
        twins = {owner_of[look.sha256] for look in measured[one.id] if look.sha256 in owner_of}
        owner_of |= {look.sha256: one.id for look in measured[one.id]}
        if twins:
            yield Finding(
                "error",
                f"The conditions {', '.join(sorted(twins))} and {one.id} share frames, bit for bit "
                f"({_place(one.frames)}).",
                "One of them is not what its record says; where one is held out, nothing is tested by it.",
                "Check which files belong to which condition.",
            )


def _copies(looks: Sequence[_Look]) -> int:
    return len(looks) - len({look.sha256 for look in looks})


def _sold_as_replicates(what: str, frames: Frames, looks: Sequence[_Look]) -> Finding:
    number, copies = len(looks), _copies(looks)
    hashes = [look.sha256 for look in looks]
    again = next(place for place, found in enumerate(hashes) if found in hashes[:place])
    return Finding(
        "error",
        f"{what} has {copies} of {number} frames that repeat another one, bit for bit ({_place(frames)}[{again}] "
        f"repeats [{hashes.index(hashes[again])}]).",
        f"They are no replicates: spread and uncertainty come out too small, as if {number} frames were known where "
        f"there are {number - copies}.",
        "Drop the copies.",
    )


# ---- weather and split -----------------------------------------------------------------------------------------------


def _of_weather(study: Study) -> Iterator[Finding]:
    inside = [one for one in study.conditions if one.weather is not None]
    if not inside:
        yield Finding(
            "error",
            f"No condition has weather ({_file(study)}: conditions[].weather).",
            "There is nothing to simulate and to compare.",
            "Add conditions in rain, fog or snow.",
        )
    unsure = [one.id for one in inside if not one.rel_sd]
    if unsure:
        yield Finding(
            "warning",
            f"{_conditions(unsure)} no uncertainty of the weather record.",
            "The recorded rate or visibility is taken as exact; its error then passes for an effect, most of all for "
            f"{'radar.path_loss_scale' if study.kind == 'radar' else study.kind + '.extinction_scale'}.",
            "State rate_rel_sd or mor_rel_sd, the relative standard deviation of the record.",
        )
    none = [one.id for one in inside if one.weather is not None and _is_none(one)]
    if none:
        yield Finding(
            "warning",
            f"{_conditions(none)} a recorded rate of 0 or an infinite visibility.",
            "Nothing is simulated there; any difference counts as a gap.",
            "Correct the record, or state the weather as clear.",
        )
    unused = [name for name in study.scenes if name not in {one.scene for one in study.conditions}]
    if unused:
        yield Finding(
            "note",
            f"No condition belongs to the scene{'s' * (len(unused) > 1)} {', '.join(unused)}.",
            "Clear frames alone tell nothing of weather.",
            "Check the scene of each condition.",
        )
    if len(study.scenes) == 1:
        yield Finding(
            "note",
            "There is one scene.",
            "What belongs to this place (its targets, their distances) cannot be told from what belongs to the sensor.",
            "Record a second scene with other targets and distances.",
        )


def _is_none(condition: Condition) -> bool:
    assert condition.weather is not None
    rate_or_visibility = float(condition.weather.intensity)
    return math.isinf(rate_or_visibility) or rate_or_visibility == 0


def _of_split(study: Study) -> Iterator[Finding]:
    weathers = {condition_group(one) for one in study.conditions if one.weather is not None}
    if len(weathers) == 1:
        yield Finding(
            "warning",
            "There is a single condition: one scene in one weather.",
            "None can be held out: whether what is found holds elsewhere stays open, and nothing shows how an effect "
            "grows with the weather.",
            "Record another rate or visibility, or another scene.",
        )
    elif not study.holdout:
        yield Finding(
            "warning",
            "No condition is held out.",
            "Whether what is found holds elsewhere stays open.",
            "Set split: holdout for a condition, or leave split out of all of them.",
        )
    if not study.fit:
        yield Finding(
            "error",
            f"All conditions are held out ({_file(study)}: conditions[].split).",
            "There is nothing to fit to.",
            "Set split: fit for some of them.",
        )
    fitted = {condition_group(one) for one in study.fit}
    repeated = [one.id for one in study.holdout if condition_group(one) in fitted]
    if repeated:
        yield Finding(
            "warning",
            f"{_conditions(repeated)} the scene and the weather of a condition to fit to, and are held out.",
            "They test nothing new: held out means another scene or another rate, not other frames of one.",
            "Hold out another condition.",
        )


# ---- what each sensor needs ------------------------------------------------------------------------------------------


def _of_geometry(study: Study) -> Iterator[Finding]:
    for one in study.scenes.values():
        if study.kind == "lidar":
            yield from _of_lidar_geometry(one.id, one.geometry)
        elif study.kind == "camera":
            depth_m = np.asarray(one.geometry["depth_m"], dtype=np.float64)
            depth_m = depth_m[np.isfinite(depth_m)]
            if depth_m.size == 0 or np.quantile(depth_m, 0.95) < ONE_DEPTH * np.quantile(depth_m, 0.05):
                yield Finding(
                    "warning",
                    f"The scene {one.id} has one depth, if any.",
                    "camera.exposure_gain cannot be told from camera.airlight_scale, nor camera.stray_light.",
                    "Record a scene with near and far surfaces.",
                )
            if "normal" not in one.geometry and "label" not in one.geometry:
                yield Finding(
                    "note",
                    f"The scene {one.id} has no normal and no label.",
                    "camera.wet_surface cannot be told from camera.exposure_gain: it is known by the road and by "
                    "surfaces that face up.",
                    "Give normal (H, W, 3) or label (H, W) in the geometry.",
                )
        elif len(np.unique(np.asarray(one.geometry["target_class"]))) == 1:
            yield Finding(
                "note",
                f"All targets of the scene {one.id} are of one class.",
                "radar.wet_rcs, which differs by class, cannot be told from radar.wet_radome.",
                "State the classes of the targets, or record a scene with several.",
            )


def _of_lidar_geometry(name: str, geometry: Frame) -> Iterator[Finding]:
    if "cos_incidence" not in geometry:
        yield Finding(
            "warning",
            f"The scene {name} has no cos_incidence.",
            "lidar.wet_target cannot be told from lidar.window_loss: wet surfaces are known by the angle at which they "
            "are hit.",
            "Give cos_incidence (H, W) in the geometry.",
        )
    if "up" not in geometry:
        yield Finding(
            "note",
            f"The scene {name} has no up.",
            "lidar.wet_target is harder to tell from lidar.ring_gain: what faces up gets wet first.",
            "Give up (H, W), the upward component of the surfaces' normals, in the geometry.",
        )


def _of_signals(study: Study, clear: dict[str, list[_Look]], measured: dict[str, list[_Look]]) -> Iterator[Finding]:
    what = {"lidar": "return", "camera": "pixel", "radar": "detection"}[study.kind]
    dark = [name for name, looks in clear.items() if not any(look.signals for look in looks)]
    if dark:
        yield Finding(
            "error",
            f"The clear frames of {', '.join(dark)} have no {what} ({_place(study.scenes[dark[0]].clear)}).",
            "There is nothing that weather could change.",
            "Check range_m and power_db, and their units.",
        )
    lost = [name for name, looks in measured.items() if not any(look.signals for look in looks)]
    if lost:
        yield Finding(
            "warning",
            f"{_conditions(lost)} no {what} in any frame.",
            "Only that everything is lost can be compared.",
            "Check the files, or record weaker weather.",
        )
    looks = [look for some in (*clear.values(), *measured.values()) for look in some if look.signals]
    black = [name for name, some in clear.items() if name not in dark and not any(look.high > 0 for look in some)]
    if isinstance(study.sensor, Lidar) and study.sensor.intensity_unit != "none" and black:
        yield Finding(
            "error",
            f"The clear frames of {', '.join(black)} have returns and no intensity "
            f"({_place(study.scenes[black[0]].clear)}).",
            f"In {study.sensor.intensity_unit}, the sensor's intensity_unit, this says that nothing reflects: every "
            "return then stands at the threshold of detection, and any weather takes it away.",
            "Give the sensor's intensities, or state intensity_unit: none in the sensor's overrides.",
        )
    elif study.kind == "lidar" and looks and min(look.low for look in looks) == max(look.high for look in looks):
        yield Finding(
            "warning",
            "All intensities are equal.",
            "Without intensities lidar.window_loss cannot be told from lidar.threshold_shift, and extinction shows "
            "only in the points that are lost.",
            "Give the sensor's intensities where it has any.",
        )
    yield from _of_intensity_unit(study, clear)
    if study.kind == "camera" and looks and all(look.low == look.high for look in looks):
        yield Finding(
            "error",
            f"All pixels of a frame are equal, in every frame ({_place(study.conditions[0].frames)}).",
            "There is nothing that weather could change.",
            "Check how bayer was made.",
        )
    if study.kind == "radar" and not any(look.clutter for some in measured.values() for look in some):
        yield Finding(
            "note",
            "No frame has clutter.",
            "Echoes of drops (radar.volume_clutter), ghosts (radar.multipath) and radar.doppler_spread cannot be seen.",
            "Give the detections that belong to no target as clutter (M, 6).",
        )


def _of_intensity_unit(study: Study, clear: dict[str, list[_Look]]) -> Iterator[Finding]:
    """Half of a scene's returns brighter than white, or darker than anything: the data are in another unit."""
    if not isinstance(study.sensor, Lidar) or study.sensor.intensity_unit in ("none", "photons"):
        return
    unit = study.sensor.intensity_unit
    for name, looks in clear.items():
        middle = max((look.middle for look in looks if look.high > 0), default=math.nan)
        reflectivity = reflectivity_from_intensity(torch.tensor(middle), unit, study.sensor.assumed_reflectivity).item()
        if reflectivity < DARKEST or reflectivity > 1.0:
            yield Finding(
                "warning",
                f"The median intensity of the clear frames of {name}, {middle:.3g}, is a reflectivity of "
                f"{reflectivity:.2g} in {unit}, the sensor's intensity_unit.",
                f"Targets of a road lie between {DARKEST:g} and 1. In a wrong unit the model loses too many returns or "
                "too few.",
                "State the unit of the data as intensity_unit in the sensor's overrides.",
            )


def _of_links(study: Study) -> Iterator[Finding]:
    links = study.links
    holdout = np.asarray(links["split"]) == 1
    if holdout.all():
        yield Finding(
            "error",
            f"All links are held out ({_file(study)}: split of links).",
            "There is nothing to fit to.",
            "Set split 0 for some links.",
        )
    if not holdout.any():
        yield Finding(
            "warning",
            "No link is held out.",
            "Whether what is found holds for other links stays open.",
            "Set split 1 for a third of the links.",
        )
    length_km = np.asarray(links["length_km"], dtype=np.float64)
    if length_km.max() < SPREAD_OF_LENGTHS * length_km.min():
        yield Finding(
            "warning",
            f"All links are about as long as each other, {length_km.min():.2g} to {length_km.max():.2g} km.",
            "A loss at the ends (radar.wet_radome) cannot be told from one along the path (radar.path_loss_scale).",
            "Add links that are shorter or longer by a factor of two.",
        )
    for one in study.conditions:
        yield from _of_series(one.id, one.frames)


def _of_series(name: str, frames: Frames) -> Iterator[Finding]:
    for frame in frames:
        rain = np.asarray(frame["rain_mm_per_h"])
        known = ~np.isnan(np.asarray(frame["attenuation_db"]))
        dry = dry_samples(frame["time_s"], frame["rain_mm_per_h"]) & known
        undry = np.flatnonzero(~dry.any(0))
        if len(undry):
            yield Finding(
                "error",
                f"{len(undry)} of {dry.shape[1]} links of {name} have no dry sample, more than 15 min from rain "
                f"({_place(frames)}).",
                "What they attenuate in clear air is unknown, so nothing can be said of rain.",
                "Give a longer series, or leave these links out.",
            )
        if not (rain > 0).any():
            yield Finding(
                "error",
                f"{name} has no rain ({_place(frames)}).",
                "There is nothing to compare.",
                "Give a series with rain in it.",
            )
        missing = 1.0 - float(known.mean())
        if missing > 0.5:
            yield Finding(
                "warning",
                f"{100 * missing:.0f} % of the attenuations of {name} are missing.",
                f"Means are uncertain by {1 / math.sqrt(1 - missing):.1f} times as much as of the whole series.",
                "Check whether links fail in heavy rain: then the strongest rain is what is missing.",
            )
        if rain.shape[-1] == 1:
            yield Finding(
                "note",
                f"The rain of {name} is a mean of each path.",
                "The law of rain attenuation bends, so a mean rate tells less than the rates along the path.",
                "Give rain_mm_per_h (T, L, P) with several samples along each path, from a radar or several gauges.",
            )


def _place(frames: Frames) -> str:
    """File and key of frames, without the folder: ``study.yaml: scenes[0].clear``."""
    owner, _, key = frames.name.rpartition(": ")
    return f"{PurePath(owner).name}: {key}"


def _file(study: Study) -> str:
    """The file of a study, without the folder: ``study.yaml``."""
    return _place(study.conditions[0].frames).rpartition(": ")[0]


def _conditions(names: Sequence[str]) -> str:
    """``The condition c0 has``, ``The conditions c0, c1 and 7 more have``."""
    if len(names) == 1:
        return f"The condition {names[0]} has"
    more = f" and {len(names) - SHOWN} more" if len(names) > SHOWN else ""
    return f"The conditions {', '.join(names[:SHOWN])}{more} have"
