"""The README's picture of a detector's answer: boxes on one photograph, clear and in two fogs.

    python examples/real_detector.py --cache CACHE --check        # fetches and converts the detector
    python docs/_figures/readme_detector.py CACHE/nanodet_384x1248.onnx

The detector's declaration lies beside it, with the ending .yaml.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path

from PIL import Image, ImageDraw
from readme_street import GAP, IMAGES, PHOTOGRAPH, PICTURE_WIDTH, as_picture, labelled, street, weathered

import torchweather as tw
from torchweather.evaluation.robustness import OnnxDetector, read_declaration
from torchweather.image import normalise

SHOWN = 0.4  # least score of a box that is drawn
FOGS_M = (200.0, 60.0)
COLOURS = {"car": (255, 200, 60), "truck": (90, 200, 255), "person": (255, 110, 180)}


def main() -> None:
    """Draw the picture."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("model", type=Path, help="the detector's ONNX file")
    parser.add_argument("--out", type=Path, default=IMAGES / "readme_detector.jpg")
    arguments = parser.parse_args()
    detector = OnnxDetector(arguments.model, read_declaration(arguments.model.with_suffix(".yaml")))
    settings = json.loads(PHOTOGRAPH.with_suffix(".json").read_text(encoding="utf-8"))
    width = PICTURE_WIDTH // 2
    image, camera, scene = street(PHOTOGRAPH, settings, settings["panel"], width)
    panels = {"clear": image}
    for mor_m in FOGS_M:
        panels[f"fog of {mor_m:g} m visibility"] = weathered(tw.Fog(mor_m=mor_m), camera)(image, scene)
    height = image.shape[-2]
    sheet = Image.new("RGB", (width, len(panels) * (height + GAP) - GAP), "white")
    for number, (text, panel) in enumerate(panels.items()):
        found = detector.of_frame(None, normalise(panel))
        picture = as_picture(panel)
        draw = ImageDraw.Draw(picture)
        shown = 0
        for label, score, box in zip(found["labels"], found["scores"], found["boxes"], strict=True):
            if score >= SHOWN:
                shown += 1
                draw.rectangle([float(side) for side in box], outline=COLOURS.get(str(label), (255, 255, 255)), width=2)
        sheet.paste(labelled(picture, f"{text}: {shown} found"), (0, number * (height + GAP)))
    sheet.save(arguments.out, quality=88, optimize=True)
    print(f"wrote {arguments.out}")


if __name__ == "__main__":
    main()
