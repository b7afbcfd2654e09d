"""``torchweather explain``: the numbers behind a weather, for any sensor."""

from __future__ import annotations

import argparse

NAME = "explain"
SUMMARY = "the numbers behind a weather"
DESCRIPTION = """Extinction and backscatter per band, visibility, particles and liquid water of a weather as a sensor
sees it; for radar the attenuation, one way. In JSON an unlimited visibility is null."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments of the command."""
    parser.add_argument(
        "--weather", required=True, help="rain:rate=25, fog:mor=30, snow:rate=1, or several joined by +"
    )
    parser.add_argument(
        "--sensor",
        default="camera",
        help="camera, lidar or radar, with :PRESET (see torchweather list)",
    )
    parser.add_argument("--wavelength-nm", type=float, help="one band of a camera or LiDAR, at this wavelength")
    parser.add_argument("--frequency-ghz", type=float, help="carrier of a radar")
    parser.add_argument("--polarisation", help="of a radar: h or v")
    parser.add_argument(
        "--uncertainty",
        action="store_true",
        help="also print the range of every number as each unmeasured default is varied (up to a minute)",
    )


def run(args: argparse.Namespace) -> int:
    """Print the numbers."""
    from torchweather.cli.output import print_json, print_lines
    from torchweather.explain import explain, explanation_text

    numbers = explain(
        args.weather,
        args.sensor,
        wavelength_nm=args.wavelength_nm,
        frequency_ghz=args.frequency_ghz,
        polarisation=args.polarisation,
        receiver=True,
    )
    if args.uncertainty:
        from torchweather.evaluation.sensitivity import printed_uncertainty

        ranges = printed_uncertainty(args.weather, args.sensor, numbers)
        numbers["uncertainty"] = {
            name: {"value": value, "least": least, "largest": largest}
            for name, (value, least, largest) in ranges.items()
        }
    if args.json:
        print_json(numbers)
    else:
        print_lines(explanation_text(numbers))
    return 0
