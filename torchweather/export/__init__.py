"""ONNX: transforms and the radar's map as graphs (``to_onnx``), their noise drawn without torch (``draw_feed``)."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from torchweather.export.feed import draw_feed

if TYPE_CHECKING:
    from torchweather.export.graph import to_onnx

__all__ = ["draw_feed", "to_onnx"]


def __getattr__(name: str) -> Any:
    # Late, because it loads torch, which a machine that only runs graphs can do without.
    if name == "to_onnx":
        from torchweather.export.graph import to_onnx

        return to_onnx
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
