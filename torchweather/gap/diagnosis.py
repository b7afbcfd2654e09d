"""Shortcomings of a study in plain words, and what they cost."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence
from itertools import chain

import numpy as np

from torchweather.gap.study.conditions import Condition
from torchweather.gap.study.content_hash import frame_sha256
from torchweather.gap.study.frames import Frame, Frames
from torchweather.gap.study.kinds import LEVELS, Finding, FrameLook, Looks, StudyKind, place
from torchweather.gap.study.splits import condition_group
from torchweather.gap.study.study import Study

__all__ = ["LEVELS", "Finding", "diagnose"]

# GAP.md section 1: advised numbers of frames.
CLEAR_ADVISED, FRAMES_ADVISED = 8, 5
SHOWN = 5


def diagnose(study: Study) -> list[Finding]:
    """List what a study lacks, the worst first. Reads every frame once.

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
    kind = study.study_kind
    clear = {one.id: [_look(kind, frame) for frame in one.clear] for one in study.scenes.values()}
    conditions = study.conditions if kind.has_scenes else ()
    measured = {one.id: [_look(kind, frame) for frame in one.frames] for one in conditions}
    found: list[Iterable[Finding]] = [kind.findings(study, clear, measured)]
    if kind.has_scenes:
        found[:0] = (
            _of_clear_frames(study, clear),
            _of_frames(study, measured),
            _of_copies(study, clear, measured),
            _of_weather(study),
            _of_split(study),
            *(kind.geometry_findings(one.id, one.geometry) for one in study.scenes.values()),
            _of_signals(study, clear, measured),
        )
    return sorted(chain(*found), key=lambda one: LEVELS.index(one.level))


# ---- frames ----------------------------------------------------------------------------------------------------------


def _look(kind: StudyKind, frame: Frame) -> FrameLook:
    values = kind.signals(frame)
    low, middle, high = np.quantile(values, (0.0, 0.5, 1.0)).tolist() if values.size else 3 * (math.nan,)
    return FrameLook(frame_sha256(frame), int(values.size), low, middle, high, frozenset(frame))


def _of_clear_frames(study: Study, clear: Looks) -> Iterator[Finding]:
    for name, looks in clear.items():
        n = len(looks)
        if n == 1:
            yield Finding(
                "error",
                f"The scene {name} has one clear frame ({place(study.scenes[name].clear)}).",
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


def _of_frames(study: Study, measured: Looks) -> Iterator[Finding]:
    single = [name for name, looks in measured.items() if len(looks) == 1]
    few = [name for name, looks in measured.items() if 1 < len(looks) < FRAMES_ADVISED]
    advice = f"Record {FRAMES_ADVISED} or more frames of each condition: particles are random."
    if single:
        yield Finding(
            "warning",
            f"{_conditions(single)} one frame.",
            f"The spread between frames is unknown: {study.study_kind.spread_effect} cannot be seen, and means are "
            f"uncertain by {math.sqrt(FRAMES_ADVISED):.1f} times as much as with {FRAMES_ADVISED} frames.",
            advice,
        )
    if few:
        least = min(len(measured[name]) for name in few)
        yield Finding(
            "warning",
            f"{_conditions(few)} fewer than {FRAMES_ADVISED} frames (the least: {least}).",
            f"Means are uncertain by up to {math.sqrt(FRAMES_ADVISED / least):.1f} times as much as with "
            f"{FRAMES_ADVISED} frames, and {study.study_kind.spread_effect} is hard to see.",
            advice,
        )
    untimed = [one.id for one in study.conditions if one.time_s is None and len(one.frames) > 1]
    if untimed:
        yield Finding(
            "note",
            f"{_conditions(untimed)} no time_s.",
            f"Changes in time cannot be distinguished from chance: {study.study_kind.drift}.",
            "State when each frame was taken.",
        )


def _of_copies(study: Study, clear: Looks, measured: Looks) -> Iterator[Finding]:
    for name, looks in clear.items():
        copies = _copies(looks)
        if copies and copies == len(looks) - 1:
            yield Finding(
                "error",
                f"All {len(looks)} clear frames of the scene {name} are the same, bit for bit "
                f"({place(study.scenes[name].clear)}).",
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
                f"{by_hash[shared[0].sha256]}, bit for bit ({place(one.frames)}).",
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
                f"({place(one.frames)}).",
                "One of them is not what its record says; where one is held out, nothing is tested by it.",
                "Check which files belong to which condition.",
            )


def _copies(looks: Sequence[FrameLook]) -> int:
    return len(looks) - len({look.sha256 for look in looks})


def _sold_as_replicates(what: str, frames: Frames, looks: Sequence[FrameLook]) -> Finding:
    number, copies = len(looks), _copies(looks)
    hashes = [look.sha256 for look in looks]
    again = next(place for place, found in enumerate(hashes) if found in hashes[:place])
    return Finding(
        "error",
        f"{what} has {copies} of {number} frames that repeat another one, bit for bit ({place(frames)}[{again}] "
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
            f"{study.study_kind.loss_effect}.",
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
            "Effects of this place (its targets, their distances) cannot be distinguished from those of the sensor.",
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


def _of_signals(study: Study, clear: Looks, measured: Looks) -> Iterator[Finding]:
    what = study.study_kind.signal_name
    dark = [name for name, looks in clear.items() if not any(look.signals for look in looks)]
    if dark:
        yield Finding(
            "error",
            f"The clear frames of {', '.join(dark)} have no {what} ({place(study.scenes[dark[0]].clear)}).",
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


def _file(study: Study) -> str:
    """The file of a study, without the folder: ``study.yaml``."""
    return place(study.conditions[0].frames).rpartition(": ")[0]


def _conditions(names: Sequence[str]) -> str:
    """``The condition c0 has``, ``The conditions c0, c1 and 7 more have``."""
    if len(names) == 1:
        return f"The condition {names[0]} has"
    more = f" and {len(names) - SHOWN} more" if len(names) > SHOWN else ""
    return f"The conditions {', '.join(names[:SHOWN])}{more} have"
