"""``torchweather robustness``: an ONNX detector over weathers and severities, its rates as tables and a page."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

from torchweather.commands.clouds import LIDAR_FIELDS, add_lidar_fields
from torchweather.commands.frames import CAMERA_ARGUMENTS, add_camera_arguments, add_depth_arguments

if TYPE_CHECKING:
    from torchweather.robustness import Declaration, LabelledFrame
    from torchweather.transforms.recipes import Recipe
    from torchweather.transforms.suites import Suite

NAME = "robustness"
SUMMARY = "an ONNX detector in weather of five severities: a page, mean corruption error, resilience rate"
DESCRIPTION = """Puts the weathers of a suite (torchweather list) on labelled frames or clouds, runs an ONNX detector on
them with onnxruntime, and holds what it finds against the ground truth. Writes robustness.csv, performance.csv,
scores.csv, robustness.json, index.html and correlation/. The detector's inputs, outputs and decoder are declared in
YAML. DIR holds images/ (or clouds/; else the files lie in DIR), depth/ with a map for each image, and the truth:
annotations.json (COCO) for boxes, labels/ for segmentation. A single recipe is one condition."""

# By the sensor: folders that may hold the data, and arguments that belong to it.
FOLDERS = {"camera": ("images", "image_2"), "lidar": ("clouds", "velodyne")}
ARGUMENTS = {"camera": CAMERA_ARGUMENTS, "lidar": (*LIDAR_FIELDS, "intensity")}
SUITE_DEFAULT = "robustness"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments of the command."""
    parser.add_argument("--model", type=Path, required=True, metavar="ONNX", help="the detector")
    parser.add_argument(
        "--declare", type=Path, metavar="YAML", help="what it takes and gives; default the model's name with .yaml"
    )
    parser.add_argument(
        "--recipe", help="suite or recipe, by name or file; default the sensor's suite, such as camera/robustness"
    )
    parser.add_argument("--data", type=Path, required=True, metavar="DIR", help="frames or clouds, depth, truth")
    parser.add_argument(
        "--truth", type=Path, metavar="JSON|DIR", help="default annotations.json or labels/ of the data"
    )
    parser.add_argument("-o", "--out", type=Path, required=True, help="folder for the tables and the page")
    parser.add_argument("--sensor", help="camera or lidar, with :PRESET; default the suite's, else the first preset")
    parser.add_argument("--seed", type=int, default=0, help="of all storms; default 0")
    parser.add_argument("--seeds", type=int, default=1, metavar="N", help="storms of each frame; default 1")
    parser.add_argument(
        "--metrics", help="scores of the data, names joined by commas, or none; default all that the sensor has"
    )
    parser.add_argument(
        "--iou", default="0.5", help="overlaps from which on a box is a hit, joined by commas, or coco (0.5 to 0.95)"
    )
    parser.add_argument("--baseline", type=Path, metavar="DIR", help="another run's: mCE is relative to its errors")
    parser.add_argument("--quiet", action="store_true", help="no progress, no notes")
    parser.add_argument(
        "--airlight",
        nargs=3,
        type=float,
        metavar=("R", "G", "B"),
        help="of a camera: linear signal of the sky, 0..1 of saturation; default the frame's own",
    )
    parser.add_argument("--ego-speed-m-per-s", type=float, help="of a camera: speed of the vehicle")
    add_depth_arguments(parser)
    add_camera_arguments(parser)
    add_lidar_fields(parser.add_argument_group("lidar", "replaces what the preset says"))


def run(args: argparse.Namespace) -> int:
    """Run and write."""
    from tqdm import tqdm

    from torchweather.commands.output import note, print_json, print_lines
    from torchweather.report.robustness_page import write_robustness
    from torchweather.robustness import OnnxDetector, conditions_of, read_declaration, run_robustness
    from torchweather.robustness.baseline import read_baseline

    declaration = read_declaration(args.declare or args.model.with_suffix(".yaml"))
    detector = OnnxDetector(args.model, declaration)
    source = _source(args.recipe or f"{declaration.sensor}/{SUITE_DEFAULT}", declaration)
    conditions = conditions_of(source)
    preset = _checked_preset(args, declaration, source)
    baseline = None if args.baseline is None else read_baseline(args.baseline)
    metrics = None if args.metrics is None else [m.strip() for m in args.metrics.split(",") if m.strip() != "none"]
    thresholds = _thresholds(args.iou)
    notes: list[str] = []
    frames = _Frames(args, declaration, source, preset, notes)
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
    from torchweather.explain import aligned

    weathers: dict[str, list[dict[str, Any]]] = {}
    for each in summary["conditions"]:
        weathers.setdefault(each["weather"], []).append(each)
    severities = max(len(group) for group in weathers.values())
    head = [summary["measure"], "clear", *(str(k + 1) for k in range(severities)), "RR", "CE"]
    rows = [
        [
            name,
            _number(summary["clear"]),
            *(_number(each["performance"]) for each in group),
            *([""] * (severities - len(group))),
            _number(summary["resilience_rate"][name]),
            _number(summary["corruption_error"][name]),
        ]
        for name, group in weathers.items()
    ]
    mean = ["mean", *([""] * (severities + 1)), *map(_number, (summary["mean_resilience_rate"],))]
    return aligned([head, *rows, [*mean, _number(summary["mean_corruption_error"])]])


def _number(value: float | None) -> str:
    return "-" if value is None else f"{value:.3f}"


def _source(name: str, declaration: Declaration) -> Suite | Recipe:
    """The suite or the recipe of a name or a file, which must be of the detector's sensor."""
    from torchweather.transforms.recipe_files import RECIPE, SUITE, files_of, find, format_of, name_of
    from torchweather.transforms.recipes import read_recipe
    from torchweather.transforms.suites import read_suite

    own = f"{declaration.sensor}/{name}"
    names = [name_of(path) for path in files_of(SUITE, RECIPE)]
    path = find(own if own in names else name, "suite or recipe", SUITE, RECIPE)
    found: Suite | Recipe = read_suite(path) if format_of(path).startswith(SUITE) else read_recipe(path)
    if found.sensor_kind != declaration.sensor:
        raise ValueError(
            f"robustness: {found.name} is for a {found.sensor_kind}; the detector is for a {declaration.sensor}."
        )
    return found


def _checked_preset(args: argparse.Namespace, declaration: Declaration, source: Suite | Recipe) -> str:
    """The sensor's preset; refuses arguments of another sensor."""
    from torchweather.sensors import DEFAULT_PRESETS

    kind, _, preset = (args.sensor or declaration.sensor).partition(":")
    if kind != declaration.sensor:
        raise ValueError(f"robustness: --sensor is a {kind}; the detector is for a {declaration.sensor}.")
    for other, names in ARGUMENTS.items():
        for name in names:
            if other != kind and getattr(args, name) not in (None, False):
                raise ValueError(f"robustness: --{name.replace('_', '-')} is for a {other}; the sensor is a {kind}.")
    return preset or str(source.sensor.get("preset") or DEFAULT_PRESETS[kind])


def _thresholds(text: str) -> list[float]:
    if text == "coco":
        return [round(0.5 + 0.05 * k, 2) for k in range(10)]
    try:
        found = [float(each) for each in text.split(",")]
    except ValueError:
        found = []
    if not found or not all(0 < each <= 1 for each in found):
        raise ValueError(f"robustness: --iou must be numbers in (0, 1] joined by commas, or coco; got {text!r}.")
    return found


class _Frames:
    """The frames or clouds of the data with their truth, read one after another; the truth is looked for beforehand."""

    def __init__(
        self,
        args: argparse.Namespace,
        declaration: Declaration,
        source: Suite | Recipe,
        preset: str,
        notes: list[str],
    ) -> None:
        from torchweather.commands.clouds import gathered_clouds
        from torchweather.commands.frames import gathered
        from torchweather.commands.sweep_inputs import MAKERS
        from torchweather.robustness import read_boxes_truth
        from torchweather.robustness.run import stem_of
        from torchweather.robustness.truth import LABEL_SUFFIXES, frame_truth

        if not args.data.is_dir():
            raise ValueError(f"{args.data}: no such folder; wanted one with {FOLDERS[declaration.sensor][0]}/.")
        inside = [args.data / name for name in FOLDERS[declaration.sensor] if (args.data / name).is_dir()]
        gather = gathered if declaration.sensor == "camera" else gathered_clouds
        self.files = gather([inside[0] if inside else args.data])
        self.stems = [stem_of(file) for file in self.files]
        twice = {stem for stem in self.stems if self.stems.count(stem) > 1}
        if twice:
            raise ValueError(f"{args.data}: wanted files of different names; {', '.join(sorted(twice))} stands twice.")
        self.declaration = declaration
        self.truths: Any = None
        if declaration.decoder == "boxes":
            where = args.truth or args.data / "annotations.json"
            self.truths = read_boxes_truth(where, declaration.classes)
            for stem in self.stems:
                frame_truth(self.truths, stem, str(where))
        else:
            self.labels = args.truth or args.data / "labels"
            for stem in self.stems:
                if not any(
                    (self.labels / f"{stem}{suffix}").is_file() for suffix in LABEL_SUFFIXES[declaration.sensor]
                ):
                    wanted = ", ".join(LABEL_SUFFIXES[declaration.sensor])
                    raise ValueError(f"{self.labels}: no ground truth for {stem}; wanted {stem} with {wanted}.")
        if declaration.sensor == "camera" and args.depth is None and (args.data / "depth").is_dir():
            args.depth = str(args.data / "depth")
        # What a sweep can say and this command does not.
        args.region, args.complete_scan, args.meta = None, False, None
        self.maker = MAKERS[declaration.sensor](args, preset, notes)
        self.options = dict(source.options)
        self._take_fields(args, source, preset)

    def _take_fields(self, args: argparse.Namespace, source: Suite | Recipe, preset: str) -> None:
        """What the suite or recipe says of its sensor beside the preset; the command line's own stands above it."""
        from torchweather.commands.clouds import lidar_fields
        from torchweather.commands.frames import camera_fields
        from torchweather.transforms.recipes import camera_of, lidar_of

        if self.declaration.sensor == "camera":
            fields = {**source.sensor, **camera_fields(args)}
            self.maker.camera = camera_of({**fields, "kind": "camera", "preset": preset})  # type: ignore[attr-defined]
        else:
            fields = {**source.sensor, **lidar_fields(args)}
            self.maker.lidar = lidar_of({**fields, "kind": "lidar", "preset": preset})  # type: ignore[attr-defined]

    def __iter__(self) -> Iterator[LabelledFrame]:
        from dataclasses import replace

        from torchweather.errors import TorchweatherError
        from torchweather.robustness import LabelledFrame, read_label_truth
        from torchweather.sweep import CameraSubject, LidarSubject

        for file, stem in zip(self.files, self.stems, strict=True):
            subjects = self.maker.files(file)
            if len(subjects) != 1:
                raise TorchweatherError(f"{file}: wanted one frame a file; got {len(subjects)}.")
            subject = subjects[0]
            assert isinstance(subject, (CameraSubject, LidarSubject))
            options = {key: value for key, value in self.options.items() if key not in ("depth", "lost")}
            subject = replace(subject, options={**options, **subject.options})
            if self.truths is not None:
                yield LabelledFrame(stem, subject, self.truths[stem])
                continue
            shape = (
                (len(subject.points),)
                if isinstance(subject, LidarSubject)
                else (int(subject.data.shape[-2]), int(subject.data.shape[-1]))
            )
            truth = read_label_truth(self.labels, stem, self.declaration.sensor, shape)
            yield LabelledFrame(stem, subject, truth)
