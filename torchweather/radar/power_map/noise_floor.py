"""Receiver noise of a map: the cells that hold nothing else, its mean power, its correlation along the range."""

from __future__ import annotations

import math

import torch
from scipy import special
from torch import Tensor

from torchweather.core.arguments import check_arguments
from torchweather.core.errors import InputValueError, check_between
from torchweather.radar.power_map.power_map import RadarPowerMap
from torchweather.radar.power_map.scale import PowerScale

__all__ = ["noise_correlation", "noise_floor_db", "quiet_cells", "with_noise_scale"]

BLOCK = 20  # cells along the range and lines of sight of a block
QUIETEST = 0.1  # share of the blocks whose cells are taken
EDGE_DB = 1e-9


def quiet_cells(power_map: RadarPowerMap) -> Tensor:
    """Cells that hold noise alone, as far as a map shows it.

    The map is cut into blocks of 20 range bins by 20 lines of sight (azimuths, and whatever else there is). Every other
    line ranks the blocks by their mean in dB; of the tenth with the lowest, the remaining lines are taken: noise is
    independent between lines, so the choice does not pull their level down.

    Args:
        power_map: the map.

    Returns:
        Bool, of the map's shape.
    """
    check_arguments("quiet_cells(power_map: RadarPowerMap)", power_map)
    axis = power_map.axes.dims.index("range")
    decibels = power_map.decibels
    finite = decibels.isfinite()
    lowest = decibels[finite].min() if bool(finite.any()) else decibels.new_zeros(())
    lines = torch.where(finite, decibels, lowest).movedim(axis, 0).flatten(1)  # (R, lines)
    bins, count = lines.shape
    if count < 2:  # one line of sight alone: its quietest bins
        chosen = lines <= lines.quantile(QUIETEST)
        return chosen.reshape(decibels.movedim(axis, 0).shape).movedim(0, axis)
    block = torch.arange(bins)[:, None] // BLOCK * math.ceil(count / BLOCK) + torch.arange(count) // BLOCK
    ranking = (torch.arange(count) % 2 == 0).expand(bins, count)
    number = int(block.max()) + 1
    total = torch.zeros(number, dtype=torch.float64)
    cells = torch.zeros(number, dtype=torch.float64)
    total.index_add_(0, block[ranking], lines[ranking].double().cpu())
    cells.index_add_(0, block[ranking], torch.ones(int(ranking.sum()), dtype=torch.float64))
    mean = torch.where(cells > 0, total / cells.clamp_min(1.0), torch.inf)
    taken = torch.zeros(number, dtype=torch.bool)
    taken[mean.argsort()[: max(1, round(QUIETEST * number))]] = True
    chosen = taken[block] & ~ranking
    return chosen.reshape(decibels.movedim(axis, 0).shape).movedim(0, axis).to(decibels.device)


def noise_floor_db(power_map: RadarPowerMap, looks: int = 1) -> float:
    """Mean power of the receiver noise of a map, dB in the map's own unit.

    From the median of ``quiet_cells``, which strong cells and a cut-off floor do not move; a mean of ``looks``
    exponential looks has ``median / mean = P^-1(looks, 1/2) / looks``.

    Args:
        power_map: the map.
        looks: independent looks whose mean power a cell holds.

    Raises:
        ValueError: half of the quiet cells or more are at the bottom of the scale: the floor was cut off.

    Example:
        >>> from torchweather.radar.power_map import MapAxes, PowerScale
        >>> power = -torch.rand(400, 400, generator=torch.Generator().manual_seed(1)).log()
        >>> axes = MapAxes.of_turn(bins=400, bin_m=0.2, azimuths=400)
        >>> abs(noise_floor_db(RadarPowerMap(power, axes, PowerScale("linear")))) < 0.2
        True
    """
    check_arguments("noise_floor_db(power_map: RadarPowerMap, looks: int)", power_map, looks)
    check_between("looks", looks, 1, 1 << 16, owner="noise_floor_db")
    quiet = power_map.values[quiet_cells(power_map)]
    if power_map.scale.kind == "db_steps":
        byte = quiet.float().sort().values
        middle = float(byte[len(byte) // 2])
        if middle == 0:
            raise InputValueError(
                "noise_floor_db: half of the quietest cells or more are byte 0: the map was cut off above its noise. "
                "Give noise_floor_db, the mean noise in dB of the map."
            )
        # Within the level, by the share of the cells that are below and above it.
        share = float((byte < middle).double().mean()), float((byte <= middle).double().mean())
        low, high = power_map.scale.bounds_db(torch.tensor([int(middle)], dtype=torch.uint8))
        median_db = float(torch.lerp(low, high, (0.5 - share[0]) / max(share[1] - share[0], EDGE_DB)))
    else:
        median_db = float(power_map.scale.decibels(quiet).median())
    if not math.isfinite(median_db):
        raise InputValueError(
            "noise_floor_db: half of the quietest cells or more have no power at all: the map was cut off above its "
            "noise. Give noise_floor_db, the mean noise in dB of the map."
        )
    return median_db - 10.0 * math.log10(float(special.gammaincinv(looks, 0.5)) / looks)


def with_noise_scale(power_map: RadarPowerMap, step_db: float = 0.5) -> RadarPowerMap:
    """A map of bytes with ``PowerScale.from_noise`` of its own quiet cells: its noise floor is 0 dB.

    Args:
        power_map: of bytes.
        step_db: of one level away from the noise.
    """
    check_arguments("with_noise_scale(power_map: RadarPowerMap, step_db: float)", power_map, step_db)
    scale = PowerScale.from_noise(power_map.values[quiet_cells(power_map)], step_db)
    return power_map.with_scale(scale)


def noise_correlation(power_map: RadarPowerMap, lags: int = 4) -> list[float]:
    """Correlation of the noise power between range bins 1, 2, ... apart, over the quiet blocks of a map.

    By ranks turned into exponential numbers, so that the scale does not matter.

    Args:
        power_map: the map.
        lags: how many.

    Note:
        For complex Gaussian noise it is the square of the amplitude's correlation.
    """
    check_arguments("noise_correlation(power_map: RadarPowerMap, lags: int)", power_map, lags)
    axis = power_map.axes.dims.index("range")
    check_between("lags", lags, 1, len(power_map.axes.range_m) - 1, owner="noise_correlation")
    chosen = quiet_cells(power_map).movedim(axis, 0).flatten(1)
    lines = power_map.decibels.movedim(axis, 0).flatten(1)
    values = lines[chosen].double()
    # Ranks of equal numbers are drawn apart at random; the seed makes it repeatable.
    tie = torch.rand(len(values), generator=torch.Generator().manual_seed(0), dtype=torch.float64)
    order = torch.argsort(torch.argsort(tie)).double() / len(values)
    rank = torch.argsort(torch.argsort(values + 1e-6 * order)).double()
    power = torch.zeros_like(lines, dtype=torch.float64)
    power[chosen] = -(1.0 - (rank + 0.5) / len(values)).log()
    found = []
    for lag in range(1, lags + 1):
        both = chosen[:-lag] & chosen[lag:]
        first, second = power[:-lag][both], power[lag:][both]
        if len(first) < 2:
            raise InputValueError(
                f"noise_correlation: no two quiet cells lie {lag} bins apart. Give fewer lags, or a larger map."
            )
        found.append(float(torch.corrcoef(torch.stack([first, second]))[0, 1]))
    return found
