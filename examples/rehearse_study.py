"""A study from REHEARSE-3D's layout: targets at 15 m, 28 m or 56 m before a Lucid Triton, an OS1-128 and a radar.

    python examples/rehearse_study.py                                       # car at 28 m, simulated recordings
    python examples/rehearse_study.py --target pedestrian --distance 15     # in fog of 10, 30 and 50 m
    python examples/rehearse_study.py --root REHEARSE3D_PUBLIC --clear 000 --measured 001=rain:rate=10 002=rain:rate=50

Reads the sequences with `read_rehearse`, counts what each sensor recorded, and validates the LiDAR's clouds: measured
against clear beside simulated against clear. Without a data set it writes recordings of its own in the same layout,
made in the halls of REHEARSE by the library, with a LiDAR window that loses 3 dB and about which the record is silent:
the page shows what such an omission looks like.
"""

from __future__ import annotations

from pathlib import Path

import matplotlib
from parts.rehearse_recordings import hall_of, write_recordings
from parts.shared import command_line

import torchweather as tw
from torchweather.datasets import read_rehearse
from torchweather.evaluation.validation import validate
from torchweather.gap import study_from_folders
from torchweather.report.validation_page import write_validation

parser = command_line(__doc__)
parser.add_argument("--root", type=Path, help="REHEARSE3D_PUBLIC; default: simulated recordings in the output folder")
parser.add_argument("--clear", default="000", help="sequence in clear air; default 000")
parser.add_argument(
    "--measured", nargs="+", metavar="NAME=WEATHER", help="sequences in weather, such as 001=rain:rate=10"
)
parser.add_argument("--target", choices=("car", "boards", "pedestrian"), default="car", help="of the simulation")
parser.add_argument("--distance", type=float, choices=(15.0, 28.0, 56.0), default=28.0, help="m, of the simulation")
parser.add_argument("--columns", type=int, default=1024, help="of the OS1-128; fewer is quicker")
parser.add_argument("--width", type=int, default=484, help="of the simulated pictures, px")
parser.add_argument("--frames", type=int, default=5, help="simulated frames of each sequence in weather")
parser.add_argument("--out", type=Path, default=Path("rehearse"), help="folder for the page")
arguments = parser.parse_args()
matplotlib.use("Agg")

# The azimuth offsets of the preset are those of one unit; with the metadata of the recording give its own.
lidar = tw.Lidar.preset("ouster-os1-128", columns=arguments.columns, azimuth_offsets_deg=None, origin_heights_m=None)
if arguments.root is None:
    root = arguments.out / "REHEARSE3D_PUBLIC"
    whole = tw.Camera.preset("lucid-triton")
    camera = whole.resized(arguments.width, arguments.width * whole.height // whole.width // 2 * 2)
    levels = (
        [tw.Fog(mor_m=v) for v in (50.0, 30.0, 10.0)] if arguments.distance < 20 else [tw.Rain(r) for r in (10, 25, 50)]
    )
    scene = hall_of(arguments.target, arguments.distance)
    weathers = write_recordings(root, scene, levels, lidar, camera, frames=arguments.frames, window_loss_db=3.0)
else:
    if not arguments.measured:
        parser.error("--root needs --measured NAME=WEATHER ...")
    root, weathers = arguments.root, dict(one.split("=", 1) for one in arguments.measured)

sequences = {one.folder.name: one for one in read_rehearse(root)}
for name in (arguments.clear, *weathers):
    one, weather = sequences[name], weathers.get(name, "clear")
    says = weather if isinstance(weather, str) else f"{weather.kind} {weather.intensity:g}"
    print(f"{name} {says}: " + ", ".join(f"{len(files)} x {folder}" for folder, files in one.frames.items()))
    print(f"    first frames: {int((one.points(0)[:, :3] != 0).any(-1).sum())} returns of the LiDAR")
    if "ext_radar" in one.frames:
        print(f"    {len(one.radar(0).points)} detections of the radar")
    if "arena" in one.frames:
        picture = one.image(0)
        print(f"    a picture of {picture.shape[-1]} x {picture.shape[-2]} px")

study = study_from_folders(
    sequences[arguments.clear].folder / "ouster",
    {sequences[name].folder / "ouster": weather for name, weather in weathers.items()},
    lidar,
)
validation = validate(study, names=("sdm", "mde"))
write_validation(arguments.out / "page", study, validation)
print(validation.verdict())
print(f"page: {arguments.out / 'page' / 'index.html'}")
