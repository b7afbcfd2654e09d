"""``torchweather validate``: simulated frames of a study beside its measured ones, as a page."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import TYPE_CHECKING

from torchweather.cli.scene_parts import add_ignored_parts
from torchweather.core.exceptions import InputValueError

if TYPE_CHECKING:
    from torchweather.gap.study.study import Study

NAME = "validate"
SUMMARY = "simulation beside measurement: scores, trends and pictures of a study"
DESCRIPTION = """Simulates every condition of a study folder: frames measured in weather, and clear frames of the
same scene. Scores measured and simulated frames against clear ones, and writes a page. The page has pictures side by
side, scores with the floor of clear against clear frames, trends, run time, and what the study lacks. For each
comparison it states the smallest change of rate or visibility that the same frames would have flagged with 80 %
power. Frames that could not show a factor of 2 decide nothing. --power-effects adds the smallest strength of named
effects that they would have flagged. The page shows what disagrees, not why.
scene:test-track is a study that the library makes of an embedded scene, without any measurement."""

SCENE = "scene:"  # begins the name of an embedded scene


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments of the command."""
    parser.add_argument("study", metavar="STUDY", help="folder with study.yaml, or scene:NAME")
    parser.add_argument("-o", "--out", type=Path, required=True, help="folder for index.html and validation.json")
    parser.add_argument("--sensor", metavar="KIND[:PRESET]", help="of scene:NAME: lidar (default), camera or radar")
    parser.add_argument("--seed", type=int, default=0, help="of the simulation; default 0")
    parser.add_argument("--metrics", help="names joined by commas; default all that the frames can have")
    parser.add_argument(
        "--no-power",
        action="store_true",
        help="simulate no other rates: three times as fast, but then nothing is called agreement",
    )
    parser.add_argument(
        "--power-effects",
        metavar="EFFECTS",
        help="ids joined by commas, such as lidar.window_loss, or all: the smallest strength of each that these frames "
        "would have flagged; all of them take several times as long",
    )
    add_ignored_parts(
        parser,
        'parts of a camera\'s picture that do not count, as the finding "scene changed" names them',
    )
    parser.add_argument("--quiet", action="store_true", help="no progress, no notes")


def run(args: argparse.Namespace) -> int:
    """Validate and write the page."""
    from tqdm import tqdm

    from torchweather.cli.output import note, print_json, print_lines
    from torchweather.evaluation.validation.run import validate
    from torchweather.report.validation_page import write_validation

    self_check = args.study.startswith(SCENE)
    names = None if args.metrics is None else _split(args.metrics)
    effects = _split(args.power_effects or "")
    if names is not None and not names:
        raise InputValueError("validate: --metrics must name a score or more, such as psnr,ssim; got none.")
    if args.power_effects is not None and not effects:
        raise InputValueError("validate: --power-effects must name an effect or more, or all; got none.")
    study = _study(args)
    shown = not args.quiet and sys.stderr.isatty()
    with tqdm(total=len(study.conditions), desc="conditions", disable=not shown, leave=False) as bar:
        validation = validate(
            study,
            seed=args.seed,
            names=names,
            step=bar.update,
            power=not args.no_power,
            effects=effects,
            ignore_parts=args.ignore_parts,
        )
    for finding in validation.findings:
        if finding.level == "error":
            note(str(finding), quiet=args.quiet)
    summary = write_validation(args.out, study, validation, self_check=self_check)
    if args.json:
        print_json(summary)
    else:
        print_lines(f"{validation.verdict()}\nwrote {args.out / 'index.html'}")
    return 0


def _split(names: str) -> list[str]:
    return [name.strip() for name in names.split(",") if name.strip()]


def _study(args: argparse.Namespace) -> Study:
    from torchweather.gap.study.embedded import EMBEDDED_KINDS, embedded_study
    from torchweather.gap.study.study import Study

    if not args.study.startswith(SCENE):
        if args.sensor is not None:
            raise InputValueError("validate: --sensor belongs to scene:NAME; a study folder names its sensor.")
        return Study.read(args.study)
    kind, _, preset = (args.sensor or "lidar").partition(":")
    if kind not in EMBEDDED_KINDS:
        raise InputValueError(f"validate: --sensor must be one of {', '.join(EMBEDDED_KINDS)}; got {kind!r}.")
    return embedded_study(kind, preset=preset or None, scene=args.study.removeprefix(SCENE), seed=args.seed)
