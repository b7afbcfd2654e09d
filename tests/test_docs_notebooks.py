"""Tutorials: each is a notebook that runs, prints what it says, and draws the pictures that its page shows."""

from __future__ import annotations

import contextlib
import importlib.util
import io
import re
import sys
import types
from pathlib import Path
from typing import Any

import matplotlib.pyplot as plt
import pytest

from torchweather.scenes import Scene

ROOT = Path(__file__).parents[1]
TUTORIALS = sorted((ROOT / "docs" / "tutorials").glob("*.md"))
COARSE = {"robustness"}  # nine frames of a scene, of which the page prints nothing: one ray a pixel, not four at edges


@pytest.fixture(scope="module")
def converter() -> Any:
    spec = importlib.util.spec_from_file_location("notebook_of_a_page", ROOT / "docs" / "_site" / "notebook.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.mark.usefixtures("few_dots")
@pytest.mark.parametrize("page", TUTORIALS, ids=lambda page: page.stem)
def test_a_notebook_runs_and_prints_what_it_says(
    page: Path, converter: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "docs").symlink_to(ROOT / "docs")  # as in a clone
    if page.stem in COARSE:
        monkeypatch.setitem(Scene.view.__kwdefaults__, "supersample", 1)
    module = types.ModuleType("a_notebook")
    monkeypatch.setitem(sys.modules, module.__name__, module)
    for cell in converter.notebook(page)["cells"]:
        if cell["cell_type"] != "code":
            continue
        printed = io.StringIO()
        with contextlib.redirect_stdout(printed):
            exec(compile("".join(cell["source"]), f"{page.stem}.ipynb", "exec"), module.__dict__)
        for output in cell["outputs"]:
            assert printed.getvalue().split() == "".join(output["text"]).split(), cell["id"]
    plt.close("all")
    shown = re.findall(r"images/tutorials/([\w-]+)\.webp", page.read_text(encoding="utf-8"))
    assert all((tmp_path / f"{name}.png").exists() for name in shown)


def test_a_notebook_has_the_cells_of_its_page(converter: Any, tmp_path: Path) -> None:
    page = converter.TUTORIALS / "made.md"  # is never written: links are read from its place
    text = """# Title

Text with a [link](../how-to/train-loader.md#workers-and-epochs) and [another](https://example.org).

```python
print(1)
```

```text
1
```

![a picture](../images/made.webp)

```sh
torchweather list
```

The end.
"""
    made = types.SimpleNamespace(read_text=lambda encoding: text, parent=page.parent)
    cells = converter.notebook(made)["cells"]
    assert [cell["cell_type"] for cell in cells] == ["markdown", "code", "markdown", "markdown"]
    assert "link (`docs/how-to/train-loader.md#workers-and-epochs`)" in "".join(cells[0]["source"])
    assert "[another](https://example.org)" in "".join(cells[0]["source"])
    assert cells[1]["source"] == ["print(1)"]
    assert cells[1]["outputs"] == [{"output_type": "stream", "name": "stdout", "text": ["1"]}]
    assert not any("picture" in "".join(cell["source"]) for cell in cells)
    assert len({cell["id"] for cell in cells}) == len(cells)
