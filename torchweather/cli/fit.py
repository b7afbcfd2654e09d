"""``torchweather fit``: rate or visibility of recorded frames, by several estimators side by side."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING, Any

from torchweather.cli.scene_parts import add_ignored_parts
from torchweather.core.exceptions import InputValueError

if TYPE_CHECKING:
    from torchweather.gap.study.study import Study

NAME = "fit"
SUMMARY = "rate or visibility of recorded frames, with intervals, by several estimators"
DESCRIPTION = """Fits the rate or visibility of every condition of a study folder, or of a folder of frames beside
clear frames of the same scene. A camera is fitted in fog, with airlight and gain of the exposure. A LiDAR is fitted
by paired intensities, a radar by targets such as corner reflectors. Each estimator is listed by name, with 90 %
intervals by bootstrap over frames and the misfit of the residuals."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments of the command."""
    parser.add_argument("frames", type=Path, metavar="STUDY", help="folder with study.yaml, or of frames in weather")
    parser.add_argument(
        "--clear", type=Path, metavar="DIR", help="of a folder of frames: clear frames of the same scene"
    )
    parser.add_argument("--sensor", metavar="KIND:PRESET", help="of a folder of frames, such as lidar:ouster-os1-128")
    parser.add_argument(
        "--weather", metavar="TEXT", help="of a folder of frames: kind and a first guess, such as fog:mor=200"
    )
    parser.add_argument("--depth", metavar="FILE", help="of a camera's frames: depth file, or a number in metres")
    parser.add_argument("--depth-encoding", metavar="NAME", help="of a depth file that holds integers")
    parser.add_argument("--mask", type=Path, metavar="NPY", help="array (H, W), true for what does not count")
    add_ignored_parts(
        parser,
        'parts of a camera\'s picture that do not count, as the warning "scene changed" names them',
    )
    parser.add_argument("--estimators", help="names joined by commas; default all")
    parser.add_argument("--bootstrap", type=int, default=400, help="samples of the frames; default 400")
    parser.add_argument("--seed", type=int, default=0, help="of these samples; default 0")


def run(args: argparse.Namespace) -> int:
    """Fit and print."""
    from torchweather.cli.output import print_json, print_lines
    from torchweather.evaluation.fit import fit_weather

    names = None if args.estimators is None else [name.strip() for name in args.estimators.split(",") if name.strip()]
    if names is not None and not names:
        raise InputValueError("fit: --estimators must name one or more, such as slope; got none.")
    study = _study(args)
    found = fit_weather(
        study,
        estimators=names,
        mask=_mask(args.mask),
        bootstrap=args.bootstrap,
        seed=args.seed,
        ignore_parts=args.ignore_parts,
    )
    if args.json:
        print_json(found.to_dict())
    else:
        print_lines(found.text())
    return 0


def _study(args: argparse.Namespace) -> Study:
    from torchweather.gap.study.folders import study_from_folders
    from torchweather.gap.study.study import Study

    of_folders = {f"--{name}": getattr(args, name) for name in ("clear", "sensor", "weather")}
    given = [name for name, value in of_folders.items() if value is not None]
    if not given:
        if args.depth is not None or args.depth_encoding is not None:
            raise InputValueError("fit: --depth belongs to a folder of frames with --clear; a study has its own depth.")
        return Study.read(args.frames)
    missing = [name for name in of_folders if name not in given]
    if missing:
        raise InputValueError(f"fit: a folder of frames needs {', '.join(of_folders)}; missing: {', '.join(missing)}.")
    depth: Any = args.depth
    try:
        depth = None if depth is None else float(depth)
    except ValueError:
        depth = Path(depth)
    return study_from_folders(
        args.clear, {args.frames: args.weather}, args.sensor, depth=depth, depth_encoding=args.depth_encoding
    )


def _mask(path: Path | None) -> Any:
    import numpy as np

    if path is None:
        return None
    try:
        return np.load(path, allow_pickle=False)
    except (ValueError, EOFError) as error:
        text = f"fit: --mask {path}: expected a NumPy array (.npy) without objects; got {error}."
        raise InputValueError(text) from error
