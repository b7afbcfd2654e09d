"""A whole data set into weather: find the frames, leave out what is done, do the rest, keep the manifest."""

from __future__ import annotations

import contextlib
import json
import re
import shutil
import time
from collections.abc import Callable, Generator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Protocol

import torchweather
from torchweather.core.errors import InputValueError, check_at_least, check_between, check_one_of
from torchweather.core.random import DRAWS, sample_seed
from torchweather.datasets.augment.frame_files import FRAME_FILES
from torchweather.datasets.augment.frame_recipe import FrameRecipe, text_sha256
from torchweather.datasets.augment.frames import COPY, DataSet, Frame, SensorFile
from torchweather.datasets.augment.job import Job
from torchweather.datasets.augment.layouts import find_frames
from torchweather.datasets.augment.local import LocalEngine
from torchweather.datasets.augment.manifest import DONE, FAILED, FORMAT, Manifest, Row
from torchweather.datasets.augment.manifest import NAME as MANIFEST
from torchweather.datasets.augment.nuscenes import write_points_left
from torchweather.datasets.augment.paths import check_folders, file_sha256, inside
from torchweather.datasets.augment.work import ATTEMPTS, FULL, file_stamp, no_room
from torchweather.io import PointReading
from torchweather.recipes.files import find

__all__ = ["ENGINES", "Progress", "Summary", "augment"]

ENGINES = ("local", "ray")
# Names that `atomic_write` gives to what is not finished.
UNFINISHED = re.compile(r"^\..*\.[0-9a-f]{32}(\.[^.]*)?$")
# What must be the same for a run to go on where another ended, and its option on the command line.
SAME = {"recipe_sha256": "--recipe", "seed": "--seed", "layout": "--layout", "depth": "--depth"}
SAME |= {"bin_columns": "--bin-columns", "bin_dtype": "--bin-dtype", "viewpoint": "--viewpoint"}
SAME |= {"depth_encoding": "--depth-encoding", "depth_along": "--depth-along", "baseline_m": "--baseline-m"}
SAME |= {"formats": "--format", "own_vehicle": "--own-vehicle", "png_level": "--png-level"}


class Engine(Protocol):
    """Whoever does the frames."""

    stopping: bool

    def rows(self, frames: list[Frame]) -> Generator[Row, None, None]:
        """Outcome of each frame."""


@dataclass(frozen=True)
class Progress:
    """Progress of a run.

    Args:
        finished: frames and copies of this run, also broken ones.
        total: that this run has to do.
        row: the last one; ``None`` before the first.
    """

    finished: int
    total: int
    row: Row | None


@dataclass
class Summary:
    """Summary of a run.

    Args:
        layout: of the data set.
        frames: number of frames of sensors in it.
        copies: number of files that are carried along.
        skipped: frames and copies that an earlier run had done.
        done: frames and copies of this run.
        broken: name of each frame that could not be done, and why.
        to_do: frames and copies that this run had to do.
        stopped: why the run ended before its end; empty where it did not.
        left_out: paths in the source that are not even carried along: hidden ones, pipes, sockets.
        clear: folder to the number of a sensor's files in it that are carried along in clear air.
        gone: results, below the target, of frames that the source has no more.
        pruned: whether those are deleted.
        notes: what a reader must know of the data set.
        seconds: that it took.
        manifest: the file.
    """

    layout: str
    frames: int
    copies: int
    skipped: int
    manifest: Path
    to_do: int = 0
    done: int = 0
    broken: dict[str, str] = field(default_factory=dict)
    stopped: str = ""
    left_out: list[str] = field(default_factory=list)
    clear: dict[str, int] = field(default_factory=dict)
    gone: list[str] = field(default_factory=list)
    pruned: bool = False
    notes: list[str] = field(default_factory=list)
    seconds: float = 0.0


def augment(
    source: Path,
    target: Path,
    recipe: str,
    *,
    workers: int = 1,
    seed: int = 0,
    layout: str = "auto",
    depth: str | None = None,
    depth_encoding: str | None = None,
    depth_along: str | None = None,
    baseline_m: float | None = None,
    formats: Mapping[str, str] | None = None,
    own_vehicle: str | None = None,
    reading: PointReading | None = None,
    engine: str = "local",
    restart: bool = False,
    rebuild: bool = False,
    verify: bool = False,
    prune: bool = False,
    follow_links: bool = False,
    durable: bool = True,
    png_level: int | None = None,
    dry_run: bool = False,
    on_progress: Callable[[Progress], None] = lambda progress: None,
) -> Summary:
    """Put a data set into weather; every file of the result follows from the input, the recipe and the seed alone.

    Killed at any moment and called again, it goes on where it was.

    Args:
        source: root of the data set; it is only read.
        target: root of the results; empty, or that of an earlier run with the same recipe and seed.
        recipe: name of a recipe, or its file.
        workers: processes with one torch thread each; 0 does the work in this process.
        seed: of the whole run; a frame's follows from it and the frame's name.
        layout: ``auto``, ``folder``, ``kitti`` or ``nuscenes``.
        depth: of cameras: a file, a folder, metres, ``ground``, or ``lidar``; ``None``: what the layout has.
        depth_encoding: of integer depth maps.
        depth_along: of depth maps: ``axis`` (default) or ``ray``, the direction in which their metres count.
        baseline_m: of disparity maps: distance of the two lenses, m.
        formats: of a plain folder, kind of sensor to the ending of the results.
        own_vehicle: ``drive``: a mask of the vehicle over at most 50 sweeps of each drive (a folder, or a log of
            nuScenes); a file of such a mask; ``none``. ``None`` is ``drive`` where the recipe completes sweeps and a
            drive has 5 or more that differ. The manifest keeps the masks, so that a run goes on with the same.
        reading: how point files are to be read: columns of a ``.bin``, the viewpoint of PCD.
        engine: ``local`` or ``ray``.
        restart: forget what an earlier run did, and delete its files; a damaged manifest is begun again.
        rebuild: write a damaged manifest anew from the rows that can be read and whose outputs have their hashes.
        verify: compare the hashes of all inputs and outputs of an earlier run; else sizes and times of change, and the
            hash only where a time differs.
        prune: delete the results of frames that are in the source no more; else they are listed in ``gone``.
        follow_links: take links to folders, and links that lead out of the source.
        durable: every result is on the disk before its row is; without it faster, but not safe against a power cut.
        png_level: compression of PNG, 0 (fastest) to 9 (smallest); ``None`` is 6. The pixels are the same.
        dry_run: only count.
        on_progress: is told before the first frame and after each.

    Returns:
        What was done; a frame whose files are broken is in ``broken`` and leaves no file.

    Raises:
        ValueError: folders that lie in each other, nothing that the recipe is for, an earlier run with another recipe.
        TorchweatherError: a broken recipe, table or manifest; a path that leads out of the root.
        KeyboardInterrupt: after the frames that were under way.
    """
    started = time.perf_counter()
    how = reading or PointReading()
    check_folders(source, target)
    check_at_least("workers", workers, 0, owner="augment")
    if png_level is not None:
        check_between("png_level", png_level, 0, 9, owner="augment", advice="6 is usual, 1 fast.")
    check_one_of("engine", engine, ENGINES, owner="augment")
    if engine == "ray" and not dry_run:
        from torchweather.datasets.augment.ray_engine import check_ray

        check_ray()  # before anything is written
    path = find(recipe, ("transform", "multi_sensor"))
    text = path.read_text(encoding="utf-8")
    built = FrameRecipe(text, str(path))
    data = find_frames(
        source, built.keys, recipe=recipe, layout=layout, depth=depth, formats=formats, follow_links=follow_links
    )
    settings = {
        "format": FORMAT,
        "source": str(source.resolve()),
        "recipe": recipe,
        "recipe_text": text,
        "recipe_sha256": text_sha256(text),
        "seed": str(int(seed)),
        "layout": data.layout,
        "depth": depth or "",
        "depth_encoding": depth_encoding or "",
        "depth_along": depth_along or "",
        "baseline_m": "" if baseline_m is None else f"{baseline_m:g}",
        "own_vehicle": own_vehicle or "",
        **_reading_settings(how),
        "png_level": "" if png_level is None else str(int(png_level)),
        "formats": json.dumps(dict(formats or {}), sort_keys=True),
        "version": torchweather.__version__,
        "draws": DRAWS,
    }
    job = Job(
        str(source.resolve()),
        str(target.resolve()),
        text,
        int(seed),
        depth,
        depth_encoding,
        depth_along,
        baseline_m,
        reading=how,
        follow_links=follow_links,
        durable=durable,
        png_level=png_level,
    )
    _check_target(target)
    if dry_run and not (target / MANIFEST).exists():
        return _summary(data, target, list(data.frames), started)
    target.mkdir(parents=True, exist_ok=True)
    if restart and rebuild:
        raise InputValueError("augment: restart forgets the manifest, rebuild keeps what it can; give one of them.")
    with Manifest(target, anew=restart and not dry_run, rebuild=rebuild and not dry_run) as manifest:
        before = {} if restart else manifest.settings()
        if before:
            _check_same(before, settings, target)
        to_do = list(data.frames) if restart else _left(data, manifest, job, settings, verify=verify)
        summary = _summary(data, target, to_do, started)
        if not restart:
            summary.gone = _gone(data, manifest, prune=prune and not dry_run)
            summary.pruned = prune and not dry_run
        if dry_run:
            return summary
        for kind in built.keys if to_do else ():
            job = FRAME_FILES[kind].prepared(job, data.frames, built.spec(kind), settings, before)
        manifest.write_settings(settings)
        _clean(target)  # what a killed run left; its marks of tries must not count
        try:
            _do(to_do, _engine(engine, job, workers), manifest, summary, on_progress)
            if not summary.stopped:
                _finish_tables(data, job, manifest, settings, summary)
        finally:
            _clean(target)
    summary.seconds = time.perf_counter() - started
    return summary


def _reading_settings(reading: PointReading) -> dict[str, str]:
    """The reading of point files as text; empty where nothing is stated, as in manifests without these entries."""
    columns = reading.bin_columns or ""
    return {
        "bin_columns": columns if isinstance(columns, str) else ",".join(columns),
        "bin_dtype": "" if reading.bin_dtype == PointReading.bin_dtype else reading.bin_dtype,
        "viewpoint": reading.viewpoint or "",
    }


def _do(
    frames: list[Frame],
    engine: Engine,
    manifest: Manifest,
    summary: Summary,
    on_progress: Callable[[Progress], None],
) -> None:
    on_progress(Progress(0, len(frames), None))
    if not frames:
        return
    with contextlib.closing(engine.rows(frames)) as rows:
        for row in rows:
            if row.status == FULL:
                summary.stopped, engine.stopping = str(row.error), True
                continue
            try:
                if row.status == FAILED:
                    # Its input was whole in an earlier run: what came of that is no result of what is there now.
                    manifest.remove_outputs_of_frame(row.frame)
                manifest.record(row)
            except OSError as error:
                if not no_room(error):
                    raise
                summary.stopped, engine.stopping = f"{manifest.path}: {error.strerror}", True
                continue
            if row.status == FAILED:
                summary.broken[row.frame] = str(row.error)
            else:
                summary.done += 1
            on_progress(Progress(summary.done + len(summary.broken), len(frames), row))


def _engine(name: str, job: Job, workers: int) -> Engine:
    if name == "ray":
        from torchweather.datasets.augment.ray_engine import RayEngine

        return RayEngine(job, max(workers, 1))
    return LocalEngine(job, workers)


def _summary(data: DataSet, target: Path, to_do: list[Frame], started: float) -> Summary:
    copies = sum(frame.is_copy for frame in data.frames)
    return Summary(
        layout=data.layout,
        frames=len(data.frames) - copies,
        copies=copies,
        skipped=len(data.frames) - len(to_do),
        manifest=target / MANIFEST,
        to_do=len(to_do),
        left_out=list(data.left_out),
        clear=dict(data.clear),
        notes=list(data.notes),
        seconds=time.perf_counter() - started,
    )


def _check_target(target: Path) -> None:
    if target.exists() and not (target / MANIFEST).exists() and any(target.iterdir()):
        raise InputValueError(
            f"augment: DST must be empty, new, or that of an earlier run; {target} holds other files and no {MANIFEST}."
        )


def _check_same(before: Mapping[str, str], now: Mapping[str, str], target: Path) -> None:
    if before.get("format") != FORMAT:
        raise InputValueError(
            f"augment: {target / MANIFEST} is of format {before.get('format')!r}; this is {FORMAT!r}."
        )
    for key, option in SAME.items():
        if before.get(key, "") != now[key]:
            name = "recipe" if key == "recipe_sha256" else key
            raise InputValueError(
                f"augment: {target} was begun with {option} {before.get(name)!r}; got {now[name]!r}"
                f"{' (its text has changed)' if before.get(name) == now[name] else ''}. Give another DST, or --restart "
                "to delete what is there and begin again."
            )


def _left(
    data: DataSet, manifest: Manifest, job: Job, settings: Mapping[str, str], *, verify: bool = False
) -> list[Frame]:
    """Frames that no earlier run has done from the same input."""
    rows = {row.frame: row for row in manifest.rows()}
    return [
        frame
        for frame in data.frames
        if not _stands(frame, rows.get(frame.name), manifest, job, settings, verify=verify)
    ]


def _gone(data: DataSet, manifest: Manifest, *, prune: bool) -> list[str]:
    """Results of frames that the source has no more; deleted where ``prune``."""
    names = {frame.name for frame in data.frames} | set(data.annotation_tables)
    present = {file.target for frame in data.frames for file in frame.files} | set(data.annotation_tables)
    found: list[str] = []
    for row in list(manifest.rows()):
        if row.frame not in names:
            found += [path for path in row.outputs if path not in present]
            if prune:
                manifest.remove_frame(row, keep=present)
    return found


def _stands(
    frame: Frame,
    row: Row | None,
    manifest: Manifest,
    job: Job,
    settings: Mapping[str, str],
    *,
    verify: bool = False,
) -> bool:
    if row is None or row.status != DONE or row.recipe_sha256 != settings["recipe_sha256"]:
        return False
    if row.version != settings["version"] or row.seed != sample_seed(job.seed, frame.seed_name, 0):
        return False
    if set(row.inputs) != set(frame.reads) or not {file.target for file in frame.files} <= set(row.outputs):
        return False
    try:
        for path, (sha256, size, changed_ns) in row.inputs.items():
            file = inside(Path(job.source), path, "augment", follow_links=job.follow_links)
            found = file.stat()
            if found.st_size != size:
                return False
            if (verify or found.st_mtime_ns != changed_ns) and file_sha256(file) != sha256:
                return False
    except OSError:  # it cannot be read any more, which doing it again will report
        return False
    return manifest.outputs_stand(row, verify=verify)


def _clean(target: Path) -> None:
    """Delete what was begun under a temporary name and never finished."""
    shutil.rmtree(target / ATTEMPTS, ignore_errors=True)
    for path in target.rglob(".*"):
        if UNFINISHED.match(path.name) and path.is_file():
            path.unlink(missing_ok=True)


def _finish_tables(data: DataSet, job: Job, manifest: Manifest, settings: Mapping[str, str], summary: Summary) -> None:
    """nuScenes' tables of boxes, with the points that are left."""
    rows = {row.frame: row for row in manifest.rows()} if data.annotation_tables else {}
    left = {box["token"]: box["points_left"] for row in rows.values() for box in row.boxes or [] if "token" in box}
    for table in data.annotation_tables:
        frame = Frame(table, (SensorFile(COPY, COPY, table, table),), table)
        if not summary.to_do and _stands(frame, rows.get(table), manifest, job, settings):
            continue
        began = time.perf_counter()
        before, after = Path(job.source, table), Path(job.target, table)
        stamp = file_stamp(before)
        try:
            after.parent.mkdir(parents=True, exist_ok=True)
            write_points_left(after, before, left)
            manifest.record(
                Row(
                    frame=table,
                    status=DONE,
                    kind=COPY,
                    inputs={table: stamp},
                    outputs={table: file_stamp(after)},
                    recipe_sha256=settings["recipe_sha256"],
                    seed=sample_seed(job.seed, table, 0),
                    version=settings["version"],
                    seconds=time.perf_counter() - began,
                )
            )
        except OSError as error:
            if not no_room(error):
                raise
            summary.stopped = f"{after}: {error.strerror}"
            return
