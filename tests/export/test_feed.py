"""``draw_feed`` opens a graph's file once for each of its states."""

from __future__ import annotations

import os
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from torchweather.core.random import Variate
from torchweather.export import feed


def test_a_file_is_opened_anew_where_it_has_changed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    opened: list[str] = []
    variates = {"jitter.normal": Variate("normal", "normal", ("N",))}

    def graph(path: Any) -> Any:
        opened.append(Path(path).name)
        said = {feed.METADATA_KEY: feed.variates_to_metadata(variates)}
        return SimpleNamespace(get_modelmeta=lambda: SimpleNamespace(custom_metadata_map=said))

    monkeypatch.setattr(feed, "_opened", graph)
    path = tmp_path / "graph.onnx"
    path.write_bytes(b"first")
    first, again = (feed.draw_feed(path, points=5, seed=3) for _ in range(2))
    assert np.array_equal(first["jitter.normal"], again["jitter.normal"])
    assert opened == ["graph.onnx"]
    path.write_bytes(b"second")
    os.utime(path, ns=(1, 1))
    feed.draw_feed(path, points=5, seed=3)
    assert len(opened) == 2
