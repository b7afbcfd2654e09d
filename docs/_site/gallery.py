"""The gallery's pages, written when the site is built from ``docs/images/gallery/gallery.json``."""

from __future__ import annotations

from itertools import groupby
from pathlib import Path
from typing import Any

from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.files import File, Files
from pictures import read_table, slider

TITLES = {"camera": "Camera", "lidar": "LiDAR", "radar": "Radar"}
ABOUT = {
    "camera": "Weathers and effects are on one photograph of guessed depth. At night it is relit: it was taken by day.",
    "lidar": "The embedded test track from behind the sensor: objects grey, particles orange, lost objects blue.",
    "radar": "Detections of the embedded test track: power against range. A radar that turns maps a made-up street.",
}
OF_PRESETS = "Presets named after a data set see embedded scenes as its sensor does; no picture is a recording."
MORE = {
    "camera": "[What each effect does to statistics](../effects-camera.md); [night](../how-to/night-scenes.md).",
    "lidar": "[What each effect does to statistics](../effects-lidar.md).",
    "radar": "[What each effect does to statistics](../effects-radar.md).",
}


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Add a page for each sensor."""
    table = read_table(Path(config.docs_dir))
    for sensor in TITLES:
        files.append(File.generated(config, f"gallery/{sensor}.md", content=page(sensor, table)))
    return files


def page(sensor: str, table: dict[str, Any]) -> str:
    """Pictures of a sensor by group, each with its lines."""
    shown = [entry for entry in table["entries"] if entry["sensor"] == sensor and entry["group"]]
    lines = [
        f"# Gallery: {TITLES[sensor]}",
        "",
        f"{ABOUT[sensor]} Drag a slider: clear air, or the weather without the effect, is on its left.",
        f"Each picture has the lines that made it. These come first, in a clone. {OF_PRESETS}",
        "",
        *code(table["setup"][sensor]),
        "",
        MORE[sensor],
    ]
    for group, entries in groupby(shown, key=lambda entry: entry["group"]):
        lines += ["", f"## {group}", "", '<div class="gallery" markdown>']
        for entry in entries:
            lines += ["", '<div class="gallery-entry" markdown>', "", slider(entry, "../../"), ""]
            lines += ['??? example "' + entry["title"].replace('"', "'") + '"', ""]
            lines += [f"    {line}".rstrip() for line in code(entry["code"])]
            lines += ["", "</div>"]
        lines += ["", "</div>"]
    return "\n".join([*lines, ""])


def code(text: str) -> list[str]:
    """Block of Python."""
    return ["```python", *text.rstrip().splitlines(), "```"]
