"""``torchweather fit-sensor``: a LiDAR's scan pattern and near-range response from its recordings."""

from __future__ import annotations

import argparse
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

from torchweather.cli.clouds import add_reading
from torchweather.cli.sensor_text import preset_named
from torchweather.core.exceptions import InputValueError

if TYPE_CHECKING:
    import numpy as np
    from torch import Tensor

    from torchweather.cli.clouds import CloudFrame
    from torchweather.lidar import NearResponseFit, PatternFit, ScanPattern
    from torchweather.lidar.sensor import Lidar

NAME = "fit-sensor"
SUMMARY = "measure a LiDAR's rings, columns and near-range response in its recordings"
DESCRIPTION = """Fits the elevation and height of each ring and the columns of a turn to sweeps of one LiDAR. Where
the files have a signal beside the reflectivity, its near-range response and photon constant are fitted, too. Such
files are an OS2's .pcap, or have the columns signal and reflectivity. Writes a sensor file that --sensor
lidar:my.yaml takes, with 95 percent intervals, and a figure of the same name (.png). Fields that are not measured
stay as the preset has them."""

YAML_SUFFIXES = (".yaml", ".yml")
# Responses are fitted to diffuse targets; REFLECTIVITY counts percent up to 100.
PERCENT = 100.0
# A tilt of 1 degree moves the lowest rings of KITTI by 0.1 degree, one of 5 degrees by 1. No head has its lasers higher
# over its own origin than 0.25 m.
MOST_TILT_DEG, MOST_HEIGHT_M = 0.5, 0.5


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments of the command."""
    parser.add_argument(
        "inputs", nargs="+", type=Path, metavar="FILES", help="sweeps of one sensor, or folders of them"
    )
    parser.add_argument("-o", "--out", type=Path, required=True, metavar="YAML", help="sensor file to write")
    parser.add_argument(
        "--sensor", help="lidar:PRESET that gives what is not measured; default the product that an Ouster file names"
    )
    parser.add_argument("--rings", type=int, help="number of rings; default as many as the sweeps show")
    parser.add_argument("--min-range-m", type=float, help="nearer points are no returns; default the preset's")
    parser.add_argument("--intensity", metavar="COLUMN", help="see torchweather apply; not needed for the pattern")
    parser.add_argument("--meta", type=Path, metavar="JSON", help="of a .pcap; default the .json of its name")
    add_reading(parser)
    parser.add_argument("--quiet", action="store_true", help="no notes about what the sweeps leave open")


def run(args: argparse.Namespace) -> int:
    """Fit and write."""
    from torchweather.cli.output import note, print_json, print_lines
    from torchweather.lidar.sweep.pattern_fit import combine_patterns
    from torchweather.report.sensor_fit_figures import draw_sensor_fit

    if args.out.suffix.lower() not in YAML_SUFFIXES:
        raise InputValueError(f"fit-sensor: --out must be a sensor file, such as my.yaml; got {args.out}.")
    found = _gathered(args)
    pattern, near = combine_patterns(found.patterns), found.near_response()
    notes = [*pattern.notes, *(near.notes if near else ())]
    if near is None:
        notes.append(
            f"The files have no signal beside the reflectivity: the near-range response is {found.preset}'s, not "
            "measured."
        )
    notes += _other_preset(pattern, found)
    fields = {**pattern.fields(found.lidar), **_near_fields(near, found.lidar)}
    if found.ring_column is not None:
        fields["ring_column"] = found.ring_column
    _write(args.out, found, fields, pattern, near)
    figure = args.out.with_suffix(".png")
    draw_sensor_fit(figure, pattern, near, found.lidar, found.preset)
    for text in notes:
        note(text, quiet=args.quiet)
    if args.json:
        print_json({"out": args.out, "figure": figure, **_numbers(pattern, near), "notes": notes})
    else:
        print_lines("\n".join([*_lines(pattern, near), f"wrote {args.out} and {figure}"]))
    return 0


def _other_preset(pattern: PatternFit, found: _Gathered) -> list[str]:
    """A note where the rings are those of another preset than the one that gives what is not measured."""
    import numpy as np

    from torchweather.lidar.sweep.sweep_cause import preset_of_rings, sensor_problem

    known = pattern.elevations_deg[np.isfinite(pattern.elevations_deg)]
    if not found.lidar.elevations_deg or not sensor_problem(pattern, found.lidar):
        return []
    own = preset_of_rings(known)
    if own is None:
        return []
    rest = f"wavelength, beam and link budget are {found.preset}'s"
    return [f"The rings are those of {own}; {rest}. Give --sensor lidar:{own}."]


@dataclass
class _Gathered:
    """Findings of all files."""

    preset: str
    lidar: Lidar
    patterns: list[ScanPattern] = field(default_factory=list)
    names: list[str] = field(default_factory=list)
    ring_column: int | None = None
    signal: list[np.ndarray[Any, Any]] = field(default_factory=list)  # rows of signal, reflectivity, range

    def near_response(self) -> NearResponseFit | None:
        """Fit where the files have a signal."""
        import numpy as np

        from torchweather.lidar import fit_near_response

        if not self.signal:
            return None
        signal, reflectivity, range_m = np.concatenate(self.signal, axis=1)
        return fit_near_response(signal, reflectivity, range_m)


def _gathered(args: argparse.Namespace) -> _Gathered:
    from torchweather.cli.clouds import clouds_in, gathered_clouds
    from torchweather.cli.ouster_product import refuse_other_product
    from torchweather.core.errors import TorchweatherError
    from torchweather.lidar import estimate_pattern

    found: _Gathered | None = None
    for path in gathered_clouds(args.inputs):
        for frame in clouds_in(path, args):
            if found is None:
                found = _Gathered(*_sensor(args, frame))
            refuse_other_product(frame.name, frame.product, found.lidar, argparse.Namespace(), NAME)
            points, columns = frame.cloud.points, frame.cloud.columns
            ring = None
            if "ring" in columns:
                found.ring_column = columns.index("ring")
                ring = points[:, found.ring_column].long()
            nearest = found.lidar.min_range_m if args.min_range_m is None else args.min_range_m
            try:
                pattern = estimate_pattern(points, ring, args.rings, min_range_m=nearest)
            except ValueError as error:
                raise TorchweatherError(f"{frame.name}: {_elsewhere(points, ring) or error}") from error
            _refuse_other_frame(frame.name, pattern)
            found.patterns.append(pattern)
            found.names.append(frame.path.name)
            found.signal += _signal(frame, args)
    assert found is not None  # gathered_clouds gives a file, and every file a cloud
    return found


def _elsewhere(points: Tensor, ring: Tensor | None) -> str:
    """Sentence about a cloud whose sensor stands beside its origin; empty where it does not, or no rings are found."""
    from torchweather.lidar.sweep.sensor_origin import estimate_origin

    origin = estimate_origin(points[:, :3].double().numpy(), None if ring is None else ring.numpy())
    if origin is None or not origin.is_apart:
        return ""
    place = ", ".join(f"{metres:.2f}" for metres in origin.origin_m)
    return (
        f"fit-sensor: expected a sweep in its sensor's frame; the sensor stands at ({place}) m in this cloud's. "
        "Subtract that place from the points."
    )


def _refuse_other_frame(name: str, pattern: ScanPattern) -> None:
    """Raise where elevations would be those of a tilted cloud, or heights those over another origin."""
    import numpy as np

    from torchweather.core.errors import TorchweatherError

    tilt_deg = 0.0 if pattern.frame is None else float(np.hypot(*pattern.frame.tilt_deg))
    height_m = float(np.nanmedian(pattern.heights_m))
    came = ""
    if tilt_deg > MOST_TILT_DEG:
        came = f"the cloud is tilted by {tilt_deg:.1f} degrees against its sensor. Turn it level"
    elif abs(height_m) > MOST_HEIGHT_M:
        came = f"its beams start {height_m:.2f} m above the cloud's origin. Subtract that from z"
    if came:
        raise TorchweatherError(f"{name}: fit-sensor: expected a sweep in its sensor's frame; {came}.")


def _sensor(args: argparse.Namespace, frame: CloudFrame) -> tuple[str, Lidar]:
    from torchweather.cli.ouster_product import preset_of_product
    from torchweather.lidar.sensor import Lidar

    preset = preset_named(args.sensor, "lidar", "fit-sensor: --sensor must be lidar:PRESET")
    preset = preset or preset_of_product(frame.product) or ""
    if not preset:
        raise InputValueError(
            "fit-sensor: --sensor lidar:PRESET is needed: sweeps do not show wavelength, beam and link budget. Take "
            "the nearest preset of torchweather list, such as lidar:velodyne-hdl-64e."
        )
    return preset, Lidar.preset(preset)


def _signal(frame: CloudFrame, args: argparse.Namespace) -> list[np.ndarray[Any, Any]]:
    """Signal, reflectivity (1 = white) and range of a frame's returns, ``(3, N)``; empty where it has no signal."""
    import numpy as np

    from torchweather.core.errors import TorchweatherError
    from torchweather.io import read_ouster

    columns, points = frame.cloud.columns, frame.cloud.points.double()
    range_m = points[:, :3].norm(dim=1)
    if "signal" in columns and "reflectivity" in columns:
        signal, reflectivity = (points[:, columns.index(name)] for name in ("signal", "reflectivity"))
    elif frame.number is not None:
        if args.intensity not in (None, "reflectivity"):
            return []
        try:
            for number, other in enumerate(read_ouster(frame.path, args.meta, intensity="signal")):
                if number == frame.number:
                    signal = other.cloud.points[:, 3].double()
                    break
            else:
                return []
        except TorchweatherError:  # a low-bandwidth recording
            return []
        reflectivity = points[:, 3]
    else:
        return []
    return [np.stack([signal.numpy(), reflectivity.numpy() / PERCENT, range_m.numpy()])]


def _near_fields(near: NearResponseFit | None, lidar: Lidar) -> dict[str, Any]:
    if near is None:
        return {}
    fitted = near.applied_to(lidar)
    names = ("near_start_m", "near_full_m", "near_power", "photons_at_threshold")
    return {name: getattr(fitted, name) for name in names}


def _write(
    path: Path, found: _Gathered, fields: dict[str, Any], pattern: PatternFit, near: NearResponseFit | None
) -> None:
    import yaml

    from torchweather import __version__
    from torchweather.io import atomic_write

    few, most = pattern.columns_range
    measured = (
        f"Measured by torchweather {__version__} fit-sensor in {_sweeps(found.names)}: elevations (95 % interval "
        f"within {_worst(pattern.elevation_interval_deg):.4f} degree), "
        f"heights of the beams' start (within {_worst(pattern.height_interval_m):.4f} m), columns ({few} to {most} a "
        f"sweep); rings by {pattern.found_by}."
    )
    if near is not None:
        measured += (
            f" Near-range response and photon constant {near.photon_constant:,.0f} +- "
            f"{near.photon_constant_interval:,.0f} from signal and reflectivity (full from {near.near_full_m:.1f} +- "
            f"{near.near_full_interval_m:.1f} m, power {near.near_power:.2f} +- {near.near_power_interval:.2f}; "
            "photons at the threshold with the preset's range at 10 %)."
        )
    values = {
        "kind": "lidar",
        "preset": found.preset,
        **{name: list(value) if isinstance(value, tuple) else value for name, value in fields.items()},
        "source": f"{measured} All else is that of {found.preset}, not measured.",
    }
    path.parent.mkdir(parents=True, exist_ok=True)
    with atomic_write(path) as unfinished:
        text = yaml.safe_dump(values, sort_keys=False, allow_unicode=True, width=110, default_flow_style=None)
        unfinished.write_text(text, encoding="utf-8")


def _sweeps(names: list[str]) -> str:
    """Number and names of the sweeps."""
    first_last = names[0] if names[0] == names[-1] else f"{names[0]} to {names[-1]}"
    return f"{len(names)} {'sweep' if len(names) == 1 else 'sweeps'} ({first_last})"


def _worst(values: np.ndarray[Any, Any]) -> float:
    """Largest finite value; 0 of none."""
    import numpy as np

    return float(np.max(values[np.isfinite(values)], initial=0.0))


def _numbers(pattern: PatternFit, near: NearResponseFit | None) -> dict[str, Any]:
    numbers: dict[str, Any] = {
        "sweeps": pattern.sweeps,
        "rings": pattern.rings,
        "found_by": pattern.found_by,
        "columns": pattern.columns,
        "columns_range": list(pattern.columns_range),
    }
    for name in ("elevations_deg", "elevation_interval_deg", "heights_m", "height_interval_m", "spread_deg"):
        numbers[name] = getattr(pattern, name).tolist()
    if near is not None:
        names = ("photon_constant", "near_full_m", "near_power")
        intervals = ("photon_constant_interval", "near_full_interval_m", "near_power_interval")
        numbers["near_response"] = {name: getattr(near, name) for name in (*names, *intervals)}
    return numbers


def _lines(pattern: PatternFit, near: NearResponseFit | None) -> list[str]:
    import numpy as np

    low, high = float(np.nanmin(pattern.elevations_deg)), float(np.nanmax(pattern.elevations_deg))
    known = pattern.heights_m[np.isfinite(pattern.height_interval_m)]
    within, spread = _worst(pattern.elevation_interval_deg), _worst(pattern.spread_deg)
    heights = f"{known.min():.3f} to {known.max():.3f} m" if len(known) else "not told by these sweeps"
    lines = [
        f"{pattern.sweeps} sweeps, {pattern.rings} rings by {pattern.found_by}",
        f"elevations: {low:.2f} to {high:.2f} degrees (95 % within {within:.4f}); points {spread:.4f} about them",
        f"columns a turn: {pattern.columns} ({pattern.columns_range[0]} to {pattern.columns_range[1]})",
        f"heights of the beams' start: {heights}",
    ]
    if near is not None:
        lines.append(
            f"near-range response: min(1, R / {near.near_full_m:.1f} m) ^ {near.near_power:.2f} (95 %: +- "
            f"{near.near_full_interval_m:.1f} m, +- {near.near_power_interval:.2f}); photon constant "
            f"{near.photon_constant:,.0f} +- {near.photon_constant_interval:,.0f}"
        )
    return lines
