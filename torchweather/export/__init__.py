"""ONNX: transforms as graphs (``to_onnx``), detectors behind them (``fuse``), noise without torch (``draw_feed``)."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from torchweather.export.feed import draw_feed

if TYPE_CHECKING:
    from torchweather.export.fusing import fuse
    from torchweather.export.graph import to_onnx
    from torchweather.export.picture import ImageToDetector, MosaicToImage

__all__ = ["ImageToDetector", "MosaicToImage", "draw_feed", "fuse", "to_onnx"]

# Late, because they load torch, which a machine that only runs graphs can do without.
LATE = {
    "ImageToDetector": "torchweather.export.picture",
    "MosaicToImage": "torchweather.export.picture",
    "fuse": "torchweather.export.fusing",
    "to_onnx": "torchweather.export.graph",
}


def __getattr__(name: str) -> Any:
    if name in LATE:
        import importlib

        return getattr(importlib.import_module(LATE[name]), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
