"""The file that `torchweather list` reads: names of recipes, sensors, weathers, distributions and stages.

python -m tests.listed_names     # after a change of any of them
"""

from __future__ import annotations

import json
from pathlib import Path

from torchweather.cli.listing import NAMES_FILE, everything
from torchweather.cli.output import plain

FILE = Path(__file__).parents[1] / "torchweather" / "presets" / NAMES_FILE


def text_of_names() -> str:
    """The file's text."""
    return json.dumps(plain(everything()), indent=1, ensure_ascii=False) + "\n"


if __name__ == "__main__":
    FILE.write_text(text_of_names(), encoding="utf-8")
