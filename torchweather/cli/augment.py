"""``torchweather augment``: a whole data set into weather."""

from __future__ import annotations

import argparse
import re
import sys
import time
from pathlib import Path
from typing import TYPE_CHECKING, Any

from torchweather.cli.clouds import add_reading, reading_of
from torchweather.cli.output import add_no_fsync, listed, note, shown
from torchweather.core.exceptions import InputValueError

if TYPE_CHECKING:
    from torchweather.datasets.augment import Progress, Row, Summary

NAME = "augment"
SUMMARY = "weather on a whole data set, with a manifest; goes on where it was stopped"
DESCRIPTION = """Puts a weather on every image and cloud of SRC and writes them to DST, each under its own path;
all other files are carried along. Layouts: a folder of any depth; KITTI's object, odometry (SemanticKITTI), tracking
and raw data, by their folders; nuScenes (samples, sweeps, v1.0-*). The seed of a frame follows from --seed and its
name, so the result is the same for any number of workers. DST/torchweather-manifest.sqlite records what each file
was made of. After a crash the same command resumes: a file that has its recorded size and time of change is not done
again. A broken file is reported and left out. Exit code 0: all is done; 1: done, but for broken files; 2: a mistake
in what was asked, or a damaged manifest; 3: stopped, the disk is full; 130, 143, 129: ended by Ctrl-C, SIGTERM,
SIGHUP, after the frames that were under way."""

BROKEN, STOPPED = 1, 3
EVERY_S = 30.0  # between lines of progress, where there is no terminal
LAYOUTS = ("auto", "folder", "kitti", "nuscenes")
ENGINES = ("local", "ray")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments of the command."""
    parser.add_argument("source", type=Path, metavar="SRC", help="root of the data set; it is only read")
    parser.add_argument("target", type=Path, metavar="DST", help="root of the results: new, or of an earlier run")
    parser.add_argument("--recipe", required=True, help="a recipe (see torchweather list), or a file of one's own")
    parser.add_argument("--workers", type=int, default=1, help="processes; 0: none but this one; default 1")
    parser.add_argument("--seed", type=int, default=0, help="default 0")
    parser.add_argument("--layout", choices=LAYOUTS, default="auto", help="of SRC; default: by its folders")
    parser.add_argument(
        "--depth",
        metavar="FILE|DIR|METRES|ground|lidar",
        help="of images; default: the LiDAR's where the layout has one, else the recipe's, else ground",
    )
    parser.add_argument(
        "--depth-encoding",
        help="of depth maps: metre (default of floats), centimetre, millimetre, kitti (1/256 m), carla, disparity "
        "(pixels) or disparity_kitti (1/256 pixel); 0 and NaN are unknown",
    )
    parser.add_argument(
        "--depth-along",
        choices=("axis", "ray"),
        help="direction of a map's metres: along the optical axis (default), or along each pixel's ray",
    )
    parser.add_argument("--baseline-m", type=float, help="of a disparity: distance of the two lenses, m")
    parser.add_argument(
        "--format",
        action="append",
        default=[],
        metavar="ENDING",
        help="of the results of a plain folder, such as .png or .pcd; default that of the input; may be repeated",
    )
    parser.add_argument(
        "--own-vehicle",
        metavar="drive|FILE|none",
        help="mask of the car that carries the LiDAR. drive: from at most 50 sweeps of each folder or nuScenes log, "
        "the default where the recipe completes sweeps and 5 or more differ. FILE: an .npz. none: in each sweep by "
        "itself",
    )
    add_reading(parser)
    parser.add_argument("--engine", choices=ENGINES, default="local", help="ray: on a Ray cluster (extra scale)")
    parser.add_argument(
        "--restart",
        action="store_true",
        help="delete what an earlier run wrote to DST, begin again, also where its manifest is damaged",
    )
    parser.add_argument(
        "--rebuild",
        action="store_true",
        help="write a damaged manifest anew from the rows that can be read and whose files have their hashes",
    )
    parser.add_argument(
        "--verify",
        action="store_true",
        help="compare the hashes of all files of an earlier run; default: sizes and times of change, and the hash only "
        "where a time differs",
    )
    parser.add_argument("--prune", action="store_true", help="delete results of frames that SRC has no more")
    parser.add_argument(
        "--follow-links", action="store_true", help="take links to folders, and links that lead out of SRC"
    )
    parser.add_argument(
        "--png-level",
        type=int,
        metavar="0-9",
        help="compression of PNG: 0 is fastest, 9 smallest, default 6; the pixels are the same",
    )
    add_no_fsync(parser)
    parser.add_argument("--dry-run", action="store_true", help="only print what would be done")
    parser.add_argument("--quiet", action="store_true", help="no progress")


def run(args: argparse.Namespace) -> int:
    """Do the data set."""
    from torchweather.cli.output import print_json, print_lines
    from torchweather.datasets.augment import augment

    shown = _Shown(args.quiet)
    try:
        summary = augment(
            args.source,
            args.target,
            args.recipe,
            workers=args.workers,
            seed=args.seed,
            layout=args.layout,
            depth=args.depth,
            depth_encoding=args.depth_encoding,
            depth_along=args.depth_along,
            baseline_m=args.baseline_m,
            formats=_formats(args.format),
            own_vehicle=args.own_vehicle,
            reading=reading_of(args),
            engine=args.engine,
            restart=args.restart,
            rebuild=args.rebuild,
            verify=args.verify,
            prune=args.prune,
            follow_links=args.follow_links,
            durable=not args.no_fsync,
            png_level=args.png_level,
            dry_run=args.dry_run,
            on_progress=shown.tell,
        )
    except KeyboardInterrupt:
        shown.close()
        note(f"stopped after {shown.finished} of {shown.total}; the same command goes on from there")
        raise
    finally:
        shown.close()
    code = STOPPED if summary.stopped else BROKEN if summary.broken else 0
    if args.json:
        print_json({**vars(summary), "dry_run": args.dry_run, "exit_code": code})
    else:
        print_lines(_text(summary, dry_run=args.dry_run))
    if not args.quiet:
        for text in _notes(summary):
            note(text)
    return code


def _notes(summary: Summary) -> list[str]:
    """Lines on what needs a look: files without weather, without a place in DST, or without a source."""
    notes = []
    if summary.left_out:
        notes.append(f"left out, hidden or no regular files: {len(summary.left_out)}: {listed(summary.left_out)}.")
    if summary.clear:
        folders = [f"{folder or '.'}/ ({number})" for folder, number in summary.clear.items()]
        count = sum(summary.clear.values())
        notes.append(f"carried along in clear air, though sensors' data: {count} files: {listed(folders)}.")
    if summary.gone:
        what = "deleted" if summary.pruned else "SRC has them no more; --prune deletes them"
        notes.append(f"results without a source: {len(summary.gone)} files ({what}): {listed(summary.gone)}.")
    return [*notes, *summary.notes]


def _formats(endings: list[str]) -> dict[str, str]:
    """Kind of sensor to the ending of its results."""
    from torchweather.io import IMAGE_SUFFIXES, POINT_SUFFIXES

    found: dict[str, str] = {}
    for given in endings:
        ending = f".{given.lstrip('.').lower()}"
        kinds = [
            kind for kind, known in (("camera", IMAGE_SUFFIXES), ("lidar", tuple(POINT_SUFFIXES))) if ending in known
        ]
        if not kinds:
            raise InputValueError(
                f"augment: --format must be one of {', '.join(dict.fromkeys([*IMAGE_SUFFIXES, *POINT_SUFFIXES]))}; got "
                f"{given!r}."
            )
        for kind in kinds:
            found.setdefault(kind, ending)
    return found


def _text(summary: Summary, *, dry_run: bool) -> str:
    there = f"layout {summary.layout}: {summary.frames} frames, {summary.copies} files carried along"
    if dry_run:
        return f"{there}; {summary.skipped} done before, {summary.to_do} to do. Nothing was written."
    counts = f"{summary.skipped} done before, {summary.done} done now, {len(summary.broken)} broken"
    lines = [f"{there}; {counts}, in {summary.seconds:.1f} s", f"manifest: {shown(str(summary.manifest))}"]
    if summary.stopped:
        left = summary.to_do - summary.done - len(summary.broken)
        lines.append(
            f"stopped, the disk is full ({summary.stopped}): {left} left to do. Nothing is half written; make room and "
            "run the same command again."
        )
    return "\n".join(lines)


# Notes of the manifest that need no warning: rows of a sweep, depth that is not guessed.
COUNTS = ": sweep of "
SURE = tuple(f": depth {one}" for one in ("exact", "measured", "completed"))


class _Shown:
    """Progress on standard error: a bar on a terminal, else a line now and then; a line for each broken frame."""

    def __init__(self, quiet: bool) -> None:
        self.quiet = quiet
        self.bar: Any = None
        self.noted: set[str] = set()
        self.finished = self.total = 0
        self.began = self.said = time.monotonic()

    def tell(self, progress: Progress) -> None:
        self.finished, self.total = progress.finished, progress.total
        if progress.row is not None:
            self._say(progress.row)
        if self.quiet:
            return
        if not sys.stderr.isatty():
            self._now_and_then(progress)
        elif self.bar is None:
            from tqdm import tqdm

            self.bar = tqdm(total=progress.total, unit="frame", file=sys.stderr)
        else:
            self.bar.update()

    def _say(self, row: Row) -> None:
        if row.error is not None:
            self._line(f"broken: {row.frame}: {row.error}")
        for text in row.notes:
            if text.endswith(SURE) or COUNTS in text:
                continue
            # Of a thousand frames with the same trouble, which differ in the numbers, one is shown.
            kind = re.sub(r"[\d.]+", "", text)
            if kind not in self.noted:
                self.noted.add(kind)
                self._line(f"warning: {text} (first in {row.frame}; the manifest has them all)")

    def close(self) -> None:
        if self.bar is not None:
            self.bar.close()

    def _line(self, text: str) -> None:
        if self.bar is not None:
            self.bar.clear()
        note(text)

    def _now_and_then(self, progress: Progress) -> None:
        now = time.monotonic()
        if progress.finished == 0:
            note(f"{progress.total} to do")
        elif now - self.said >= EVERY_S and progress.finished < progress.total:
            self.said = now
            rate = progress.finished / (now - self.began)
            left = (progress.total - progress.finished) / rate
            note(f"{progress.finished} of {progress.total}, {rate:.2f} a second, {left / 60:.1f} minutes left")
