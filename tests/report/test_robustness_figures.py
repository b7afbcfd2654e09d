"""Pictures of a robustness page: boxes from the operating threshold on, and regions to be ignored."""

from __future__ import annotations

import base64
import io
from typing import Any

import numpy as np
import pytest
import torch
from PIL import Image

from torchweather.evaluation.robustness import BoxTruth, LabelledFrame
from torchweather.evaluation.robustness.frames import Look
from torchweather.evaluation.sweep import CameraSubject
from torchweather.report.robustness_figures import FOUND, IGNORED, TRUE, look_uri
from torchweather.sensors import Camera

SIZE = (160, 320)


def look(scores: list[float]) -> Look:
    """A black frame with one truth, one region, and a box a score, each 20 px to the right of the last."""
    camera = Camera.preset("lucid-triton").resized(SIZE[1], SIZE[0])
    subject = CameraSubject("a", torch.zeros(3, *SIZE), torch.full((1, *SIZE), 9.0), camera)
    truth = BoxTruth(np.array([[10.0, 100, 40, 140], [60.0, 100, 90, 140]]), ("car", "car"), np.array([False, True]))
    boxes = np.array([[10.0 + 40 * k, 10, 40 + 40 * k, 40] for k in range(len(scores))])
    found: dict[str, Any] = {"boxes": boxes, "scores": np.array(scores), "labels": ["car"] * len(scores)}
    return Look(LabelledFrame("a", subject, truth), None, torch.zeros(3, *SIZE), found, None)


def columns_of(uri: str, colour: str) -> np.ndarray[Any, Any]:
    """Columns of the frame in which a box's side has a colour, of those that can be there; JPEG moves it a little."""
    pixels = np.asarray(Image.open(io.BytesIO(base64.b64decode(uri.partition(",")[2]))).convert("RGB")).astype(int)
    colours = (colour, FOUND, TRUE, IGNORED, "#000000")
    there = np.array([[int(one[k : k + 2], 16) for k in (1, 3, 5)] for one in colours])
    nearest = np.abs(pixels[:, :, None] - there).sum(-1).argmin(-1)
    return np.flatnonzero((nearest == 0).sum(0) > 20) * SIZE[1] // pixels.shape[1]


@pytest.mark.parametrize(("least", "last"), [(0.0, 120), (0.4, 80), (0.7, 40)])
def test_boxes_are_drawn_from_the_threshold_on(least: float, last: int) -> None:
    columns = columns_of(look_uri(look([0.9, 0.5, 0.3]), least), FOUND)
    assert columns.min() == pytest.approx(10, abs=2)
    assert columns.max() == pytest.approx(last, abs=2)


def test_truth_and_regions_have_colours_of_their_own() -> None:
    uri = look_uri(look([]), 0.0)
    assert columns_of(uri, TRUE).min() == pytest.approx(10, abs=2)
    # At the right side of the truth its blue and the black beside it mix to grey.
    beyond = columns_of(uri, IGNORED)
    assert beyond[beyond > 45].min() == pytest.approx(60, abs=2)
