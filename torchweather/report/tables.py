"""Numbers as the pages write them, and the table of physical numbers of a weather."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any

from torchweather.report import parts

__all__ = ["NO_VALUE", "fixed_text", "number_text", "numbers_table", "signed_text", "weathers_table"]

NO_VALUE = "–"

# Key in the summary, name, unit, group. A share is shown in per cent.
ROWS = (
    ("extinction_red_per_m", "Extinction, red", "1/m", "Air"),
    ("extinction_green_per_m", "Extinction, green", "1/m", "Air"),
    ("extinction_clear_per_m", "Extinction, clear", "1/m", "Air"),
    ("extinction_blue_per_m", "Extinction, blue", "1/m", "Air"),
    ("mor_m", "Visibility (MOR, from Mie at 550 nm)", "m", "Air"),
    ("particles_per_m3", "Particles", "1/m³", "Air"),
    ("liquid_water_g_per_m3", "Liquid water content", "g/m³", "Air"),
    ("optical_depth_28_m", "Optical depth to 28 m, as the camera sees it", "", "Light"),
    ("optical_depth_56_m", "Optical depth to 56 m, as the camera sees it", "", "Light"),
    ("transmission_28_m", "Transmission from 28 m", "%", "Light"),
    ("transmission_56_m", "Transmission from 56 m", "%", "Light"),
    ("particles_in_view", "Particles between camera and scene", "", "Particles"),
    ("particles_drawn_one_by_one", "Particles drawn one by one", "", "Particles"),
    ("share_drawn_one_by_one", "Share of particles drawn one by one", "%", "Particles"),
    ("share_of_optical_depth_drawn_one_by_one", "Share of optical depth drawn one by one", "%", "Particles"),
    ("mask_mean", "Mean of the particle mask, rendered", "%", "Particles"),
    ("mask_mean_expected", "Mean of the particle mask, expected: 1 − exp(−τ)", "%", "Particles"),
    ("set_up_s", "Set-up of the transform", "s", "Time"),
    ("draw_s", "Draw of the random numbers", "s", "Time"),
    ("render_s", "Rendering of the frame", "s", "Time"),
)
FACTORS = {"%": 100.0, "ms": 1000.0}  # of a share, of seconds
SUPERSCRIPT = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")


def number_text(value: float) -> str:
    """A number with three significant digits, for reading.

    Example:
        >>> [number_text(v) for v in (0.0, 0.002714, 2.5, 4213.0, 73500000.0, 2.1e-7)]
        ['0', '0.00271', '2.50', '4 210', '7.35 × 10⁷', '2.10 × 10⁻⁷']
    """
    if value == 0 or not math.isfinite(value):
        return "0" if value == 0 else "∞"
    mantissa, _, power = f"{value:.2e}".partition("e")
    exponent = int(power)
    if not -4 <= exponent < 5:
        return f"{mantissa} × 10{str(exponent).translate(SUPERSCRIPT)}"
    rounded = float(f"{value:.2e}")
    return f"{rounded:,.{max(0, 2 - exponent)}f}".replace(",", " ")


def signed_text(value: float | str, *, plus: bool = False) -> str:
    """A number with three significant digits and its sign; infinities, which an answer may hold as text, as ∞.

    Args:
        value: the number.
        plus: a plus before what is larger than zero.

    Example:
        >>> [signed_text(value) for value in (-0.02, 3.0, "inf", "nan")], signed_text(3.0, plus=True)
        (['−0.0200', '3.00', '∞', '–'], '+3.00')
    """
    number = float(value)
    if math.isnan(number):
        return NO_VALUE
    sign = "−" if number < 0 else "+" if plus and number > 0 else ""
    return sign + ("∞" if math.isinf(number) else number_text(abs(number)))


def fixed_text(value: float, digits: int = 2) -> str:
    """A number with so many decimals and a proper minus; a dash for none.

    Example:
        >>> [fixed_text(value) for value in (-0.5, math.inf, math.nan)]
        ['−0.50', '∞', '–']
    """
    if math.isnan(value):
        return NO_VALUE
    text = "∞" if math.isinf(value) else f"{abs(value):.{digits}f}"
    return f"−{text}" if math.copysign(1.0, value) < 0 else text


def numbers_table(records: Sequence[Mapping[str, Any]]) -> parts.Table:
    """Physical numbers of the weathers of a section; rows that one of them lacks are left out.

    Args:
        records: of the summary, with ``label``, ``numbers`` and ``times_s``.
    """
    columns = [{**record["numbers"], **record["times_s"]} for record in records]
    rows: list[Sequence[parts.Cell | str] | str] = []
    last = ""
    for key, name, unit, group in ROWS:
        if any(key not in column for column in columns):
            continue
        if group != last:
            rows.append(group)
        cells = (
            parts.Cell(number_text(100 * value if unit == "%" else value), data={"key": key, "value": value})
            for value in (column[key] for column in columns)
        )
        rows.append([name, unit, *cells])
        last = group
    labels = [record["label"] for record in records]
    return parts.Table(["Physical numbers", parts.Column("Unit", "unit"), *labels], rows)


def weathers_table(
    title: str,
    columns: Sequence[tuple[str, str, str]],
    records: Sequence[Mapping[str, Any]],
    sensor: str,
    text: Callable[[str, float], str],
) -> parts.Table:
    """Numbers of a sensor, a row for each weather.

    Args:
        title: of the table.
        columns: key of the summary, heading, unit.
        records: of the summary, with ``label``, ``numbers`` and ``times_s``.
        sensor: in the names of the cells' data.
        text: number of a key as it is written, in the column's unit.
    """
    rows = []
    for record in records:
        values = {**record["numbers"], **record["times_s"]}
        cells = []
        for key, _, unit in columns:
            value = values.get(key)
            data = {} if value is None else {f"{sensor}-key": key, f"{sensor}-value": value}
            shown = NO_VALUE if value is None else text(key, value * FACTORS.get(unit, 1))
            cells.append(parts.Cell(shown, data=data))
        rows.append([record["label"], *cells])
    heads = [f"{heading}, {unit}" if unit else heading for _, heading, unit in columns]
    return parts.Table([title, *heads], rows, look="heads")
