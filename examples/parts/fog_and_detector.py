"""Fog and a detector as one ONNX graph, compared with weather in torch and the detector after it."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import onnxruntime
import torch
from parts.nanodet import SIZE
from torch import Tensor, nn

import torchweather as tw
from torchweather.evaluation.robustness import LabelledFrame, OnnxDetector
from torchweather.evaluation.robustness.decoders import decode_boxes
from torchweather.evaluation.robustness.placement import placed
from torchweather.evaluation.sweep import CameraSubject
from torchweather.export import ImageToDetector, fuse
from torchweather.image import normalise
from torchweather.transforms import AsBayer, BayerFog

SHOWN = 0.45  # score of maximum F1 on the clear frames
AIRLIGHT = 0.6  # linear grey of a bright overcast sky, of saturation; in the graph a number, not the frame's own


class OnCanvas(nn.Module):
    """The picture at the top left of the detector's input, not enlarged."""

    def __init__(self, picture: ImageToDetector, height: int, width: int) -> None:
        super().__init__()
        self.picture, self.border = picture, (0, SIZE[1] - width, 0, SIZE[0] - height)

    def forward(self, rgb: Tensor) -> Tensor:
        return self.picture(nn.functional.pad(rgb, self.border))


def one_graph(frame: LabelledFrame, detector: OnnxDetector, model: Path, out: Path) -> None:
    """Fog and detector as one ONNX graph: picture and visibility in, boxes out; onnxruntime alone runs it.

    Its answer is compared with weather in torch and the detector after it.
    """
    subject = frame.subject
    assert isinstance(subject, CameraSubject)
    rgb, depth_m, camera = normalise(subject.data), subject.depth_m, subject.camera
    height, width = rgb.shape[-2:]
    declared, roles = detector.declaration.input, detector.declaration.outputs
    picture = ImageToDetector(**{key: declared[key] for key in ("colour", "scale", "mean", "std")})
    between, path = OnCanvas(picture, height, width), out / "fog_and_nanodet.onnx"
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
