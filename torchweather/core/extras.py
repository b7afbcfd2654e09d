"""Hints on the installation of an optional extra, from an index or in a clone."""

from __future__ import annotations

__all__ = ["install_hint"]


def install_hint(extra: str, options: str = "") -> str:
    """A sentence on how to install an extra of ``pyproject.toml``.

    Example:
        >>> install_hint("video")
        "Install it with: pip install 'torchweather[video]' (in a clone of torchweather: pip install -e '.[video]')."
    """
    pip = f"pip install {options}".rstrip()
    return f"Install it with: {pip} 'torchweather[{extra}]' (in a clone of torchweather: {pip} -e '.[{extra}]')."
