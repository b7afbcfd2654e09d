from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

import pytest
import torch

from tests.report.parsed_page import Page
from torchweather import report
from torchweather.core.errors import TorchweatherError
from torchweather.io import read_image, write_image
from torchweather.report import demo as demo_module
from torchweather.report.demo import SECTIONS, write_demo
from torchweather.report.demo_words import NAMES, WHY
from torchweather.report.tables import number_text
from torchweather.sensors import Camera

Demo = tuple[Path, dict[str, Any]]


@pytest.fixture(scope="module")
def demo(tmp_path_factory: pytest.TempPathFactory) -> Demo:
    folder = tmp_path_factory.mktemp("page") / "demo"
    camera = Camera.preset("lucid-triton").resized(96, 72)
    return folder, write_demo(folder, seed=5, camera=camera, radar="awr1843-like", progress=False)


@pytest.fixture(scope="module")
def page(demo: Demo) -> Page:
    return Page((demo[0] / "index.html").read_text(encoding="utf-8"))


def test_page_loads_nothing_from_outside(demo: Demo, page: Page) -> None:
    text = (demo[0] / "index.html").read_text(encoding="utf-8")
    loaded = [attrs.get("src") for _, attrs in page.elements if "src" in attrs]
    assert len(loaded) > 40
    assert all(src is not None and src.startswith("data:image/") for src in loaded)
    assert not page.all("script")
    assert not page.all("iframe")
    assert all(link["href"] == "data:," for link in page.all("link"))
    assert "@import" not in text
    assert "url(" not in text
    assert "http:" not in text
    assert "https:" not in text


def test_page_is_well_formed_and_its_links_lead_somewhere(demo: Demo, page: Page) -> None:
    assert page.mistakes == []
    assert len(page.all("h1")) == 1
    assert all(image.get("alt") for image in page.all("img"))
    ids = [attrs["id"] for _, attrs in page.elements if "id" in attrs]
    assert len(ids) == len(set(ids))
    for link in page.all("a"):
        target = link["href"] or ""
        assert target[1:] in ids if target.startswith("#") else (demo[0] / target).is_file(), target


def test_numbers_on_the_page_are_those_of_the_summary(demo: Demo, page: Page) -> None:
    folder, summary = demo
    assert json.loads((folder / "summary.json").read_text(encoding="utf-8")) == summary
    shown: dict[str, list[float]] = {}
    for cell in page.all("td"):
        if "data-key" in cell:
            shown.setdefault(str(cell["data-key"]), []).append(float(str(cell["data-value"])))
    weathers = [weather for subject in summary["subjects"] for weather in subject["weathers"]]
    for key, values in shown.items():
        columns = [{**weather["numbers"], **weather["times_s"]} for weather in weathers]
        assert values == [column[key] for column in columns if key in column], key
    wanted = {"extinction_green_per_m", "mor_m", "particles_per_m3", "liquid_water_g_per_m3", "optical_depth_28_m"}
    wanted |= {"transmission_56_m", "share_drawn_one_by_one", "mask_mean", "mask_mean_expected", "render_s"}
    assert wanted <= set(shown)


def test_a_number_reads_as_its_value(demo: Demo) -> None:
    text = (demo[0] / "index.html").read_text(encoding="utf-8")
    cells = re.findall(r'<td class="unit">([^<]*)</td>((?:<td data-key[^>]*>[^<]*</td>)+)', text)
    pairs = [(unit, *cell) for unit, row in cells for cell in re.findall(r'data-value="([^"]*)">([^<]*)<', row)]
    assert len(pairs) > 200
    for unit, value, written in pairs:
        assert written == number_text(float(value) * (100 if unit == "%" else 1))


def test_raw_frames_are_written_in_the_bits_of_the_camera(demo: Demo) -> None:
    folder, summary = demo
    files = [weather["file"] for subject in summary["subjects"] for weather in subject["weathers"]]
    assert len(files) == len(set(files)) == sum(len(s.weathers) for s in SECTIONS) + 4  # and fog in the tunnel
    for file in files:
        frame, info = read_image(folder / file)
        assert (frame.dtype, info.kind) == (torch.uint16, "mosaic")
        assert int(frame.to(torch.int32).max()) <= 4095


def test_more_weather_means_less_light(demo: Demo) -> None:
    track = demo[1]["subjects"][0]["weathers"]
    for kind, rising in (("rain", True), ("snow", True), ("fog", False)):
        arriving = [weather["numbers"]["transmission_28_m"] for weather in track if weather["kind"] == kind]
        assert arriving == sorted(arriving, reverse=rising)


def test_fog_at_its_visibility_leaves_five_percent(demo: Demo) -> None:
    for weather in demo[1]["subjects"][0]["weathers"]:
        if weather["kind"] == "fog":
            numbers = weather["numbers"]
            left = numbers["transmission_28_m"] ** (weather["weather"]["mor_m"] / 28.0)
            # MOR is defined at 550 nm, the number is for 530 nm: fog differs by less than 1 % there, in the exponent 3.
            assert left == pytest.approx(0.05, rel=0.03)


def test_mask_mean_is_the_expected_one(demo: Demo) -> None:
    for weather in demo[1]["subjects"][0]["weathers"]:
        numbers = weather["numbers"]
        if "mask_mean" in numbers:
            # 7000 pixels, of which those of the sky see 200 m of particles and scatter by some per cent each.
            assert numbers["mask_mean"] == pytest.approx(numbers["mask_mean_expected"], rel=0.02)


def test_users_frames_make_the_same_page_and_names_are_escaped(tmp_path: Path) -> None:
    hostile = tmp_path / "<script>alert('x')&amp;\".png"
    generator = torch.Generator().manual_seed(0)
    write_image(hostile, torch.randint(20, 200, (3, 33, 45), generator=generator, dtype=torch.uint8))
    camera = Camera.from_intrinsics(40.0, 40.0, 22.0, 16.0, 45, 33)
    summary = write_demo(tmp_path / "out", images=[hostile], depth=25.0, camera=camera, progress=False)
    text = (tmp_path / "out" / "index.html").read_text(encoding="utf-8")
    page = Page(text)
    assert summary["subjects"][0]["title"] == hostile.name
    assert "<script" not in text
    assert "&lt;script&gt;alert(&#39;x&#39;)&amp;amp;" in text
    assert page.mistakes == []
    assert any("25" not in note and "a grey of 0.6" in note for note in summary["subjects"][0]["notes"])  # no sky in it
    frame, _ = read_image(tmp_path / "out" / summary["subjects"][0]["weathers"][0]["file"])
    assert (frame.dtype, tuple(frame.shape)) == (torch.uint8, (3, 33, 45))
    assert sorted(p.name for p in tmp_path.iterdir()) == sorted([hostile.name, "out"])


def test_an_unreadable_image_leaves_the_old_page_as_it_was(tmp_path: Path) -> None:
    broken = tmp_path / "broken.png"
    broken.write_bytes(b"\x89PNG\r\n\x1a\nbut no more")
    out = tmp_path / "out"
    out.mkdir()
    (out / "index.html").write_text("old")
    with pytest.raises(TorchweatherError, match=r"broken\.png"):
        write_demo(out, images=[broken], depth=20.0, progress=False)
    assert [(p.name, p.read_text()) for p in out.iterdir()] == [("index.html", "old")]
    assert sorted(p.name for p in tmp_path.iterdir()) == ["broken.png", "out"]


@pytest.mark.usefixtures("undrawn")
def test_a_failure_half_way_leaves_no_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def stop(*_: object, **__: object) -> str:
        raise RuntimeError("disk on fire")

    monkeypatch.setattr(demo_module, "write_report", stop)
    monkeypatch.setattr(demo_module, "SECTIONS", SECTIONS[1:2])
    frame = tmp_path / "frame.png"
    write_image(frame, torch.full((1, 16, 24), 900, dtype=torch.uint16))
    with pytest.raises(RuntimeError, match="disk on fire"):
        write_demo(tmp_path / "a" / "b", images=[frame], progress=False)
    assert [p.name for p in tmp_path.iterdir()] == ["frame.png"]


def test_a_file_in_the_way_is_refused(tmp_path: Path) -> None:
    (tmp_path / "out").write_text("mine")
    with pytest.raises(TorchweatherError, match="expected a folder"):
        write_demo(tmp_path / "out", progress=False)
    assert (tmp_path / "out").read_text() == "mine"


def test_depths_must_fit_the_images(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="one for each of the 1 images"):
        write_demo(tmp_path / "out", images=[tmp_path / "x.png"], depth=[1.0, 2.0], progress=False)


def test_templates_are_part_of_the_package() -> None:
    folder = Path(next(iter(report.__path__))) / "templates"
    assert {"report.html", "page.css", "slider.html", "slider.js", "cloud_view.js"} <= {
        p.name for p in folder.iterdir()
    }
    assert {section.kind for section in SECTIONS} == set(WHY) == set(NAMES)
