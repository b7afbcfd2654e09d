"""Packages that add names, installed for a test without pip: code and a folder of metadata on the path."""

from __future__ import annotations

import shutil
import tomllib
from collections.abc import Mapping
from pathlib import Path

EXAMPLE = Path(__file__).parents[1] / "examples" / "weather_package"


def install(folder: Path, name: str, entries: Mapping[str, Mapping[str, str]]) -> None:
    """Write the metadata of a distribution: what pip leaves of entry points.

    Args:
        folder: on the path.
        name: of the distribution.
        entries: names and objects by the group behind ``torchweather.``.
    """
    metadata = folder / f"{name.replace('-', '_')}-1.0.dist-info"
    metadata.mkdir(parents=True)
    (metadata / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {name}\nVersion: 1.0\n")
    sections = [
        f"[torchweather.{group}]\n" + "".join(f"{key} = {value}\n" for key, value in rows.items())
        for group, rows in entries.items()
    ]
    (metadata / "entry_points.txt").write_text("\n".join(sections))


def install_example(folder: Path) -> None:
    """Install the package of ``examples/weather_package`` with the names of its ``pyproject.toml``."""
    project = tomllib.loads((EXAMPLE / "pyproject.toml").read_text())["project"]
    shutil.copytree(EXAMPLE / "acme_weather", folder / "acme_weather")
    groups = {group.removeprefix("torchweather."): rows for group, rows in project["entry-points"].items()}
    install(folder, project["name"], groups)
