"""Draw the pictures that tutorials show, by running the tutorials: ``python docs/_figures/tutorials.py [NAME ...]``.

Each page's code saves its figure as ``NAME.png``. Here it becomes ``docs/images/tutorials/NAME.webp``.
"""

from __future__ import annotations

import contextlib
import re
import sys
import tempfile
from pathlib import Path

import matplotlib as mpl
from PIL import Image

ROOT = Path(__file__).parents[2]
PICTURES = ROOT / "docs" / "images" / "tutorials"
BLOCK = re.compile(r"^```python\n(.*?)^```", re.MULTILINE | re.DOTALL)


def draw(page: Path) -> None:
    """Run a page in a folder of its own and keep the pictures that it shows."""
    text = page.read_text(encoding="utf-8")
    shown = re.findall(r"images/tutorials/([\w-]+)\.webp", text)
    if not shown:
        return
    with tempfile.TemporaryDirectory() as folder, contextlib.chdir(folder):
        Path("docs").symlink_to(ROOT / "docs")
        exec(compile("\n".join(BLOCK.findall(text)), str(page), "exec"), {"__name__": "tutorial"})
        for name in shown:
            picture = Image.open(f"{name}.png").convert("RGB")
            picture.save(PICTURES / f"{name}.webp", quality=85, method=6)
            print(PICTURES / f"{name}.webp")


if __name__ == "__main__":
    mpl.use("Agg")
    PICTURES.mkdir(parents=True, exist_ok=True)
    for page in sorted((ROOT / "docs" / "tutorials").glob("*.md")):
        if page.stem in sys.argv[1:] or len(sys.argv) == 1:
            draw(page)
