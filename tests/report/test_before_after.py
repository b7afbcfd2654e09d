"""The page with a slider: whole in itself, pictures as they were, bounded; photographs in weathers on it."""

from __future__ import annotations

import base64
import io
import json
import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from PIL import Image
from torch import Tensor

from tests.recordings import recording
from tests.report.parsed_page import Page
from torchweather.atmosphere.weather import Fog, Snow
from torchweather.camera.depth import ConstantDepth, DepthMap
from torchweather.core.errors import TorchweatherError
from torchweather.image import quantise
from torchweather.io import read_image
from torchweather.report import photo_demo
from torchweather.report.before_after import (
    LONGEST_PX,
    Comparison,
    comparisons_page,
    panel_caption,
    reduced,
    write_before_after,
)
from torchweather.report.page import html_of
from torchweather.report.photo_demo import SEVERITIES, Photo, write_photo_demo
from torchweather.sensors import Camera

FEW = (("fog-50", "Fog 50 m", Fog(mor_m=50.0)), ("snow-1", "Snow 1 mm/h", Snow(rate_mm_per_h=1.0)))


def picture(height: int = 48, width: int = 64, level: float = 0.3) -> Tensor:
    random = torch.Generator().manual_seed(8)
    coarse = torch.rand(3, 6, 8, generator=random) * level
    smooth = torch.nn.functional.interpolate(coarse[None], (height, width), mode="bilinear")[0]
    return quantise(smooth + 0.2, torch.uint8)


def decoded(uri: str) -> Tensor:
    kind, content = uri.removeprefix("data:").split(";base64,")
    assert kind in ("image/png", "image/jpeg")
    pixels = np.asarray(Image.open(io.BytesIO(base64.b64decode(content))))
    return torch.from_numpy(pixels.copy()).movedim(-1, 0)


def pictures_of(page: Page) -> list[Tensor]:
    """Weathers first, then the clear one."""
    return [decoded(str(image["src"])) for image in page.all("img")]


def assert_self_contained(page: Page, text: str) -> None:
    assert not page.mistakes
    assert all(str(image["src"]).startswith("data:image/") for image in page.all("img"))
    assert [link["href"] for link in page.all("link")] == ["data:,"]
    assert all("src" not in script for script in page.all("script"))
    assert not re.search(r"https?://", text)


def test_the_page_carries_its_pictures_captions_and_a_slider(tmp_path: Path) -> None:
    clear, foggy, snowy = picture(), picture(level=0.2), picture(level=0.6)
    panels = [("fog 200 m", "Depth completed. Seed 7.", foggy), ("snow 1 mm/h", "Depth exact.", snowy)]
    write_before_after(tmp_path / "a.html", clear, panels, title="street.png", notes=["Airlight was guessed."])
    text = (tmp_path / "a.html").read_text(encoding="utf-8")
    page = Page(text)
    assert_self_contained(page, text)
    for shown, wanted in zip(pictures_of(page), (foggy, snowy, clear), strict=True):
        assert torch.equal(shown, wanted)  # small pictures are PNG
    for said in ("fog 200 m", "Depth completed. Seed 7.", "Depth exact.", "Airlight was guessed.", "64 × 48 px"):
        assert said in page.words
    (slider,) = page.all("input")
    assert (slider["type"], slider["min"], slider["max"]) == ("range", "0", "100")
    assert slider["aria-label"]
    tabs = [button for button in page.all("button") if button.get("role") == "tab"]
    assert [tab["aria-selected"] for tab in tabs] == ["true", "false"]
    ids = {attrs["id"] for _, attrs in page.elements if "id" in attrs}
    assert {tab["aria-controls"] for tab in tabs} <= ids
    assert [path.name for path in tmp_path.iterdir()] == ["a.html"]


@pytest.mark.parametrize(("height", "width"), [(900, 3300), (2000, 900)])
def test_large_pictures_are_reduced_and_the_page_says_so(height: int, width: int) -> None:
    clear = picture(height, width)
    page = Page(html_of(comparisons_page([Comparison("a.png", clear, [("fog 50 m", "Depth guessed.", clear)])])))
    for shown in pictures_of(page):
        assert max(shown.shape[-2:]) == LONGEST_PX
        assert shown.shape[-1] / shown.shape[-2] == pytest.approx(width / height, rel=0.002)
        assert float((shown.float().mean() - clear.float().mean()).abs()) < 1.0
    assert f"{LONGEST_PX} px at most" in page.words


def test_reducing_averages_light_and_not_its_code() -> None:
    stripes = torch.zeros(3, 4, 3200, dtype=torch.uint8)
    stripes[:, :, ::2] = 255
    # Half the light is code 188 in sRGB (IEC 61966-2-1), the mean of codes would be 128.
    assert int(reduced(stripes)[0, 0, 800]) == pytest.approx(188, abs=1)


def test_names_captions_and_notes_are_text_and_not_markup() -> None:
    evil = '<script>alert("1")</script>'
    comparison = Comparison(evil, picture(), [(evil, evil, picture())], [evil], evil)
    text = html_of(comparisons_page([comparison], lead=evil))
    page = Page(text)
    assert "<script>alert" not in text
    assert len(page.all("script")) == 1
    assert evil in page.words
    assert not page.mistakes


def test_a_caption_says_how_sure_the_picture_is() -> None:
    sure = panel_caption(Snow(1.0), seed=3, confidence="completed", airlight=(0.5, 0.6, 0.7), airlight_from="given")
    assert sure == "Snow of 1 mm/h. Depth completed. Airlight 0.50 0.60 0.70 of saturation (given). Seed 3."
    assert "Airlight" not in panel_caption(Snow(1.0), seed=3, confidence="exact")
    with pytest.raises(ValueError, match="exact, measured, completed, guessed"):
        panel_caption(Snow(1.0), seed=3, confidence="sure")


@pytest.mark.parametrize(
    ("clear", "panels", "error", "said"),
    [
        (picture(), [], ValueError, "panels"),
        (picture().float(), [("a", "b", picture())], TypeError, "uint8"),
        (picture(), [("a", "b", picture(48, 66))], ValueError, "one size"),
        (picture()[:1], [("a", "b", picture()[:1])], ValueError, "3, H, W"),
        (picture(), [("a", "b", None)], TypeError, "NoneType"),
    ],
)
def test_wrong_pictures_are_refused(
    tmp_path: Path, clear: Tensor, panels: Any, error: type[Exception], said: str
) -> None:
    with pytest.raises(error, match=said):
        write_before_after(tmp_path / "a.html", clear, panels)
    with pytest.raises(TorchweatherError, match="no folder"):
        write_before_after(tmp_path / "none" / "a.html", picture(), [("a", "b", picture())])
    assert not list(tmp_path.iterdir())


# ---- photographs ---------------------------------------------------------------------------------------------------


def camera(height: int = 48, width: int = 64) -> Camera:
    return Camera.from_intrinsics(0.8 * width, 0.8 * width, width / 2, height / 2, width, height)


def photo(tmp_path: Path, **more: Any) -> Photo:
    rgb = more.pop("rgb", picture())
    return Photo(tmp_path / "street.png", rgb, camera(*rgb.shape[-2:]), **more)


def test_photographs_come_with_page_pictures_and_summary(tmp_path: Path) -> None:
    out = tmp_path / "out"
    shown = photo(tmp_path, depth=ConstantDepth(30.0), notes=["No camera was given."])
    summary = write_photo_demo(out, [shown], seed=5, airlight=(0.6, 0.6, 0.6), severities=FEW, progress=False)
    assert json.loads((out / "summary.json").read_text(encoding="utf-8")) == summary
    text = (out / "index.html").read_text(encoding="utf-8")
    page = Page(text)
    assert_self_contained(page, text)
    (subject,) = summary["subjects"]
    assert (subject["depth"], summary["seed"]) == ("exact", 5)
    for record, on_page in zip(subject["weathers"], pictures_of(page), strict=False):
        written = read_image(out / record["file"])[0]
        assert torch.equal(written, on_page)
        assert not torch.equal(written, shown.rgb)
        assert record["airlight_from"] == "given"
    assert torch.equal(read_image(out / subject["clear_file"])[0], shown.rgb)
    for said in ("No camera was given.", "Depth exact.", "Seed 5.", "(given)"):
        assert said in page.words
    assert "Depth guessed" not in page.words


def test_a_photograph_without_depth_says_so_above_the_picture(tmp_path: Path) -> None:
    summary = write_photo_demo(tmp_path / "out", [photo(tmp_path)], severities=FEW[:1], progress=False)
    assert summary["subjects"][0]["depth"] == "guessed"
    words = Page((tmp_path / "out" / "index.html").read_text(encoding="utf-8")).words
    assert words.index("Depth guessed: no depth was given") < words.index("Fog 50 m")
    assert "Depth guessed." in words


def test_the_depth_of_a_reduced_photograph_stays_in_its_place(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(photo_demo, "LONGEST_PX", 64)
    monkeypatch.setattr(photo_demo, "reduced", lambda image: reduced(image, 64))
    depth_m = torch.full((1, 144, 192), 10.0)
    depth_m[..., :60, :] = torch.inf
    large = photo(tmp_path, rgb=picture(144, 192), depth=DepthMap(depth_m))
    clear, fitted, scene = photo_demo._prepared(large)
    assert clear.shape[-2:] == scene.depth_m.shape[-2:] == (48, 64)
    assert (fitted.width, fitted.fx) == (64, pytest.approx(large.camera.fx / 3))
    assert torch.isinf(scene.depth_m[:, :20]).all()
    assert (scene.depth_m[:, 20:] == 10.0).all()
    write_photo_demo(tmp_path / "out", [large], severities=FEW[:1], progress=False)
    words = Page((tmp_path / "out" / "index.html").read_text(encoding="utf-8")).words
    assert "192 × 144 px was reduced to 64 × 48 px" in words


def test_mistakes_about_photographs_leave_no_folder(tmp_path: Path) -> None:
    good = photo(tmp_path)
    for photos, said in (
        ([], "one photograph or more"),
        ([good] * 13, "12 photographs at most"),
        ([replace(good, rgb=picture()[:1])], "one RGB photograph"),
        ([replace(good, depth=DepthMap(torch.full((1, 9, 9), 5.0)))], "9"),
    ):
        with pytest.raises(ValueError, match=said):
            write_photo_demo(tmp_path / "out", photos, severities=FEW[:1], progress=False)
    assert not list(tmp_path.iterdir())


def test_severities_are_clear_to_a_reader() -> None:
    names, titles, weathers = zip(*SEVERITIES, strict=True)
    assert len(set(names)) == len(set(titles)) == len(SEVERITIES) == 9
    assert {weather.kind for weather in weathers} == {"fog", "rain", "snow"}


@pytest.mark.real_data
def test_a_real_photograph_has_a_page(tmp_path: Path) -> None:
    file = recording("kitti_13/image_2/000008.png")
    rgb = read_image(file)[0]
    height, width = rgb.shape[-2:]
    shown = Photo(file, rgb, Camera.from_intrinsics(721.5, 721.5, 609.6, 172.9, width, height), ConstantDepth(25.0))
    write_photo_demo(tmp_path / "out", [shown], severities=FEW[:1], progress=False)
    text = (tmp_path / "out" / "index.html").read_text(encoding="utf-8")
    page = Page(text)
    assert_self_contained(page, text)
    assert len(text) < 1_500_000
    foggy, clear = pictures_of(page)
    assert foggy.shape == clear.shape == rgb.shape
    # JPEG at quality 90 of a noisy frame; the fog of 50 m at 25 m is far outside it.
    assert float((clear.float() - rgb.float()).abs().mean()) < 6
    assert float((foggy.float() - rgb.float()).abs().mean()) > 30
