"""``torchweather robustness``: an ONNX detector over weathers and severities, its rates as tables and a page."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

from torchweather.cli.clouds import LIDAR_FIELDS, add_lidar_fields
from torchweather.cli.frames import (
    CAMERA_ARGUMENTS,
    add_camera_arguments,
    add_depth_arguments,
    add_light_arguments,
    add_through_mosaic,
)
from torchweather.cli.robustness_frames import RobustnessFrames, truth_file
from torchweather.core.exceptions import InputValueError

if TYPE_CHECKING:
    from torchweather.evaluation.robustness import Declaration
    from torchweather.recipes.suite import SuiteRecipe
    from torchweather.recipes.transform import TransformRecipe

NAME = "robustness"
SUMMARY = "an ONNX detector in weather of five severities: a page, mean corruption error, resilience rate"
DESCRIPTION = """Puts the weathers of a recipe (torchweather list) on labelled frames or clouds. Runs an ONNX
detector on them with onnxruntime, and compares its answer with the ground truth. Writes robustness.csv,
performance.csv, scores.csv, robustness.json, index.html and correlation/. The detector's inputs, outputs and decoder
are declared in YAML; without a declaration one is written from the graph, to be filled in. DIR holds images/ (or
clouds/; else the files lie in DIR), depth/ with a map for each image, and the truth: annotations.json (COCO) for
boxes, labels/ for segmentation. A recipe of kind transform is one condition. Guessed depth, such as flat ground, is
refused unless --allow-guessed-depth is given."""

# By the sensor: arguments that belong to it.
ARGUMENTS = {"camera": CAMERA_ARGUMENTS, "lidar": (*LIDAR_FIELDS, "intensity")}
SUITE_DEFAULT = "robustness"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments of the command."""
    parser.add_argument("--model", type=Path, required=True, metavar="ONNX", help="the detector")
    parser.add_argument(
        "--declare",
        type=Path,
        metavar="YAML",
        help="its inputs, outputs and decoder; default the model's name with .yaml; written where there is none",
    )
    parser.add_argument(
        "--recipe", help="recipe of kind suite or transform; default the sensor's suite, such as camera/robustness"
    )
    parser.add_argument("--data", type=Path, required=True, metavar="DIR", help="frames or clouds, depth, truth")
    parser.add_argument(
        "--truth", type=Path, metavar="JSON|DIR", help="default annotations.json or labels/ of the data"
    )
    parser.add_argument("-o", "--out", type=Path, help="folder for the tables and the page")
    parser.add_argument("--sensor", help="camera or lidar, with :PRESET; default the suite's, else the first preset")
    parser.add_argument("--seed", type=int, default=0, help="of all storms; default 0")
    parser.add_argument("--seeds", type=int, default=1, metavar="N", help="storms of each frame; default 1")
    parser.add_argument(
        "--metrics", help="scores of the data, names joined by commas, or none; default all that the sensor has"
    )
    parser.add_argument(
        "--iou", default="0.5", help="overlaps from which on a box is a hit, joined by commas, or coco (0.5 to 0.95)"
    )
    parser.add_argument(
        "--resamples",
        type=int,
        default=1000,
        metavar="N",
        help="draws of the frames for 95%% intervals; 0: none; default 1000",
    )
    parser.add_argument(
        "--allow-guessed-depth",
        action="store_true",
        help='run on guessed depth too, such as flat ground; the results are headed "depth guessed"',
    )
    parser.add_argument("--baseline", type=Path, metavar="DIR", help="another run's: mCE is relative to its errors")
    parser.add_argument("--quiet", action="store_true", help="no progress, no notes")
    add_light_arguments(parser)
    parser.add_argument("--ego-speed-m-per-s", type=float, help="of a camera: speed of the vehicle")
    add_depth_arguments(parser)
    add_camera_arguments(parser)
    add_through_mosaic(parser)
    add_lidar_fields(parser.add_argument_group("lidar", "replaces what the preset says"))


def run(args: argparse.Namespace) -> int:
    """Run and write."""
    from tqdm import tqdm

    from torchweather.cli.output import note, print_json, print_lines
    from torchweather.core.errors import TorchweatherError
    from torchweather.evaluation.robustness import OnnxDetector, conditions_of, read_declaration, run_robustness
    from torchweather.evaluation.robustness.baseline import read_baseline
    from torchweather.evaluation.robustness.draft import draft_declaration
    from torchweather.report.robustness_page import write_robustness

    declared = args.declare or args.model.with_suffix(".yaml")
    if not declared.exists() and args.model.is_file():
        raise TorchweatherError(draft_declaration(args.model, declared, truth_file(args)))
    declaration = read_declaration(declared)
    if args.out is None:
        raise InputValueError("robustness: --out is missing; give the folder for the tables and the page.")
    detector = OnnxDetector(args.model, declaration)
    source = _source(args.recipe or f"{declaration.sensor}/{SUITE_DEFAULT}", declaration)
    conditions = conditions_of(source)
    preset = _checked_preset(args, declaration, source)
    baseline = None if args.baseline is None else read_baseline(args.baseline)
    metrics = None if args.metrics is None else [m.strip() for m in args.metrics.split(",") if m.strip() != "none"]
    thresholds = _thresholds(args.iou)
    notes: list[str] = []
    frames = RobustnessFrames(args, declaration, source, preset, notes)
    total = len(frames.files) * len(conditions)
    with tqdm(
        total=total, desc="robustness", unit="condition", disable=args.quiet or not sys.stderr.isatty()
    ) as progress:
        summary = write_robustness(
            args.out,
            lambda look: run_robustness(
                frames,
                detector,
                conditions,
                seed=args.seed,
                seeds=args.seeds,
                metrics=metrics,
                thresholds=thresholds,
                resamples=args.resamples,
                allow_guessed_depth=args.allow_guessed_depth,
                look=look,
                progress=progress.update,
            ),
            declaration,
            model=args.model.name,
            recipe=source.name,
            sensor=f"{declaration.sensor}:{preset}",
            seed=args.seed,
            baseline=baseline,
            notes=notes,
        )
    for text in summary["notes"]:
        note(text, quiet=args.quiet)
    if args.json:
        print_json(summary)
    else:
        print_lines("\n".join([*robustness_lines(summary), f"wrote {args.out / 'index.html'}"]))
    return 0


def robustness_lines(summary: dict[str, Any]) -> list[str]:
    """The numbers as text."""
    from torchweather.core.text import aligned

    weathers: dict[str, list[dict[str, Any]]] = {}
    for each in summary["conditions"]:
        weathers.setdefault(each["weather"], []).append(each)
    severities = max(len(group) for group in weathers.values())
    head = [summary["measure"], "clear", *(str(k + 1) for k in range(severities)), "RR", "CE"]
    rows = [
        row
        for name, group in weathers.items()
        for row in (
            [
                name,
                _number(summary["clear"]),
                *(_number(each["performance"]) for each in group),
                *([""] * (severities - len(group))),
                _number(summary["resilience_rate"][name]),
                _number(summary["corruption_error"][name]),
            ],
            [
                "  95 %",
                _span(summary["clear_interval"]),
                *(_span(each["interval"]) for each in group),
                *([""] * (severities - len(group) + 2)),
            ],
        )
        if summary["resamples"] or not row[0].startswith(" ")
    ]
    mean = ["mean", *([""] * (severities + 1)), *map(_number, (summary["mean_resilience_rate"],))]
    table = aligned([head, *rows, [*mean, _number(summary["mean_corruption_error"])]])
    return [*([summary["headline"].upper()] if summary["headline"] else []), *table]


def _span(interval: list[float] | None) -> str:
    """Both ends of an interval."""
    return "-" if interval is None else f"{interval[0]:.2f}-{interval[1]:.2f}"


def _number(value: float | None) -> str:
    return "-" if value is None else f"{value:.3f}"


def _source(name: str, declaration: Declaration) -> SuiteRecipe | TransformRecipe:
    """The suite or the recipe of a name or a file, which must be of the detector's sensor."""
    from torchweather.recipes import MultiSensorRecipe, read_recipe
    from torchweather.recipes.files import ready_made

    own, kinds = f"{declaration.sensor}/{name}", ("suite", "transform")
    found = read_recipe(own if own in ready_made(kinds) else name, kinds)
    assert not isinstance(found, MultiSensorRecipe)
    if found.sensor_kind != declaration.sensor:
        raise InputValueError(
            f"robustness: {found.name} is for a {found.sensor_kind}; the detector is for a {declaration.sensor}."
        )
    return found


def _checked_preset(args: argparse.Namespace, declaration: Declaration, source: SuiteRecipe | TransformRecipe) -> str:
    """The sensor's preset; refuses arguments of another sensor."""
    from torchweather.sensors import DEFAULT_PRESETS

    kind, _, preset = (args.sensor or declaration.sensor).partition(":")
    if kind != declaration.sensor:
        raise InputValueError(f"robustness: --sensor is a {kind}; the detector is for a {declaration.sensor}.")
    for other, names in ARGUMENTS.items():
        for name in names:
            if other != kind and getattr(args, name) not in (None, False):
                raise InputValueError(
                    f"robustness: --{name.replace('_', '-')} is for a {other}; the sensor is a {kind}."
                )
    return preset or str(source.sensor.get("preset") or DEFAULT_PRESETS[kind])


def _thresholds(text: str) -> list[float]:
    if text == "coco":
        return [round(0.5 + 0.05 * k, 2) for k in range(10)]
    try:
        found = [float(each) for each in text.split(",")]
    except ValueError:
        found = []
    if not found or not all(0 < each <= 1 for each in found):
        raise InputValueError(f"robustness: --iou must be numbers in (0, 1] joined by commas, or coco; got {text!r}.")
    return found
