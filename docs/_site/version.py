"""Version of the package at the foot of every page."""

from __future__ import annotations

import re
from pathlib import Path

from mkdocs.config.defaults import MkDocsConfig
from mkdocs.exceptions import PluginError

VERSION = re.compile(r'^__version__ = "([^"]+)"', re.MULTILINE)


def on_config(config: MkDocsConfig) -> MkDocsConfig:
    """Put the version before the licence."""
    source = Path(config.docs_dir).parent / "torchweather" / "__init__.py"
    found = VERSION.search(source.read_text(encoding="utf-8"))
    if found is None:
        raise PluginError(f"{source} states no __version__")
    config.copyright = f"torchweather {found[1]}. Licence: {config.copyright}"
    return config
