"""A page for each effect, cut from the pages of all effects of a sensor when the site is built."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.files import File, Files
from pictures import read_table, slider

SENSORS = {"camera": "cameras", "lidar": "LiDAR", "radar": "radar"}
SECTION = re.compile(
    r"^## (?P<title>.+)\n\n`(?P<name>\w+\.\w+)` · (?P<term>.+)\n(?P<text>(?:(?!^## ).*\n?)*)", re.MULTILINE
)
LINK = re.compile(r"\]\((?![a-z]+:)([^)#\s]*)(#[^)\s]*)?\)")
TAKEN_FOR = re.compile(r"(?<=\*\*Taken for\*\* )`(\w+\.\w+)`")


class Effect(NamedTuple):
    """An effect as its sensor's page describes it."""

    name: str
    title: str
    term: str
    text: str

    @property
    def sensor(self) -> str:
        """``camera``, ``lidar`` or ``radar``."""
        return self.name.partition(".")[0]

    @property
    def class_name(self) -> str:
        """``CameraDefocus`` of ``camera.defocus``."""
        return "".join(word.capitalize() for word in re.split(r"[._]", self.name))


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Add the pages."""
    docs = Path(config.docs_dir)
    listed = [effect for sensor in SENSORS for effect in effects_in(docs / f"effects-{sensor}.md")]
    pictures = {entry["name"]: entry for entry in read_table(docs)["entries"]}
    files.append(File.generated(config, "reference/effects.md", content=overview(listed)))
    for effect in listed:
        content = page(effect, pictures[effect.name])
        files.append(File.generated(config, f"reference/effects/{effect.name}.md", content=content))
    return files


def effects_in(path: Path) -> Iterator[Effect]:
    """Effects that a page describes, in its order."""
    for match in SECTION.finditer(path.read_text(encoding="utf-8")):
        yield Effect(match["name"], match["title"], match["term"], match["text"].strip())


def overview(listed: list[Effect]) -> str:
    """Table of all effects."""
    lines = ["# Effects", "", "What a recording may hold beyond rain, fog and snow. Each is a stage with a name."]
    for sensor, title in SENSORS.items():
        lines += [
            "",
            f"## {title[0].upper()}{title[1:]}",
            "",
            "| effect | what is changed | term |",
            "| --- | --- | --- |",
        ]
        for effect in listed:
            if effect.sensor == sensor:
                lines.append(f"| [`{effect.name}`](effects/{effect.name}.md) | {effect.title} | {effect.term} |")
    return "\n".join([*lines, ""])


def page(effect: Effect, picture: dict[str, Any]) -> str:
    """Description, parameters and confusable effects, with the picture of the gallery and the lines that made it."""
    whole = f"../../effects-{effect.sensor}.md"
    of_class = f"[`{effect.class_name}`](../torchweather.{effect.sensor}.effects.all/{effect.class_name}.md)"
    title = picture["title"]
    gallery = f"[gallery](../../gallery/{effect.sensor}.md)"
    text = LINK.sub(lambda match: f"]({'../../' + match[1] if match[1] else whole}{match[2] or ''})", effect.text)
    return "\n".join(
        [
            f"# {effect.title}",
            "",
            f"`{effect.name}` · {effect.term} · class {of_class} · [all effects of {SENSORS[effect.sensor]}]({whole})",
            "",
            TAKEN_FOR.sub(r"[`\1`](\1.md)", text),
            "",
            "## Without it and with it",
            "",
            slider(picture, "../../../"),
            "",
            f"{title[0].upper()}{title[1:]}. These lines follow those at the top of the {gallery}:",
            "",
            "```python",
            picture["code"].rstrip(),
            "```",
            "",
        ]
    )
