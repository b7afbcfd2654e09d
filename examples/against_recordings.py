"""One table of what was simulated with defaults beside what was recorded: ratio, interval, power, verdict.

    TORCHWEATHER_REAL_DATA=/data python examples/against_recordings.py                 # all rows, some minutes
    TORCHWEATHER_REAL_DATA=/data python examples/against_recordings.py --only links    # highway, wads, links, drops

Ratios are of independent units: blocks of frames, frames, groups of links, hours of drops. ``consistent within``
is said only where the units would have shown a factor of 1.5 with 80 % power; otherwise the row is ``not decided``.
Nothing is fitted to the rows but where their page says so. Writes ``rows.json``.
"""

from __future__ import annotations

import io
import json
import re
import runpy
import sys
import tempfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import redirect_stdout
from dataclasses import asdict
from pathlib import Path
from unittest import mock

import numpy as np
from parts.link_losses import WET_MM_PER_H, measured_db, quiet_links
from parts.link_recordings import folder_of, read_germany, read_gothenburg
from parts.link_scores import GERMANY, GOTHENBURG
from parts.shared import command_line, recordings, write_json
from parts.verdicts import Row, markdown, row_of

from torchweather.core.exceptions import TorchweatherError
from torchweather.io import read_disdrometer
from torchweather.physics import Binned, close_rate, extinction_per_m, marshall_palmer

HERE = Path(__file__).parent
KEPT_MORNING = "20200222"  # estimators were chosen on the others
LINK_GROUPS = 10
LEAST_RATE_MM_PER_H, MINUTES, LEAST_MINUTES = 1.0, 60, 5
WAVELENGTH_NM = 550.0
WADS_RATE = "1"


def _example(name: str, *arguments: str) -> None:
    """An example in this process; what it prints is not shown."""
    with mock.patch.object(sys, "argv", [name, *arguments]), redirect_stdout(io.StringIO()):
        runpy.run_path(str(HERE / name), run_name="__main__")


def highway(root: Path, shrink: int = 2) -> Iterator[Row]:
    """The morning in fog that was kept: fitted visibility over the meter's, brightness simulated over recorded."""
    with tempfile.TemporaryDirectory() as folder:
        kept = Path(folder, "kept")
        (kept / "frames").mkdir(parents=True)
        data = root / "roadcam_fog"
        (kept / "frames" / KEPT_MORNING).symlink_to((data / "frames" / KEPT_MORNING).resolve())
        (kept / "visibility").symlink_to((data / "visibility").resolve())
        out = Path(folder, "out")
        _example(
            "fog_on_a_highway.py", "--data", str(kept), "--out", str(out), "--shrink", str(shrink), "--bootstrap", "50"
        )
        found = json.loads((out / "highway.json").read_text(encoding="utf-8"))
    yield from highway_rows(found)


def highway_rows(found: Mapping[str, object]) -> Iterator[Row]:
    """Rows of what ``fog_on_a_highway.py`` wrote."""
    blocks, curves = found["blocks"], found["brightness_over_clear"]
    assert isinstance(blocks, list)
    assert isinstance(curves, dict)
    name = "highway camera in fog"
    for estimator in ("measured_airlight", "local_contrast"):
        # A visibility that is fitted too long is an extinction that is recorded too small.
        ratios = [row["fits"][estimator][0] / row["meter_m"] for row in blocks]
        yield row_of(name, f"extinction: meter's over fitted, `{estimator}`", ratios)
    edges = np.array(found["depth_edges_m"])
    for low, high in ((8.0, 22.0), (46.0, 110.0)):
        place = (edges[:-1] >= low) & (edges[1:] <= high)
        ratios = [
            float(np.mean(np.array(one["simulated"])[place]) / np.mean(np.array(one["recorded"])[place]))
            for one in curves.values()
        ]
        yield row_of(name, f"brightness of the road, {low:g} to {high:g} m", ratios)


def wads(root: Path) -> Iterator[Row]:
    """Falling snow on a LiDAR: what hardly depends on the snowfall, which is not known."""
    data, ratios = root / "wads_snow", {"median range of snow": [], "share of snow at intensity 0": []}
    for path in sorted((data / "velodyne").glob("*.bin")):
        with tempfile.TemporaryDirectory() as folder:
            for kind, ending in (("velodyne", ".bin"), ("labels", ".label")):
                Path(folder, kind).mkdir()
                Path(folder, kind, path.stem + ending).symlink_to((data / kind / (path.stem + ending)).resolve())
            out = Path(folder, "out")
            _example("lidar_snow_against_wads.py", "--data", folder, "--out", str(out), "--rates", WADS_RATE)
            found = json.loads((out / "wads.json").read_text(encoding="utf-8"))
        recorded = found["recorded"]
        simulated = next(
            run
            for run in found["simulated"]
            if run["sensor"] == "pandar64-wads" and run["reported"] == "strongest and last"
        )
        for name, key, place in (
            ("median range of snow", "range of snow, 5/50/95 %, m", 1),
            ("share of snow at intensity 0", "snow points at intensity 0", None),
        ):
            both = [one[key] if place is None else one[key][place] for one in (simulated, recorded)]
            ratios[name].append(both[0] / both[1])
    for name, values in ratios.items():
        yield row_of("WADS, snow on a LiDAR", name, values)


def links(root: Path) -> Iterator[Row]:
    """Attenuation of rain on microwave links, P.838-3 over measured, by groups of links."""
    for name, file, read, rules in (
        ("links, Germany", "example_cml_data.nc", read_germany, GERMANY),
        ("links, Gothenburg", "openMRG_example.nc", read_gothenburg, GOTHENBURG),
    ):
        folder = folder_of(file, root)
        if folder is None:
            continue
        recording = read(folder)
        measured, _ = measured_db(recording)
        chosen = quiet_links(recording, measured, rules.longer_than_km)
        wet = chosen & np.isfinite(recording.model_db - measured) & (recording.rain_mm_per_h > WET_MM_PER_H)
        group = np.arange(wet.shape[1]) % LINK_GROUPS
        ratios = [
            float(
                recording.model_db[:, group == k][wet[:, group == k]].sum()
                / measured[:, group == k][wet[:, group == k]].sum()
            )
            for k in range(LINK_GROUPS)
        ]
        yield row_of(name, "attenuation of rain above 0.1 mm/h", ratios)


def drops(root: Path) -> Iterator[Row]:
    """Extinction of Marshall-Palmer drops over that of the drops that disdrometers counted, at the same rate."""
    for path in sorted((root / "disdrometer").iterdir()):
        if path.suffix == ".txt":
            continue
        try:
            every = read_disdrometer(path)
        except TorchweatherError as error:
            print(f"{path.name}: left out: {error}", file=sys.stderr)
            continue
        wet = every.chosen(every.rate_mm_per_h > LEAST_RATE_MM_PER_H)
        if len(wet.rate_mm_per_h) < 2 * LEAST_MINUTES:
            continue
        counted = extinction_per_m(Binned(wet.edges_mm, wet.density_per_m3_mm), WAVELENGTH_NM).numpy()
        seen = wet.density_per_m3_mm.sum(0).nonzero().flatten()  # the diameters that the instrument resolves
        smallest, largest = float(wet.edges_mm[seen[0]]), float(wet.edges_mm[seen[-1] + 1])
        alike = marshall_palmer(
            wet.rate_mm_per_h, diameter_min_mm=max(smallest, 0.1), diameter_max_mm=min(largest, 8.0)
        )
        model = extinction_per_m(close_rate(alike, wet.rate_mm_per_h), WAVELENGTH_NM)
        minutes = np.asarray(wet.time_s) // (60.0 * MINUTES)
        ratios = [
            float(model.numpy()[minutes == one].sum() / counted[minutes == one].sum()) for one in np.unique(minutes)
        ]
        date = re.findall(r"20\d{6}", path.name)
        name = f"disdrometer, {date[0] if date else path.name}"
        yield row_of(name, "extinction of rain at the counted rate, Marshall-Palmer over counted", ratios)


ROWS: Mapping[str, Callable[[Path], Iterator[Row]]] = {"highway": highway, "wads": wads, "links": links, "drops": drops}


def table(names: Sequence[str], root: Path) -> list[Row]:
    """Rows of some recordings."""
    return [row for name in names for row in ROWS[name](root)]


def main() -> None:
    parser = command_line(__doc__)
    parser.add_argument("--data", type=Path, help="folder that holds the recordings; else TORCHWEATHER_REAL_DATA")
    parser.add_argument("--only", choices=tuple(ROWS), help="one recording")
    parser.add_argument("--out", type=Path, default=Path("against_recordings"), help="folder to write to")
    arguments = parser.parse_args()
    root = recordings(arguments.data, "roadcam_fog").parent if arguments.data is None else arguments.data
    rows = table([arguments.only] if arguments.only else list(ROWS), root)
    arguments.out.mkdir(parents=True, exist_ok=True)
    write_json(arguments.out / "rows.json", [asdict(row) | {"verdict": row.verdict} for row in rows])
    print(markdown(rows))


if __name__ == "__main__":
    main()
