"""Beams of a sweep compared with those of a turn: rings times columns."""

from __future__ import annotations

from torchweather.core.arguments import check_arguments
from torchweather.core.errors import InputValueError, check_at_least
from torchweather.lidar.sweep.scan_pattern import ScanPattern

__all__ = ["check_scan_counts", "scan_count_problem"]

_TURN_DEG = 360.0
_SECOND_ECHOES = 1.02
# Cells at the ends of the rings and the sensor's drift of speed; KITTI's sweeps differ by less.
_TOLERANCE = 0.03


def scan_count_problem(
    pattern: ScanPattern,
    appended: int,
    *,
    rings: int | None = None,
    columns: int | None = None,
    tolerance: float = _TOLERANCE,
) -> str | None:
    """Compare beams with a return plus appended beams with rings times columns.

    Args:
        pattern: of the sweep.
        appended: beams without return that were found.
        rings: of the sensor; ``None`` takes those of the pattern.
        columns: of the sensor; ``None`` takes those of the pattern.
        tolerance: share by which they may differ.

    Returns:
        A sentence with the evidence and the likely cause, or ``None`` where they agree.

    Example:
        >>> import numpy as np
        >>> from torchweather.lidar import estimate_pattern
        >>> azimuth = np.radians(np.arange(0.0, 360.0))
        >>> rows = [np.stack([9 * np.cos(azimuth), 9 * np.sin(azimuth), np.full(360, z)], -1) for z in (-1.0, 0.0)]
        >>> pattern = estimate_pattern(np.concatenate(rows))
        >>> scan_count_problem(pattern, 0) is None
        True
        >>> print(scan_count_problem(pattern, 0, columns=720))
        720 beams with a return + 0 without are 720, but 2 rings x 720 columns are 1440 (50.0 % off). The columns are \
wrong: neighbours stand 1.000 degrees apart, which is 360 columns (360 to 360).
    """
    check_arguments(
        "scan_count_problem(pattern: ScanPattern, appended: int, rings: int | None, columns: int | None, "
        "tolerance: float)",
        pattern,
        appended,
        rings,
        columns,
        tolerance,
    )
    rings = pattern.rings if rings is None else rings
    columns = pattern.columns if columns is None else columns
    for name, count in (("rings", rings), ("columns", columns)):
        check_at_least(name, count, 1, owner="scan_count_problem")
    beams, wanted = pattern.beams + appended, rings * columns
    off = abs(beams - wanted) / wanted
    # Where a sector is not covered, no beams are appended there either.
    if off <= tolerance or (beams < wanted and beams >= (1 - tolerance) * wanted * pattern.coverage_deg / _TURN_DEG):
        return None
    return (
        f"{pattern.beams} beams with a return + {appended} without are {beams}, but {rings} rings x {columns} columns "
        f"are {wanted} ({100 * off:.1f} % off). {_cause(pattern, beams > wanted, rings, columns)}"
    )


def check_scan_counts(
    pattern: ScanPattern,
    appended: int,
    *,
    rings: int | None = None,
    columns: int | None = None,
    tolerance: float = _TOLERANCE,
) -> None:
    """Raise ``ValueError`` with the evidence where the beams do not make one turn; see `scan_count_problem`."""
    check_arguments(
        "check_scan_counts(pattern: ScanPattern, appended: int, rings: int | None, columns: int | None, "
        "tolerance: float)",
        pattern,
        appended,
        rings,
        columns,
        tolerance,
    )
    problem = scan_count_problem(pattern, appended, rings=rings, columns=columns, tolerance=tolerance)
    if problem is not None:
        raise InputValueError(f"check_scan_counts: {problem}")


def _cause(pattern: ScanPattern, many: bool, rings: int, columns: int) -> str:
    low, high = pattern.columns_interval
    returns = int(pattern.counts.sum())
    if returns > _SECOND_ECHOES * pattern.beams and many:
        return (
            f"The file holds two echoes a beam ({returns} returns of {pattern.beams} beams): set "
            "Lidar(return_mode='dual'). Or it holds several sweeps: pass one."
        )
    if pattern.rings != rings:
        return (
            f"The sweep shows {pattern.rings} rings ({pattern.elevations_deg.min():.1f} to "
            f"{pattern.elevations_deg.max():.1f} degrees): another sensor, or a part of a sweep."
        )
    if not low * (1 - _TOLERANCE) <= columns <= high * (1 + _TOLERANCE):
        return (
            f"The columns are wrong: neighbours stand {pattern.step_deg:.3f} degrees apart, which is {pattern.columns} "
            f"columns ({low:.0f} to {high:.0f})."
        )
    if pattern.frame is not None and pattern.frame.sentences():
        return " ".join(pattern.frame.sentences())
    if pattern.coverage_deg < _TURN_DEG:
        return f"The sweep covers {pattern.coverage_deg:.0f} degrees of azimuth: a blocked sector, or a part of a turn."
    return (
        "Rings or sectors without any return were not found, or the returns are thinned. Compare the pattern with the "
        "sensor's (estimate_pattern)."
    )
