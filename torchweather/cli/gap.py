"""``torchweather gap``: the effect that the simulation of a study lacks, as JSON, as a model and as a page.

``torchweather gap demo`` makes a study of its own first (``gap_demo.py``).
"""

from __future__ import annotations

import argparse
from pathlib import Path

from torchweather.cli import gap_demo
from torchweather.cli.scene_parts import add_ignored_parts
from torchweather.core.exceptions import InputValueError

NAME = "gap"
SUMMARY = "where simulation and measurement of a study disagree, and which effect is missing"
DESCRIPTION = """Compares every condition of a study folder with its simulation: frames measured in weather, and
clear frames of the same scene. Looks for the effect of the catalogue that explains the difference, and tests it on
conditions held out. Writes gap.json (the answer), model.yaml (the effects to add) and report.html. That nothing is
missing, and that something is missing which no effect explains, are answers too: the exit code is 0 whatever the
verdict. Takes studies of LiDARs, cameras, radars and microwave links.

torchweather gap demo --out DIR makes a small study of the embedded scene and hides an effect in it, drawn at random.
It searches the study, and shows side by side what was hidden and what was found. With --allow-none there is at times
nothing to find. A study folder of that name is ./demo."""

DEMO = "demo"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments of the command."""
    parser.add_argument("study", metavar="STUDY", help="folder with study.yaml, or demo")
    parser.add_argument("-o", "--out", type=Path, required=True, help="folder for gap.json, model.yaml and report.html")
    parser.add_argument(
        "--effects",
        help="that may be named, ids joined by commas, such as lidar.window_loss; default the whole catalogue",
    )
    parser.add_argument(
        "--seed",
        type=int,
        help="of the simulation; default 0. Of all that is drawn for the demo; default another each time",
    )
    add_ignored_parts(
        parser,
        'parts of a camera\'s picture that are no change of the scene, as the error "scene changed" names them',
    )
    parser.add_argument(
        "--allow-none", action="store_true", help="of the demo: hide no effect as often as any one of them"
    )
    parser.add_argument(
        "--max-frames",
        type=int,
        metavar="N",
        help="try no further effect once N frames were simulated; default no limit",
    )
    parser.add_argument("--quiet", action="store_true", help="no progress")


def run(args: argparse.Namespace) -> int:
    """Search and write."""
    if args.study == DEMO:
        return gap_demo.run(args)
    from torchweather.cli.output import note, print_json, print_lines
    from torchweather.gap import find
    from torchweather.gap.study.study import Study
    from torchweather.report.gap_page import write_gap
    from torchweather.report.gap_words import verdict_sentence

    if args.allow_none:
        raise InputValueError("gap: --allow-none belongs to the demo; it has no effect on a study. Leave it out.")
    effects = None if args.effects is None else [name.strip() for name in args.effects.split(",") if name.strip()]
    if effects is not None and not effects:
        raise InputValueError("gap: --effects must name an effect or more, such as lidar.window_loss; got none.")
    study = Study.read(args.study)
    report = find.find_gap(
        study,
        effects=effects,
        seed=args.seed or 0,
        ignore_parts=args.ignore_parts,
        max_frames=args.max_frames,
        progress=lambda text: note(text, quiet=args.quiet),
    )
    answer = write_gap(args.out, study, report, effects=effects)
    if args.json:
        print_json(answer)
    else:
        print_lines(f"{verdict_sentence(answer)}\nwrote {args.out / 'report.html'}")
    return 0
