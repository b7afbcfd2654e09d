"""Mistakes that a user's type checker must find; ``mypy`` complains of an ignore that is not needed."""

from __future__ import annotations

import torch

import torchweather as tw


def mistakes() -> None:
    """Misspelt and mistyped options of presets; results that are tensors and dictionaries. It is never called."""
    tw.Camera.preset("lucid-triton", exposure=0.01)  # type: ignore[call-arg]
    tw.Lidar.preset("velodyne-hdl-64e", range_m=3.0)  # type: ignore[call-arg]
    tw.Radar.preset("imaging-77ghz", samples="512")  # type: ignore[arg-type]
    number: int = tw.BayerFog(tw.Fog(50.0), tw.Camera.preset("lucid-triton"))(torch.zeros(1, 4, 4))  # type: ignore[assignment]
    number = tw.AsBayer(tw.BayerFog(tw.Fog(50.0), tw.Camera.preset("lucid-triton")))("frame.png")  # type: ignore[arg-type,assignment]
    number = tw.Compose({})({})  # type: ignore[assignment]
    print(number)
