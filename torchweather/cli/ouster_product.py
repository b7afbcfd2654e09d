"""The product that an Ouster recording names, compared with the sensor that is to be simulated."""

from __future__ import annotations

import argparse
import re
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from torchweather.lidar.sensor import Lidar

__all__ = ["preset_of_product", "refuse_other_product"]

# Ouster's lasers differ by some nm between revisions; other makers use 905 and 1550.
_SAME_LINE_NM = 15.0
# The outer beams of units of one product lie within this share of its view.
_SAME_VIEW = 0.1
_PRODUCT = re.compile(r"OS-?([012])\b", re.IGNORECASE)


def preset_of_product(product: str | None) -> str | None:
    """The preset of a product, such as ``OS-2-128``; the one of 128 beams for its siblings with fewer.

    Example:
        >>> preset_of_product("OS-2-128"), preset_of_product("OS-1-64"), preset_of_product("VLP-16")
        ('ouster-os2-128', 'ouster-os1-128', None)
    """
    found = _PRODUCT.match(product or "")
    return f"ouster-os{found.group(1)}-128" if found else None


def refuse_other_product(name: str, product: str | None, sensor: Lidar, args: argparse.Namespace, owner: str) -> None:
    """Raise where the sensor is another than the one that recorded a file, by its wavelength and view, unless forced.

    Args:
        name: of the file.
        product: that its metadata name; ``None`` or an unknown one is not judged.
        sensor: to be simulated.
        args: of the command, with ``force``.
        owner: the command.
    """
    from torchweather.core.errors import TorchweatherError
    from torchweather.lidar.sensor import Lidar

    preset = preset_of_product(product)
    if preset is None or getattr(args, "force", False):
        return
    own = Lidar.preset(preset)
    differs = ""
    if abs(own.wavelength_nm - sensor.wavelength_nm) > _SAME_LINE_NM:
        differs = f"a wavelength of {sensor.wavelength_nm:g} nm instead of {own.wavelength_nm:g}"
    elif sensor.elevations_deg is not None and own.elevations_deg is not None:
        view, wanted = (max(beams) - min(beams) for beams in (sensor.elevations_deg, own.elevations_deg))
        if abs(view - wanted) > _SAME_VIEW * wanted:
            differs = f"a vertical view of {view:.1f} degrees instead of {wanted:.1f}"
    if differs:
        force = "; --force goes on as it is" if hasattr(args, "force") else ""
        raise TorchweatherError(
            f"{owner}: {name}: recorded by an {product}, but the sensor has {differs}. Give --sensor lidar:{preset}"
            f"{force}."
        )
