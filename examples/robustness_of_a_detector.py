"""See how robust a detector is to rain, fog and snow, with no data of your own.

    python examples/robustness_of_a_detector.py

Draws labelled raw frames of cars on the embedded test track, trains a small detector on others for a few seconds,
writes it as ONNX with its declaration, and runs `torchweather robustness` on it: average precision in every weather and
severity, mean corruption error, resilience rate, and a page. About a minute on one core; --quick is smaller.
"""

from __future__ import annotations

import argparse
import json
import logging
import warnings
from pathlib import Path

import numpy as np
import torch
import yaml
from metrics_against_detector import clear_batches
from parts.car_detector import STRIDE, Detector, Frame, centres, frame, trained
from torch import Tensor, nn

from torchweather.cli import main as torchweather
from torchweather.image import quantise
from torchweather.io import write_image

EXPOSURE = 1.3  # of the pictures that the detector learns from
FIRST_TEST = 10_000  # seeds from here on are no training frames


class BoxesOut(nn.Module):
    """The detector with its boxes decoded, so that the graph gives boxes and scores; overlapping ones stay."""

    def __init__(self, detector: Detector) -> None:
        super().__init__()
        self.detector = detector

    def forward(self, image: Tensor) -> tuple[Tensor, Tensor]:
        found = self.detector(image)[0]
        score, place = found[0].sigmoid().flatten().topk(100)
        x, y = centres(found.shape[1:]).flatten(1)[:, place]
        left, top, right, bottom = STRIDE * found[1:].flatten(1)[:, place].clamp(-4, 4).exp()
        return torch.stack([x - left, y - top, x + right, y + bottom], 1), score[:, None]  # of one class


def write_detector(detector: Detector, path: Path, size: torch.Size) -> None:
    """The detector as ONNX, and beside it what it takes and gives."""
    logging.getLogger("torch.onnx").setLevel(logging.ERROR)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # the exporter's own
        torch.onnx.export(
            BoxesOut(detector).eval(),
            (torch.rand(1, 3, *size),),
            path,
            input_names=["image"],
            output_names=["boxes", "scores"],
            external_data=False,
            dynamo=True,
            verbose=False,
        )
    declaration = {
        "format": "torchweather-detector/1",
        "title": "Small car detector",
        "sensor": "camera",
        "input": {"name": "image", "layout": "NCHW", "colour": "RGB", "exposure": EXPOSURE, "size": [*size]},
        "decoder": "boxes",
        "outputs": {"boxes": "boxes", "scores": "scores"},
        "classes": ["car"],
        "options": {"threshold": 0.02, "nms_iou": 0.4},
    }
    path.with_suffix(".yaml").write_text(yaml.safe_dump(declaration, sort_keys=False), encoding="utf-8")


def write_data(frames: list[Frame], folder: Path) -> None:
    """Raw frames, depth, and the boxes as COCO's JSON."""
    (folder / "images").mkdir(parents=True, exist_ok=True)
    (folder / "depth").mkdir(exist_ok=True)
    images, annotations = [], []
    for number, each in enumerate(frames):
        raw = quantise(each.bayer, torch.int32, each.camera.black_level, each.camera.saturation_level)
        write_image(folder / "images" / f"{number:03d}.png", raw.to(torch.uint16))
        np.save(folder / "depth" / f"{number:03d}.npy", each.depth_m[0].numpy())
        images.append({"id": number, "file_name": f"{number:03d}.png"})
        for (left, top, right, bottom), small in zip(each.boxes.tolist(), each.small.tolist(), strict=True):
            annotations.append(
                {
                    "id": len(annotations),
                    "image_id": number,
                    "category_id": 1,
                    "bbox": [left, top, right - left, bottom - top],
                    "iscrowd": int(small),  # too small to be learned: neither missed nor false
                }
            )
    truth = {"images": images, "annotations": annotations, "categories": [{"id": 1, "name": "car"}]}
    (folder / "annotations.json").write_text(json.dumps(truth), encoding="utf-8")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, default=Path("robustness_of_a_detector"), help="folder for everything")
    parser.add_argument("--train", type=int, default=16, help="clear frames to learn from")
    parser.add_argument("--test", type=int, default=8, help="other frames, to find cars in")
    parser.add_argument("--steps", type=int, default=300, help="of training")
    parser.add_argument("--metrics", default="psnr,ssim,gmsd,vif", help="scores of the frames; none for none")
    parser.add_argument("--quick", action="store_true", help="few frames, little training, one weather")
    arguments = parser.parse_args()
    if arguments.quick:
        arguments.train, arguments.test, arguments.steps = 2, 2, 20

    learned = [frame(seed) for seed in range(arguments.train)]
    detector = trained(clear_batches(learned, arguments.steps), arguments.steps)
    tested = [frame(FIRST_TEST + seed) for seed in range(arguments.test)]
    write_data(tested, arguments.out / "data")
    write_detector(detector, arguments.out / "detector.onnx", tested[0].bayer.shape[-2:])
    command = ["robustness", "--model", str(arguments.out / "detector.onnx"), "--data", str(arguments.out / "data")]
    command += [
        "--sensor",
        "camera:lucid-triton",
        "--metrics",
        arguments.metrics,
        "--out",
        str(arguments.out / "found"),
    ]
    if arguments.quick:
        command += ["--recipe", "camera/fog-30m"]
    raise SystemExit(torchweather([*command, "--quiet"]))


if __name__ == "__main__":
    main()
