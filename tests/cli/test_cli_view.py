"""``torchweather view`` and ``torchweather demo PHOTO``: a page whole or none, nothing opened unasked."""

from __future__ import annotations

import importlib.util
import json
import subprocess
import sys
import types
import webbrowser
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from torch import Tensor

from torchweather.atmosphere.weather import Fog
from torchweather.image import quantise
from torchweather.io import write_image, write_points
from torchweather.report import photo_demo
from torchweather.stages import PointKind

HDL = ("--sensor", "lidar:velodyne-hdl-64e", "--intensity-unit", "reflectivity")
SNOW = ("--weather", "snow:rate=2")


AS_TYPED = True  # seeds and records as users have them


@pytest.fixture
def opened(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    asked: list[str] = []
    monkeypatch.setattr(webbrowser, "open", asked.append)
    return asked


def cloud(rows: int = 400, columns: int = 4) -> Tensor:
    random = torch.Generator().manual_seed(3)
    way = torch.randn(rows, 3, generator=random) * torch.tensor([1.0, 1.0, 0.1])
    xyz = way / way.norm(dim=-1, keepdim=True) * (3 + 57 * torch.rand(rows, 1, generator=random))
    return torch.cat([xyz, torch.rand(rows, columns - 3, generator=random)], -1)


def rgb_image(height: int = 24, width: int = 32) -> Tensor:
    return quantise(torch.rand(3, height, width, generator=torch.Generator().manual_seed(6)) * 0.6, torch.uint8)


# ---- view ----------------------------------------------------------------------------------------------------------


def test_help_does_not_load_torch() -> None:
    body = "import sys\nfrom torchweather.cli import main\n"
    body += "try:\n    main(['view', '-h'])\nexcept SystemExit:\n    pass\n"
    check = "sys.exit(', '.join(n for n in ('torch', 'numpy', 'matplotlib', 'rerun') if n in sys.modules) or 0)"
    done = subprocess.run([sys.executable, "-c", body + check], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr


@pytest.mark.parametrize("name", ["a.bin", "a.pcd.bin", "a.pcd", "a.ply", "a.npz", "a.csv"])
def test_view_reads_what_apply_reads_and_counts_the_same(
    run: Any, opened: list[str], tmp_path: Path, name: str
) -> None:
    write_points(tmp_path / name, cloud(columns=4 if name == "a.bin" else 5))
    page = tmp_path / "pages" / "page.html"
    code, text, err = run("view", tmp_path / name, *SNOW, *HDL, "--seed", 7, "--out", page, "--json")
    assert code == 0, err
    found = json.loads(text)
    code, text, _ = run("apply", tmp_path / name, *SNOW, *HDL, "--seed", 7, "-o", tmp_path / "out", "--json")
    (entry,) = json.loads(text)["files"]
    for key in ("points", "objects", "particles", "lost"):
        assert found[key] == entry[key]
    assert found["particles"] > 0
    assert Path(found["page"]) == page
    assert page.stat().st_size == found["bytes"]
    assert opened == []


def test_view_says_what_was_guessed_on_the_page_and_on_standard_error(run: Any, tmp_path: Path) -> None:
    write_points(tmp_path / "a.bin", cloud())
    page = tmp_path / "page.html"
    code, out, err = run("view", tmp_path / "a.bin", *SNOW, "-o", page)
    assert code == 0
    assert out.startswith(f"wrote {page}  points 400: ")
    text = page.read_text(encoding="utf-8")
    for said in ("No --sensor was given", "No --intensity-unit was given", "The unit of intensity is probably wrong"):
        assert said in err
        assert said in text
    assert text.index("probably wrong") < text.index("<canvas")
    code, _, err = run("view", tmp_path / "a.bin", *SNOW, *HDL, "-o", page, "--quiet")
    assert (code, err) == (0, "")
    text = page.read_text(encoding="utf-8")
    assert "No --sensor was given" not in text
    assert "probably wrong" not in text


def test_view_takes_clouds_without_intensity_and_completes_scans(run: Any, tmp_path: Path) -> None:
    rows = "\n".join(",".join(f"{value:.3f}" for value in row) for row in cloud()[:, :3].tolist())
    (tmp_path / "a.csv").write_text(f"x,y,z\n{rows}\n")
    options = (*SNOW, "--sensor", "lidar:velodyne-hdl-64e", "--out", tmp_path / "page.html", "--json", "--quiet")
    code, text, err = run(
        "view", tmp_path / "a.csv", *options, "--intensity", "none", "--complete-scan", "--columns", 64
    )
    assert code == 0, err
    assert json.loads(text)["particles"] > 0
    assert "has no intensity" in (tmp_path / "page.html").read_text(encoding="utf-8")


def test_view_opens_the_page_when_asked(run: Any, opened: list[str], tmp_path: Path) -> None:
    write_points(tmp_path / "a.bin", cloud(50))
    assert run("view", tmp_path / "a.bin", *SNOW, *HDL, "-o", tmp_path / "page.html", "--open")[0] == 0
    assert opened == [(tmp_path / "page.html").as_uri()]


def test_a_file_name_with_markup_is_text(run: Any, tmp_path: Path) -> None:
    name = "<script>alert(1)<&.bin"
    write_points(tmp_path / name, cloud(50))
    assert run("view", tmp_path / name, *SNOW, *HDL, "-o", tmp_path / "page.html")[0] == 0
    text = (tmp_path / "page.html").read_text(encoding="utf-8")
    assert "<script>alert" not in text
    assert "&lt;script&gt;alert(1)&lt;&amp;.bin" in text


@pytest.mark.parametrize(
    ("argv", "said"),
    [
        (["{cloud}"], "the following arguments are required: --weather"),
        (["{cloud}", "--weather", "snow:rate=-1"], "mm/h"),
        (["{cloud}", *SNOW, "--sensor", "camera"], "--sensor must be lidar"),
        (["{cloud}", *SNOW, "--sensor", "lidar:velodine-hdl-64e"], "velodyne-hdl-64e"),
        (["{none}", *SNOW], "no such file"),
        (["{text}", *SNOW], "expected a point cloud"),
        (["{cut}", *SNOW], "cut.bin"),
        (["{here}", *SNOW], "is a folder"),
        (["{cloud}", *SNOW, "--frame", "1"], "has no frame 1"),
        (["{cloud}", *SNOW, "--frame", "-1"], "--frame must be 0 or more"),
        (["{cloud}", *SNOW, "-o", "{here}/page.bin"], "--out must be a page"),
        (["{cloud}", *SNOW, "--intensity-unit", "lumen"], "intensity_unit"),
    ],
)
def test_a_mistake_in_view_gives_one_line_exit_code_2_and_no_page(
    run: Any, capsys: pytest.CaptureFixture[str], tmp_path: Path, argv: list[str], said: str
) -> None:
    write_points(tmp_path / "cloud.bin", cloud(50))
    (tmp_path / "text.txt").write_text("no cloud")
    (tmp_path / "cut.bin").write_bytes((tmp_path / "cloud.bin").read_bytes()[:-3])
    places = {name: str(tmp_path / f"{name}.bin") for name in ("cloud", "none", "cut")}
    places |= {"text": str(tmp_path / "text.txt"), "here": str(tmp_path)}
    before = sorted(tmp_path.iterdir())
    given = [argument.format(**places) for argument in argv]
    if "-o" not in given:
        given += ["-o", str(tmp_path / "page.html")]
    try:
        code, _, err = run("view", *given)
    except SystemExit as end:  # argparse leaves where it does not understand
        code, err = end.code, capsys.readouterr().err
    assert code == 2
    assert said in err
    assert sorted(tmp_path.iterdir()) == before


# ---- rerun ---------------------------------------------------------------------------------------------------------


class FakeRerun(types.ModuleType):
    """Keeps what is logged to it."""

    def __init__(self) -> None:
        super().__init__("rerun")
        self.logged: dict[str, Any] = {}
        self.calls: list[tuple[str, Any]] = []
        self.Points3D = lambda positions, colors: (positions, colors)

    def init(self, name: str, spawn: bool) -> None:
        self.calls.append(("init", spawn))

    def save(self, path: Path) -> None:
        self.calls.append(("save", path))

    def log(self, name: str, points: Any, static: bool) -> None:
        self.logged[name] = points

    def disconnect(self) -> None:
        self.calls.append(("disconnect", None))


def test_rerun_gets_both_clouds_and_is_not_started_unasked(
    run: Any, opened: list[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    module = FakeRerun()
    monkeypatch.setitem(sys.modules, "rerun", module)
    write_points(tmp_path / "a.bin", cloud())
    options = ("view", tmp_path / "a.bin", *SNOW, *HDL, "-o", tmp_path / "page.html", "--rerun", "--json")
    found = json.loads(run(*options)[1])
    assert module.calls == [("init", False), ("save", tmp_path / "page.rrd"), ("disconnect", None)]
    assert found["rerun"] == str(tmp_path / "page.rrd")
    positions, colours = module.logged["weather"]
    assert len(module.logged["clear"][0]) == found["points"]
    assert len(positions) == len(colours) == found["objects"] + found["particles"] + found["lost"]
    orange = module.logged["weather"][1].count([255, 127, 42])
    assert orange == found["particles"]
    assert int(PointKind.PARTICLE) == 1  # the order of the colours
    assert json.loads(run(*options, "--open")[1])["rerun"] == "viewer"
    assert module.calls[3:] == [("init", True)]


def test_rerun_without_the_package_names_the_extra(run: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    write_points(tmp_path / "a.bin", cloud(50))
    for module in (None, types.ModuleType("rerun")):  # None: not installed; another package has the name rerun
        monkeypatch.setitem(sys.modules, "rerun", module)
        code, _, err = run("view", tmp_path / "a.bin", *SNOW, *HDL, "-o", tmp_path / "page.html", "--rerun")
        assert code == 2
        assert "torchweather[view]" in err
    assert not (tmp_path / "page.html").exists()


@pytest.mark.skipif(importlib.util.find_spec("rerun") is None, reason="rerun-sdk is not installed (extra view)")
def test_rerun_writes_a_file(run: Any, tmp_path: Path) -> None:
    write_points(tmp_path / "a.bin", cloud())
    code, _, err = run("view", tmp_path / "a.bin", *SNOW, *HDL, "-o", tmp_path / "page.html", "--rerun")
    assert code == 0, err
    assert (tmp_path / "page.rrd").stat().st_size > 400 * 12


# ---- demo PHOTO ----------------------------------------------------------------------------------------------------


@pytest.fixture
def one_severity(monkeypatch: pytest.MonkeyPatch) -> None:
    few = (("fog-50", "Fog 50 m", Fog(mor_m=50.0)),)
    monkeypatch.setitem(photo_demo.write_photo_demo.__kwdefaults__, "severities", few)


@pytest.mark.usefixtures("one_severity")
def test_demo_of_a_photograph_writes_pictures_and_a_page(run: Any, opened: list[str], tmp_path: Path) -> None:
    write_image(tmp_path / "street.png", rgb_image())
    out = tmp_path / "out"
    code, text, err = run("demo", tmp_path / "street.png", "--fx", 30, "--depth", 25, "--out", out, "--json")
    assert code == 0, err
    (subject,) = json.loads(text)["subjects"]
    assert subject["title"] == "street.png"
    assert subject["camera"]["fx"] == 30
    assert (out / subject["weathers"][0]["file"]).exists()
    assert sorted(path.name for path in out.iterdir()) == ["frames", "index.html", "summary.json"]
    assert opened == []
    page = (out / "index.html").read_text(encoding="utf-8")
    assert "Fog of 50 m visibility" in page
    assert "From the preset camera:lucid-triton: exposure" in page
    assert "Depth guessed" not in page


@pytest.mark.usefixtures("one_severity")
def test_demo_guesses_depth_and_says_so_and_opens_when_asked(run: Any, opened: list[str], tmp_path: Path) -> None:
    for name in ("a.png", "b.png"):
        write_image(tmp_path / name, rgb_image())
    code, out, err = run("demo", tmp_path / "a.png", tmp_path / "b.png", "--out", tmp_path / "out", "--open")
    assert code == 0, err
    page = tmp_path / "out" / "index.html"
    assert str(page) in out
    assert "preset" in err
    assert page.read_text(encoding="utf-8").count("Depth guessed: no depth was given") == 2
    assert opened == [page.as_uri()]


@pytest.mark.parametrize(
    ("argv", "said"),
    [
        (["{rgb}", "{raw}"], "Run demo once for each"),
        (["{rgb}", "--lidar", "ouster-os1-128"], "--lidar belongs to the embedded scene"),
        (["{rgb}", "--sensor", "lidar"], "must be a camera"),
        (["{rgb}", "--depth", "{none}"], "--depth"),
        (["{rgb}", "--depth", "{map}"], "25"),
        (["{cut}"], "truncated"),
        (["{none}"], "no such file"),
    ],
)
def test_a_mistake_in_demo_gives_one_line_exit_code_2_and_no_folder(
    run: Any, tmp_path: Path, argv: list[str], said: str
) -> None:
    write_image(tmp_path / "rgb.png", rgb_image())
    write_image(tmp_path / "raw.png", torch.full((1, 24, 32), 900, dtype=torch.int32).to(torch.uint16))
    np.save(tmp_path / "map.npy", np.full((25, 32), 9.0, dtype=np.float32))
    (tmp_path / "cut.png").write_bytes((tmp_path / "rgb.png").read_bytes()[:400])
    places = {name: str(tmp_path / f"{name}.png") for name in ("rgb", "raw", "cut", "none")}
    places["map"] = str(tmp_path / "map.npy")
    code, _, err = run("demo", *(argument.format(**places) for argument in argv), "--out", tmp_path / "out")
    assert code == 2
    assert said in err
    assert not (tmp_path / "out").exists()
