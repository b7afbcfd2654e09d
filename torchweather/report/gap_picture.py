"""Picture of a frame or a scan with the places at which the measurement departs from the simulation."""

from __future__ import annotations

from typing import Literal

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize
from matplotlib.figure import Figure
from numpy.typing import NDArray

from torchweather.gap.places import DEPARTS, Places
from torchweather.report.figures import INK, STYLE, plain_axes, png_figure_uri

__all__ = ["BY_CHANCE", "departing", "places_uri"]

Floats = NDArray[np.float64]

BY_CHANCE = 0.0027  # share of places beyond it where nothing departs
COLOURS = "RdBu_r"  # red: more than simulated
WIDE = 2.2  # width over height, from which panels are stacked
DPI = 150


def departing(places: Places, values: Floats) -> tuple[int, int]:
    """Number of places that depart by more than chance, and of those that can be compared."""
    z = np.abs(_z(places, values))
    return int((z > DEPARTS).sum()), int(np.isfinite(z).sum())


def places_uri(places: Places) -> str:
    """The frame in grey and its departing places in colour, before and with what was fitted."""
    panels = [("the simulation as it is", places.before)]
    if places.after is not None:
        panels.append(("with the best fit", places.after))
    known = np.abs(places.before[np.isfinite(places.before)])
    largest = float(np.quantile(known, 0.98)) if len(known) else 1.0
    norm = Normalize(-max(largest, 1e-9), max(largest, 1e-9))
    left, right, bottom, top = places.values.extent
    ratio = abs((right - left) / (top - bottom)) if places.values.frame is not None else 1.0
    stacked = ratio > WIDE
    wide = places.values.frame is not None and places.values.x_name.startswith("azimuth")
    stacked |= wide
    rows, columns = (len(panels), 1) if stacked else (1, len(panels))
    row_in = 2.2 if wide else min(0.6 + 8.0 / ratio, 3.0)  # a frame keeps its shape, and fills the width if it can
    size = (9.6, 0.35 + row_in * rows) if stacked else (9.6, 4.1)
    with mpl.rc_context({**STYLE, "font.size": 9.0, "figure.facecolor": "white"}):
        figure = Figure(figsize=size, layout="constrained" if wide or places.values.shape is None else "compressed")
        axes = np.asarray(figure.subplots(rows, columns, squeeze=False)).ravel()
        for one, (title, values) in zip(axes, panels, strict=True):
            number, of = departing(places, values)
            one.set_title(f"{title}: {number} of {of} places depart", fontsize=9.5, color=INK)
            if places.values.shape is None:
                _scattered(one, places, values, norm)
            else:
                _grid(one, places, values, norm, free=wide)
            one.set_xlabel(places.values.x_name)
        for one in axes[::columns]:
            one.set_ylabel(places.values.y_name)
        bar = figure.colorbar(ScalarMappable(norm, COLOURS), ax=list(axes), fraction=0.04, pad=0.01)
        bar.set_label(f"measured − simulated, {places.values.unit}")
        return png_figure_uri(figure, DPI)


def _z(places: Places, values: Floats) -> Floats:
    known = np.isfinite(places.chance) & (places.chance > 0)
    return np.where(known, values / np.where(known, places.chance, 1.0), np.nan)


def _grid(axes: Axes, places: Places, values: Floats, norm: Normalize, *, free: bool) -> None:
    """Cells over a frame in grey."""
    shape = places.values.shape
    assert shape is not None
    extent = places.values.extent
    aspect: Literal["auto", "equal"] = "auto" if free else "equal"
    if places.values.frame is not None:
        axes.imshow(places.values.frame, cmap="gray", vmin=0.0, vmax=1.0, extent=extent, aspect=aspect)
    departs = np.abs(_z(places, values)) > DEPARTS
    shown = np.where(departs, values, np.nan).reshape(shape)
    picture = axes.imshow(shown, cmap=COLOURS, norm=norm, extent=extent, aspect=aspect, interpolation="nearest")
    picture.set_alpha(0.8)
    axes.grid(visible=False)


def _scattered(axes: Axes, places: Places, values: Floats, norm: Normalize) -> None:
    """Things that stand anywhere: grey where they do not depart."""
    plain_axes(axes)
    assert places.values.x is not None
    assert places.values.y is not None
    departs = np.abs(_z(places, values)) > DEPARTS
    x, y = places.values.x, places.values.y
    axes.scatter(x[~departs], y[~departs], s=16, facecolors="none", edgecolors="#9aa7b4", linewidths=0.9)
    axes.scatter(
        x[departs], y[departs], s=26, c=values[departs], cmap=COLOURS, norm=norm, edgecolors=INK, linewidths=0.5
    )
