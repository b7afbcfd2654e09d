"""The frames or clouds of ``torchweather robustness`` with their truth and depth."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

from torchweather.core.exceptions import InputValueError

if TYPE_CHECKING:
    from torchweather.evaluation.robustness import Declaration, LabelledFrame
    from torchweather.recipes.suite import SuiteRecipe
    from torchweather.recipes.transform import TransformRecipe

__all__ = ["RobustnessFrames", "truth_file"]

FOLDERS = {"camera": ("images", "image_2"), "lidar": ("clouds", "velodyne")}
"""By the sensor: folders that may hold the data."""


def _find_depth(args: argparse.Namespace, file: Path, stem: str) -> None:
    """Take the depth in the data; a guessed one is refused before the first frame, as all have the same source."""
    from torchweather.camera.depth import GUESSED
    from torchweather.cli.frames import depth_source
    from torchweather.core.errors import TorchweatherError
    from torchweather.evaluation.robustness.run import guessed_depth_error

    if args.depth is None and (args.data / "depth").is_dir():
        args.depth = str(args.data / "depth")
    if args.allow_guessed_depth:
        return
    # Without --depth, a picture's depth is guessed from it and a raw frame's is flat ground: both are guesses.
    if depth_source(args.depth or "ground", args.depth_encoding, file, args=args).confidence == GUESSED:
        raise TorchweatherError(guessed_depth_error(stem))


BEFORE: dict[str, Callable[[argparse.Namespace, Path, str], None]] = {"camera": _find_depth}
"""By the sensor: what is settled with the first file and its stem before any frame is rendered."""


def truth_file(args: argparse.Namespace) -> Path:
    """COCO's JSON, given or in the data."""
    return Path(args.truth or args.data / "annotations.json")


class RobustnessFrames:
    """The frames or clouds of the data with their truth, read one after another; the truth is looked for beforehand."""

    def __init__(
        self,
        args: argparse.Namespace,
        declaration: Declaration,
        source: SuiteRecipe | TransformRecipe,
        preset: str,
        notes: list[str],
    ) -> None:
        from torchweather.cli.sweep_inputs import MAKERS
        from torchweather.evaluation.robustness import read_boxes_truth
        from torchweather.evaluation.robustness.frames import stem_of
        from torchweather.evaluation.robustness.truth import LABEL_SUFFIXES, frame_truth

        if not args.data.is_dir():
            raise InputValueError(f"{args.data}: no such folder; expected one with {FOLDERS[declaration.sensor][0]}/.")
        inside = [args.data / name for name in FOLDERS[declaration.sensor] if (args.data / name).is_dir()]
        maker = MAKERS[declaration.sensor]
        self.files = maker.gathered([inside[0] if inside else args.data])
        self.stems = [stem_of(file) for file in self.files]
        twice = {stem for stem in self.stems if self.stems.count(stem) > 1}
        if twice:
            raise InputValueError(
                f"{args.data}: expected files of different names; {', '.join(sorted(twice))} stands twice."
            )
        self.declaration = declaration
        self.truths: Any = None
        if declaration.task == "boxes":
            where = truth_file(args)
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
                    raise InputValueError(f"{self.labels}: no ground truth for {stem}; expected {stem} with {wanted}.")
        if declaration.sensor in BEFORE:
            BEFORE[declaration.sensor](args, self.files[0], self.stems[0])
        # What a sweep can say and this command does not.
        args.region, args.complete_scan, args.sky_only, args.meta = None, False, False, None
        self.maker = maker(args, preset, notes)
        self.maker.take_fields(source.sensor)
        self.options = dict(source.options)

    def __iter__(self) -> Iterator[LabelledFrame]:
        from dataclasses import replace

        from torchweather.core.errors import TorchweatherError
        from torchweather.evaluation.robustness import LabelledFrame, read_label_truth

        for file, stem in zip(self.files, self.stems, strict=True):
            subjects = self.maker.files(file)
            if len(subjects) != 1:
                raise TorchweatherError(f"{file}: expected one frame a file; got {len(subjects)}.")
            subject: Any = subjects[0]
            options = {key: value for key, value in self.options.items() if key not in ("depth", "lost")}
            subject = replace(subject, options={**options, **subject.options})
            if self.truths is not None:
                self.truths[stem].check_size(subject.label_shape, file)
                yield LabelledFrame(stem, subject, self.truths[stem])
                continue
            truth = read_label_truth(self.labels, stem, self.declaration.sensor, subject.label_shape)
            yield LabelledFrame(stem, subject, truth)
