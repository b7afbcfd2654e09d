"""Data, a detector and a suite for ``torchweather robustness`` whose answers are known."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import torch
import yaml

from tests.evaluation.robustness.onnx_detectors import declared, fixed_boxes
from torchweather.io import write_image
from torchweather.recipes.schema import FORMAT

SIZE = (48, 64)
BOX = [8.0, 8.0, 40.0, 32.0]


def camera_data(folder: Path, count: int = 2) -> Path:
    """Raw frames, a dark box on a bright wall 30 m away, which is what the detector always says."""
    (folder / "images").mkdir(parents=True)
    (folder / "depth").mkdir()
    for number in range(count):
        raw = torch.full((1, *SIZE), 40000, dtype=torch.int32)
        raw[:, 8:32, 8:40] = 2000 + 1000 * (number % 2)
        write_image(folder / "images" / f"{number}.png", raw.to(torch.uint16))
        np.save(folder / "depth" / f"{number}.npy", np.full(SIZE, 30.0, np.float32))
    left, top, right, bottom = BOX
    annotations = [
        {"id": n, "image_id": n, "category_id": 1, "bbox": [left, top, right - left, bottom - top]}
        for n in range(count)
    ]
    images = [{"id": n, "file_name": f"{n}.png"} for n in range(count)]
    truth = {"images": images, "annotations": annotations, "categories": [{"id": 1, "name": "car"}]}
    (folder / "annotations.json").write_text(json.dumps(truth))
    return folder


def camera_model(folder: Path, **options: Any) -> Path:
    """It finds the box while the contrast of the frame is a fifth or more of its mean, clear 0.6."""
    model = fixed_boxes(folder / "model.onnx", [BOX])
    declared(
        model,
        sensor="camera",
        input={"name": "image"},
        decoder="boxes",
        outputs={"boxes": "boxes", "scores": "scores", "labels": "labels"},
        classes=["car"],
        options={"threshold": 0.2, **options},
    )
    return model


def own_suite(folder: Path, kind: str = "camera") -> Path:
    weathers = {"fog": {"mor_m": [1000.0, 400.0, 100.0, 30.0, 15.0]}}
    values = {"format": FORMAT, "kind": "suite", "title": "fog", "sensor": {"kind": kind}, "weathers": weathers}
    path = folder / f"{kind}-suite.yaml"
    path.write_text(yaml.safe_dump(values))
    return path


LIGHT = ["--airlight", "0.6", "0.6", "0.6", "--sensor", "camera:gopro-hero5-acdc", "--bit-depth", "16", "--quiet"]


def arguments(folder: Path, out: str = "out", **more: str) -> list[str]:
    values = {
        "--model": str(folder / "model.onnx"),
        "--data": str(folder / "data"),
        "--recipe": str(folder / "camera-suite.yaml"),
        "--metrics": "psnr,gmsd",
        "--out": str(folder / out),
    }
    return ["robustness", *(text for pair in {**values, **more}.items() for text in pair), *LIGHT]


def with_declaration(**values: Any) -> Callable[[Path, list[str]], list[str]]:
    def change(folder: Path, command: list[str]) -> list[str]:
        file = folder / "model.yaml"
        file.write_text(yaml.safe_dump({**yaml.safe_load(file.read_text()), **values}))
        return command

    return change
