"""The page docs/d34-scores.md from d34_scores.json.

python benchmarks/d34_table.py            # writes the page
python benchmarks/d34_table.py --check    # exit code 1 where the page does not say what the file says
"""

from __future__ import annotations

import argparse
import json
import re
import sys
import textwrap
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from depth_table import table

HERE = Path(__file__).parent
PAGE = HERE.parent / "docs" / "d34-scores.md"
WITHIN = 1.4
WIDTH = 132
IMAGE = (
    *("psnr", "ssim", "ms_ssim", "cw_ssim", "iw_ssim", "dss", "vif", "vsi", "fsim", "sr_sim", "haarpsi"),
    *("gmsd", "ms_gmsd", "mdsi"),
)
CLOUD = ("sdm", "rmse", "mde", "mmde", "hd", "hd95")
SHOWN = ("psnr", "ssim", "iw_ssim", "vif", "fsim", "gmsd", "mdsi")
RECORDED = "as recorded"
SHOWN_AS = {"plain": "weather alone", "clear": "two clear frames"}
Row = dict[str, Any]


def of(rows: Sequence[Row], sensor: str, weather: str) -> list[Row]:
    return [row for row in rows if (row["sensor"], row["weather"]) == (sensor, weather)]


def mean(values: Sequence[float]) -> float:
    return sum(values) / len(values)


def simulated(rows: Sequence[Row], variant: str, name: str) -> float:
    return mean([row["simulated"][variant][name] for row in rows])


def measured(rows: Sequence[Row], name: str, source: str = "measured") -> float:
    return mean([row[source][name] for row in rows])


def ratio(name: str, one: float, real: float) -> float:
    """Simulated over measured; of PSNR the root mean square errors, measured over simulated."""
    return 10.0 ** ((one - real) / 20.0) if name == "psnr" else one / real


def number(value: float) -> str:
    """About three digits that count."""
    size = abs(value)
    digits = 1 if size >= 10 else 2 if size >= 1.05 else 3
    return f"{value:.{digits}f}" if size >= 0.01 else f"{value:.2g}"


def percent(share: float) -> str:
    """One decimal below 10 %, and never 0 of what is more."""
    value = 100 * share
    return f"{value:.0f} %" if value >= 10 else f"{value:.1f} %" if value >= 0.1 else f"{value:.1g} %"


def near(value: float) -> bool:
    return 1 / WITHIN <= value <= WITHIN


def count_near(rows: Sequence[Row], names: Sequence[str], at: Callable[[str], float]) -> int:
    return sum(near(ratio(name, at(name), measured(rows, name))) for name in names)


def title(name: str) -> str:
    return "PSNR, dB" if name == "psnr" else name.upper().replace("_", "-")


def scores(rows: Sequence[Row], names: Sequence[str]) -> str:
    """Measured, D3.4's model, simulated as recorded, and the ratios."""
    lines = []
    for name in names:
        real, theirs = measured(rows, name), measured(rows, name, "d34_model")
        ours, plain = (simulated(rows, variant, name) for variant in (RECORDED, "plain"))
        lines.append(
            [
                title(name),
                *map(number, (real, theirs, ours, plain)),
                *(number(ratio(name, one, real)) for one in (ours, theirs)),
            ]
        )
        if name == "vif":
            swapped = simulated(rows, RECORDED, "vif_swapped")
            lines.append(["VIF, arguments swapped", number(real), number(theirs), number(swapped), ""])
            lines[-1] += [number(ratio(name, swapped, real)), number(ratio(name, theirs, real))]
    heads = ["score", "measured", "D3.4's model", "simulated", "weather alone", "simulated / measured"]
    return table([*heads, "D3.4's model / measured"], lines)


def variants(rows: Sequence[Row], names: Sequence[str]) -> str:
    """Mean of a few scores in every variant, and how many of all are near the measured ones."""
    lines = [["**measured**", *(number(measured(rows, name)) for name in names), ""]]
    for variant in rows[0]["simulated"]:
        close = count_near(rows, IMAGE, lambda name, variant=variant: simulated(rows, variant, name))
        cells = [number(simulated(rows, variant, name)) for name in names]
        lines.append([SHOWN_AS.get(variant, variant), *cells, str(close)])
    return table(["variant", *map(title, names), f"of 14 within {WITHIN:g}"], lines)


def clouds_by_level(rows: Sequence[Row], name: str) -> str:
    """One cloud score in every variant, by the severity of the weather."""
    levels = sorted({row["severity"] for row in rows})
    by_level = {level: [row for row in rows if row["severity"] == level] for level in levels}
    real = measured(rows, name)
    lines = [["**measured**", *(number(measured(by_level[level], name)) for level in levels), number(real), ""]]
    for variant in rows[0]["simulated"]:
        whole = simulated(rows, variant, name)
        cells = [number(simulated(by_level[level], variant, name)) for level in levels]
        lines.append([SHOWN_AS.get(variant, variant), *cells, number(whole), percent(whole / real)])
    unit = "mm/h" if rows[0]["weather"] == "rain" else "m"
    heads = [f"{abs(level):g} {unit}" for level in levels]
    return table(["variant", *heads, "all", "of the measured"], lines)


def heaviest_over_lightest(rows: Sequence[Row], names: Sequence[str]) -> str:
    """Change of each score from the lightest to the heaviest rain, of the targets that have both."""
    levels = sorted({row["severity"] for row in rows})
    both = {row["target"] for row in rows if row["severity"] == levels[-1]}
    ends = [
        [row for row in rows if row["severity"] == level and row["target"] in both]
        for level in levels[:: len(levels) - 1]
    ]
    ends[0] = [row for row in ends[0] if row["distance_m"] in {one["distance_m"] for one in ends[1]}]
    lines = []
    for name in names:
        cells = [measured(one, name) for one in ends] + [simulated(one, RECORDED, name) for one in ends]
        lines.append([title(name), *map(number, cells)])
    low, high = (f"{level:g} mm/h" for level in (levels[0], levels[-1]))
    return table(["score", f"measured, {low}", f"measured, {high}", f"simulated, {low}", f"simulated, {high}"], lines)


def of_radar(rain: Sequence[Row], fog: Sequence[Row]) -> str:
    """Scores of the radar in every variant, measured above simulated."""
    lines = []
    for weather, rows in (("rain", rain), ("fog", fog)):
        lines.append([weather, "**measured**", "", *(number(measured(rows, name)) for name in CLOUD)])
        for variant in rows[0]["simulated"]:
            cells = [number(simulated(rows, variant, name)) for name in ("detections", *CLOUD)]
            lines.append([weather, SHOWN_AS.get(variant, variant), *cells])
    return table(["weather", "variant", "detections", *map(title, CLOUD)], lines)


def page(found: dict[str, Any]) -> str:
    rows = found["rows"]
    camera_fog, camera_rain = of(rows, "camera", "fog"), of(rows, "camera", "rain")
    lidar_fog, lidar_rain = of(rows, "lidar", "fog"), of(rows, "lidar", "rain")
    values = {
        "within": f"{WITHIN:g}",
        "near_fog": count_near(camera_fog, IMAGE, lambda name: simulated(camera_fog, RECORDED, name)),
        "near_fog_d34": count_near(camera_fog, IMAGE, lambda name: measured(camera_fog, name, "d34_model")),
        "near_rain": count_near(camera_rain, IMAGE, lambda name: simulated(camera_rain, RECORDED, name)),
        "near_rain_d34": count_near(camera_rain, IMAGE, lambda name: measured(camera_rain, name, "d34_model")),
        "camera_fog": scores(camera_fog, IMAGE),
        "camera_rain": scores(camera_rain, IMAGE),
        "lidar_fog": scores(lidar_fog, CLOUD),
        "lidar_rain": scores(lidar_rain, CLOUD),
        "fog_variants": variants(camera_fog, SHOWN),
        "rain_variants": variants(camera_rain, SHOWN),
        "rain_levels": heaviest_over_lightest(camera_rain, SHOWN),
        "sdm_rain": clouds_by_level(lidar_rain, "sdm"),
        "sdm_fog": clouds_by_level(lidar_fog, "sdm"),
        "width": found["camera_px"][0],
        "height": found["camera_px"][1],
        "camera_seeds": len(found["seeds"]["camera"]),
        "lidar_seeds": len(found["seeds"]["lidar"]),
        "rows_fog": len(camera_fog),
        "rows_rain": len(camera_rain),
    }
    sdm = {variant: simulated(lidar_rain, variant, "sdm") for variant in lidar_rain[0]["simulated"]}
    real = measured(lidar_rain, "sdm")
    values |= {f"sdm[{variant}]": number(value) for variant, value in sdm.items()}
    values |= {f"share[{variant}]": percent(value / real) for variant, value in sdm.items()}
    small = ("clear", "rain in the whole hall", "drops not at terminal speed", "masts of sprinklers")
    values["least_share"] = percent(max(sdm[variant] for variant in small) / real)
    values["sdm_real"] = number(real)
    fog_real, fog_ours = measured(lidar_fog, "sdm"), simulated(lidar_fog, RECORDED, "sdm")
    values |= {"fog_real": number(fog_real), "fog_ours": number(fog_ours), "fog_ratio": number(fog_ours / fog_real)}
    for name in ("ssim", "fsim", "psnr", "vif", "gmsd"):
        values[f"rain_{name}"] = number(measured(camera_rain, name))
        for variant in camera_rain[0]["simulated"]:
            values[f"rain_{name}[{variant}]"] = number(simulated(camera_rain, variant, name))
    for name in ("psnr", "vif", "mdsi", "cw_ssim"):
        values[f"fog_{name}_ratio"] = number(
            ratio(name, simulated(camera_fog, RECORDED, name), measured(camera_fog, name))
        )
        values[f"fog_{name}_plain"] = number(
            ratio(name, simulated(camera_fog, "plain", name), measured(camera_fog, name))
        )
    values["fog_vif_swapped"] = number(simulated(camera_fog, RECORDED, "vif_swapped") / measured(camera_fog, "vif"))
    levels = sorted({row["severity"] for row in lidar_rain})
    by_level = [[row for row in lidar_rain if row["severity"] == level] for level in levels]
    for key, level in zip(("light", "middle", "heavy"), by_level, strict=True):
        values[f"sdm_{key}"] = number(measured(level, "sdm"))
        values[f"together_{key}"] = percent(simulated(level, "all together", "sdm") / measured(level, "sdm"))
    values["light_of_middle"] = percent(measured(by_level[0], "sdm") / measured(by_level[1], "sdm"))
    for key, level in (("thin", max), ("thick", min)):
        of_fog = [abs(row["severity"]) for row in camera_fog]
        there = [row for row in camera_fog if abs(row["severity"]) == level(of_fog)]
        values[f"vif_{key}"] = number(measured(there, "vif"))
        values[f"vif_swapped_plain_{key}"] = number(simulated(there, "plain", "vif_swapped"))
        values[f"vif_swapped_{key}"] = number(simulated(there, RECORDED, "vif_swapped"))
    for name in ("ssim", "haarpsi", "dss", "gmsd"):
        values[f"fog_ratio_{name}"] = number(simulated(camera_fog, RECORDED, name) / measured(camera_fog, name))
    fog_sdm = {variant: simulated(lidar_fog, variant, "sdm") / fog_real for variant in lidar_fog[0]["simulated"]}
    values |= {f"fog_share[{variant}]": percent(share) for variant, share in fog_sdm.items()}
    for name in ("psnr", "ssim", "vif"):
        values |= {f"fog_{name}": number(measured(camera_fog, name))}
        values |= {
            f"fog_{name}[{variant}]": number(simulated(camera_fog, variant, name))
            for variant in camera_fog[0]["simulated"]
        }
    radar_fog, radar_rain = of(rows, "radar", "fog"), of(rows, "radar", "rain")
    values["radar"] = of_radar(radar_rain, radar_fog)
    values["radar_clear"] = number(simulated(radar_rain, "clear", "detections"))
    values["radar_rain"] = f"{simulated(radar_rain, RECORDED, 'detections'):.0f}"
    values["radar_rain_sdm"] = number(simulated(radar_rain, RECORDED, "sdm"))
    values["radar_clear_sdm"] = number(simulated(radar_rain, "clear", "sdm"))
    farthest = max(row["measured"]["hd"] for row in lidar_rain)
    values["hd_real"] = number(farthest)
    values["hd_ours"] = number(max(row["simulated"][v]["hd"] for row in lidar_rain for v in row["simulated"]))
    text = (HERE / "d34_page.md").read_text(encoding="utf-8")
    for name, value in values.items():
        text = text.replace("{" + name + "}", str(value))
    if "{" in text:
        raise ValueError(f"d34_page.md: no value for {text[text.index('{') :][:40]!r}")
    return wrapped(text)


def wrapped(text: str) -> str:
    """Paragraphs and list items filled to the width; tables and headings as they are."""
    blocks = []
    for block in text.strip().split("\n\n"):
        if block.startswith(("|", "#")):
            blocks.append(block)
            continue
        items = re.split(r"\n(?=- )", block)
        indent = ["  " if item.startswith("- ") else "" for item in items]
        filled = [
            textwrap.fill(
                " ".join(item.split()), WIDTH, subsequent_indent=space, break_long_words=False, break_on_hyphens=False
            )
            for item, space in zip(items, indent, strict=True)
        ]
        blocks.append("\n".join(filled))
    return "\n\n".join(blocks) + "\n"


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--check", action="store_true", help="compare, write nothing")
    args = parser.parse_args()
    text = page(json.loads((HERE / "d34_scores.json").read_text(encoding="utf-8")))
    if args.check:
        return int(not PAGE.is_file() or PAGE.read_text(encoding="utf-8") != text)
    PAGE.write_text(text, encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
