"""``torchweather apply`` on drives and videos: particles move, one airlight, bounded memory, resumed runs."""

from __future__ import annotations

import itertools
import json
import math
import weakref
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from torch import Tensor

from torchweather.atmosphere.weather import Snow
from torchweather.camera.depth import SceneDepth
from torchweather.cli import sequence_frames
from torchweather.cli.sequence_frames import MANIFEST
from torchweather.io import read_image, write_image
from torchweather.sensors import Camera
from torchweather.stages import ParticleVeil
from torchweather.transforms import AsBayer, BayerSnow, BayerWeather

HEIGHT, WIDTH, FOCAL_PX = 24, 32, 40.0
CAMERA = ("--fx", FOCAL_PX, "--cx", 15.5, "--cy", 11.5, "--exposure-s", 0.004)


COMMAND, AS_TYPED = ("apply",), True


def drive(folder: Path, count: int = 6, height: int = HEIGHT, width: int = WIDTH) -> Path:
    """Frames of a street: sky above, ground below, both with some texture."""
    folder.mkdir(parents=True)
    generator = torch.Generator().manual_seed(1)
    for number in range(count):
        image = 60 + 20 * torch.rand(3, height, width, generator=generator)
        image[:, : height // 2] += 140
        write_image(folder / f"{number:010d}.png", image.to(torch.uint8))
    return folder


def files(folder: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in sorted(folder.iterdir()) if path.suffix == ".png"}


SNOW = ("--weather", "snow:rate=5", *CAMERA, "--depth", 30, "--airlight", 0.7, 0.7, 0.7)
SEQUENCE = ("--sequence", "--frame-rate-hz", 10, "--ego-speed-m-per-s", 14)


# ---- particles -----------------------------------------------------------------------------------------------------


@pytest.fixture
def noises(monkeypatch: pytest.MonkeyPatch) -> list[dict[str, Tensor]]:
    """The noise that the command gives to each frame."""
    seen: list[dict[str, Tensor]] = []
    forward = AsBayer.forward

    def spying(self: AsBayer, rgb: Tensor, depth: Any = None, noise: Mapping[str, Tensor] | None = None) -> Tensor:
        seen.append({} if noise is None else dict(noise))
        return forward(self, rgb, depth, noise)

    monkeypatch.setattr(AsBayer, "forward", spying)
    return seen


def positions(noise: Mapping[str, Tensor], ego_speed_m_per_s: float) -> list[Tensor]:
    """Of each shell, the particles' ``(N, 3)`` x, y, z in metres in the camera's frame; NaN for empty slots."""
    camera = Camera.preset("lucid-triton", exposure_s=0.004)
    lens = {"width": WIDTH, "height": HEIGHT, "fx": FOCAL_PX, "fy": FOCAL_PX, "cx": 15.5, "cy": 11.5}
    camera = Camera.from_dict({**camera.to_dict(), **lens})
    veil = BayerSnow(Snow(5.0), camera, ego_speed_m_per_s=ego_speed_m_per_s).chain.stages["particle_veil"]
    assert isinstance(veil, ParticleVeil)
    population = veil.parts[0]
    places = []
    for number, shell in enumerate(population.tables.listed):
        points = noise[f"particle_veil.snow_shell_{number}"].double()
        reach_u, reach_v = population.reach_px(number)
        foot = np.exp(np.interp(points[:, 2], np.linspace(0, 1, len(shell.log_footprint)), shell.log_footprint))
        z = torch.from_numpy(foot) * FOCAL_PX
        u = points[:, 0] * (WIDTH + 2 * reach_u) - (reach_u + 0.5)
        v = points[:, 1] * (HEIGHT + 2 * reach_v) - (reach_v + 0.5)
        place = torch.stack([(u - 15.5) / FOCAL_PX * z, (v - 11.5) / FOCAL_PX * z, z], 1)
        place[points[:, 3] > 1] = math.nan
        places.append(place)
    return places


@pytest.mark.parametrize(("speed", "interval_s"), [(14.0, 0.1), (0.0, 0.1), (5.0, 0.04)])
def test_the_same_particles_move_from_frame_to_frame(
    run: Any, tmp_path: Path, noises: list[dict[str, Tensor]], speed: float, interval_s: float
) -> None:
    frames = drive(tmp_path / "frames", 4)
    motion = ("--sequence", "--frame-rate-hz", 1 / interval_s, "--ego-speed-m-per-s", speed)
    code, _, err = run(frames, *SNOW, *motion, "--out", tmp_path / "out", "--seed", 3)
    assert code == 0, err
    assert len(noises) == 4
    stayed = 0
    for before, after in itertools.pairwise(noises):
        for first, second in zip(positions(before, speed), positions(after, speed), strict=True):
            there = first[:, 2] > 4 * speed * interval_s  # false for NaN
            step = (second - first)[there]
            # Flakes stand still sideways, fall at 0.3 to 3 m/s, and come nearer as fast as the vehicle drives.
            along = (step[:, 2] + speed * interval_s).abs() < 0.01
            aside = step[:, 0].abs() < 0.01
            falls = (step[:, 1] > 0.3 * interval_s) & (step[:, 1] < 3 * interval_s)
            stays = int((along & aside & falls).sum())
            # The view narrows by up to a quarter each way, so 9/16 of them stay in it, less those that fall out below
            # or leave the octave of depth.
            assert stays >= 0.4 * len(step) - 3 * math.sqrt(0.24 * len(step)) or len(step) < 20
            stayed += stays
    assert stayed > 100


def test_the_first_frame_is_the_single_frames_draw(run: Any, tmp_path: Path, noises: list[dict[str, Tensor]]) -> None:
    frames = drive(tmp_path / "frames", 2)
    assert run(frames, *SNOW, *SEQUENCE, "--out", tmp_path / "out", "--seed", 3)[0] == 0
    one = (sorted(frames.iterdir())[0], *SNOW, "--ego-speed-m-per-s", 14, "--seed-rule", "added")
    assert run(*one, "--out", tmp_path / "one", "--seed", 3)[0] == 0
    assert (tmp_path / "one" / "0000000000.png").read_bytes() == files(tmp_path / "out")["0000000000.png"]


# ---- light and depth -----------------------------------------------------------------------------------------------


def test_one_airlight_serves_the_whole_drive(run: Any, tmp_path: Path) -> None:
    # The sky flickers between two greys whose light airlight follows frame by frame; the ground vanishes in fog.
    frames = tmp_path / "frames"
    frames.mkdir()
    depth = torch.full((HEIGHT, WIDTH), 150.0)
    depth[:10] = torch.inf
    np.save(tmp_path / "depth.npy", depth.numpy())
    for number in range(6):
        image = torch.full((3, HEIGHT, WIDTH), 60, dtype=torch.uint8)
        image[:, :10] = 190 if number % 2 else 212
        write_image(frames / f"{number}.png", image)
    fog = (frames, "--weather", "fog:mor=20", *CAMERA, "--depth", tmp_path / "depth.npy")
    assert run(*fog, *SEQUENCE, "--out", tmp_path / "out", "--json")[0] == 0
    ground = [read_image(path)[0][:, 12:].float().mean() for path in sorted((tmp_path / "out").glob("*.png"))]
    assert float(torch.stack(ground).std()) == 0.0
    assert run(*fog, "--ego-speed-m-per-s", 14, "--out", tmp_path / "single")[0] == 0
    single = [read_image(path)[0][:, 12:].float().mean() for path in sorted((tmp_path / "single").glob("*.png"))]
    assert float(torch.stack(single).std()) > 5.0  # what a drive would flicker by


def test_without_depth_it_is_guessed_and_says_so(run: Any, tmp_path: Path) -> None:
    frames = drive(tmp_path / "frames", 3, 48, 64)
    lens = ("--fx", 80, "--cx", 31.5, "--cy", 23.5)
    command = (frames, "--weather", "fog:mor=100", *lens, *SEQUENCE, "--out", tmp_path / "out")
    code, out, err = run(*command, "--json")
    assert code == 0, err
    (entry,) = json.loads(out)["files"]
    assert entry["depth_confidence"] == "guessed"
    assert any("depth is guessed" in text for text in entry["notes"])
    assert "depth is guessed" in err
    head = json.loads((tmp_path / "out" / MANIFEST).read_text().splitlines()[0])
    assert head["found"]["depth_confidence"] == "guessed"
    assert head["found"]["airlight"] == entry["airlight"]


def test_scenes_are_made_steady(run: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    rows: list[float | None] = []
    forward = AsBayer.forward

    def spying(self: AsBayer, rgb: Tensor, depth: Any = None, noise: Any = None) -> Tensor:
        rows.append(depth.horizon_row)
        return forward(self, rgb, depth, noise)

    def jittering(*_: Any, image: Tensor, **__: Any) -> SceneDepth:
        jitter = float(image.sum() % 2)
        return SceneDepth(torch.full((1, HEIGHT, WIDTH), 30.0), "guessed", horizon_row=10.0 + jitter)

    monkeypatch.setattr(AsBayer, "forward", spying)
    monkeypatch.setattr("torchweather.cli.sequence_work.scene_of", jittering)
    frames = tmp_path / "frames"
    frames.mkdir()
    for number in range(9):
        image = torch.full((3, HEIGHT, WIDTH), 90, dtype=torch.uint8)
        image[0, 0, 0] += number % 2
        write_image(frames / f"{number}.png", image)
    assert run(frames, *SNOW, *SEQUENCE, "--out", tmp_path / "out")[0] == 0
    inner = [row for row in rows[2:-2] if row is not None]
    assert len(inner) == 5
    assert max(inner) - min(inner) < 0.15  # 1 pixel of jitter


def test_each_frame_has_its_own_depth_map(run: Any, tmp_path: Path) -> None:
    frames = tmp_path / "frames"
    (tmp_path / "depth").mkdir()
    frames.mkdir()
    for number, depth_m in enumerate((1.0, 50.0, 1000.0)):
        write_image(frames / f"{number}.png", torch.zeros(3, HEIGHT, WIDTH, dtype=torch.uint8))
        np.save(tmp_path / "depth" / f"{number}.npy", np.full((HEIGHT, WIDTH), depth_m, np.float32))
    fog = ("--weather", "fog:mor=100", "--airlight", 0.7, 0.7, 0.7, *CAMERA, "--depth", tmp_path / "depth")
    assert run(frames, *fog, *SEQUENCE, "--out", tmp_path / "out")[0] == 0
    near, middle, far = (float(read_image(tmp_path / "out" / f"{k}.png")[0].float().mean()) for k in range(3))
    assert near < 100 < middle < 210 < far  # linear 0.02, 0.54 and 0.70 of saturation: 41, 193 and 218 levels


def test_further_arguments_of_depth_are_heard(run: Any, tmp_path: Path) -> None:
    frames = drive(tmp_path / "frames", 2)
    np.save(tmp_path / "depth.npy", np.full((HEIGHT, WIDTH), 40.0, np.float32))
    fog = ("--weather", "fog:mor=50", "--airlight", 0.7, 0.7, 0.7, *CAMERA, "--depth", tmp_path / "depth.npy")
    for name, along in (("axis", ()), ("ray", ("--depth-along", "ray"))):
        assert run(frames, *fog, *SEQUENCE, *along, "--out", tmp_path / name)[0] == 0
    assert files(tmp_path / "axis") != files(tmp_path / "ray")
    # Other depth is another setting.
    code, out, _ = run(frames, *fog, *SEQUENCE, "--depth-along", "ray", "--out", tmp_path / "axis", "--json")
    assert code == 0
    assert json.loads(out)["files"][0]["frames_kept"] == 0
    code, _, err = run(frames, *fog, *SEQUENCE, "--depth-model-output", "depth", "--out", tmp_path / "none")
    assert code == 2
    assert "--depth-model-output belongs to --depth-model" in err


# ---- resumed, repeated ---------------------------------------------------------------------------------------------


def test_a_killed_run_goes_on_and_gives_the_same_bytes(
    run: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    frames = drive(tmp_path / "frames", 9)
    command = (frames, "--weather", "snow:rate=5+fog:mor=200", *CAMERA, *SEQUENCE, "--height-m", 1.5)
    assert run(*command, "--out", tmp_path / "whole")[0] == 0
    written = 0

    def killed(path: Path, image: Tensor, **options: Any) -> None:
        nonlocal written
        if written == 5:
            raise KeyboardInterrupt
        written += 1
        write_image(path, image, **options)

    with monkeypatch.context() as context:
        context.setattr(sequence_frames, "write_image", killed)
        assert run(*command, "--out", tmp_path / "out")[0] == 130
    assert len(files(tmp_path / "out")) == 5
    with (tmp_path / "out" / MANIFEST).open("a") as manifest:
        manifest.write('{"frame": 5, "file": "00000')  # a line that the kill has torn
    before = {path.name: path.stat().st_mtime_ns for path in (tmp_path / "out").glob("*.png")}
    code, out, err = run(*command, "--out", tmp_path / "out", "--json")
    assert code == 0, err
    assert json.loads(out)["files"][0]["frames_kept"] == 5
    assert files(tmp_path / "out") == files(tmp_path / "whole")
    after = {path.name: path.stat().st_mtime_ns for path in (tmp_path / "out").glob("*.png")}
    assert {name: after[name] for name in before} == before
    # A third time there is nothing to do.
    assert json.loads(run(*command, "--out", tmp_path / "out", "--json")[1])["files"][0]["frames_kept"] == 9


def test_only_what_still_holds_is_kept(run: Any, tmp_path: Path) -> None:
    frames, out = drive(tmp_path / "frames", 4), tmp_path / "out"
    command = (frames, *SNOW, *SEQUENCE, "--out", out, "--json")

    def kept(*more: object) -> int:
        code, printed, err = run(*command, *more)
        assert code == 0, err
        entry: dict[str, int] = json.loads(printed)["files"][0]
        return entry["frames_kept"]

    assert kept() == 0
    whole = files(out)
    (out / "0000000001.png").write_bytes(b"changed")
    (out / "0000000002.png").unlink()
    assert kept() == 2
    assert files(out) == whole
    assert kept("--seed", 1) == 0
    assert files(out) != whole
    assert kept("--seed", 1) == 4
    assert kept("--seed", 1, "--ego-speed-m-per-s", 15) == 0
    write_image(frames / "0000000003.png", torch.zeros(3, HEIGHT, WIDTH, dtype=torch.uint8))
    assert kept("--seed", 1, "--ego-speed-m-per-s", 15) == 0


def test_the_same_seed_gives_the_same_drive(run: Any, tmp_path: Path) -> None:
    frames = drive(tmp_path / "frames", 3)
    for name, seed in (("a", 5), ("b", 5), ("c", 6)):
        assert run(frames, *SNOW, *SEQUENCE, "--seed", seed, "--out", tmp_path / name)[0] == 0
    assert files(tmp_path / "a") == files(tmp_path / "b")
    assert files(tmp_path / "a") != files(tmp_path / "c")


def test_memory_does_not_grow_with_the_drive(run: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    frames = drive(tmp_path / "frames", 30)
    held: list[weakref.ref[Tensor]] = []
    most = 0

    def counting(path: Path) -> Any:
        nonlocal most
        image, info = read_image(path)
        held.append(weakref.ref(image))
        most = max(most, sum(one() is not None for one in held))
        return image, info

    monkeypatch.setattr(sequence_frames, "read_image", counting)
    assert run(frames, *SNOW, *SEQUENCE, "--out", tmp_path / "out")[0] == 0
    assert len(held) >= 30
    assert most <= 8  # 7 of the survey, or 2 * 2 + 1 of the window, and the one that is read


# ---- speeds and rates ----------------------------------------------------------------------------------------------


def test_each_frame_has_the_speed_of_the_file(run: Any, tmp_path: Path, noises: list[dict[str, Tensor]]) -> None:
    frames = drive(tmp_path / "frames", 4)
    (tmp_path / "speeds.txt").write_text("4\n4\n8\n14\n")
    motion = ("--sequence", "--frame-rate-hz", 10, "--ego-speed-m-per-s", tmp_path / "speeds.txt")
    code, out, err = run(frames, *SNOW, *motion, "--out", tmp_path / "out", "--json")
    assert code == 0, err
    assert json.loads(out)["files"][0]["ego_speed_m_per_s"] == pytest.approx(7.5)
    assert "speeds of 4.0 to 14.0 m/s" in err
    for speed, (before, after) in zip((4.0, 6.0, 11.0), itertools.pairwise(noises), strict=True):
        nearer = []
        for first, second in zip(positions(before, 14.0), positions(after, 14.0), strict=True):
            nearer.append(((second - first)[:, 2] + speed * 0.1)[first[:, 2] > 4])
        together = torch.cat(nearer)
        assert int((together.abs() < 0.01).sum()) > 0.4 * len(together)


def test_a_file_of_one_speed_is_that_speed(run: Any, tmp_path: Path) -> None:
    frames = drive(tmp_path / "frames", 3)
    (tmp_path / "speeds.txt").write_text("14\n14\n14\n")
    for name, speed in (("file", tmp_path / "speeds.txt"), ("number", 14)):
        motion = ("--sequence", "--frame-rate-hz", 10, "--ego-speed-m-per-s", speed)
        assert run(frames, *SNOW, *motion, "--out", tmp_path / name)[0] == 0
    assert files(tmp_path / "file") == files(tmp_path / "number")


def test_raw_kitti_data_gives_rate_and_speed(run: Any, tmp_path: Path) -> None:
    frames = drive(tmp_path / "image_02" / "data", 3)
    (tmp_path / "oxts" / "data").mkdir(parents=True)
    stamps = "".join(f"2011-09-26 13:02:{25 + number * 0.125:.9f}\n" for number in range(3))
    for number in range(3):
        values = ["0"] * 8 + ["9.0"] + ["0"] * 21
        (tmp_path / "oxts" / "data" / f"{number:010d}.txt").write_text(" ".join(values))
    for folder in ("image_02", "oxts"):
        (tmp_path / folder / "timestamps.txt").write_text(stamps)
    code, out, err = run(
        frames, *SNOW, "--sequence", "--ego-speed-m-per-s", tmp_path / "oxts", "--out", tmp_path / "out", "--json"
    )
    assert code == 0, err
    (entry,) = json.loads(out)["files"]
    assert entry["frame_rate_hz"] == pytest.approx(8.0)
    assert entry["ego_speed_m_per_s"] == pytest.approx(9.0)


def test_raw_mosaics_of_a_drive_stay_raw(run: Any, tmp_path: Path) -> None:
    frames = tmp_path / "frames"
    frames.mkdir()
    for number in range(3):
        values = 300 + 2000 * torch.rand(1, HEIGHT, WIDTH, generator=torch.Generator().manual_seed(number))
        write_image(frames / f"{number}.png", values.to(torch.int32).to(torch.uint16))
    assert run(frames, *SNOW, *SEQUENCE, "--out", tmp_path / "out")[0] == 0
    after, info = read_image(tmp_path / "out" / "2.png")
    assert info.kind == "mosaic"
    assert after.dtype == torch.uint16
    code, _, err = run(frames, *SNOW, *SEQUENCE, "--out", tmp_path / "out.mp4")
    assert code == 2
    assert "raw mosaics do not go into a video" in err


@pytest.mark.parametrize(
    ("arguments", "complaint"),
    [
        (("frames", "--sequence", "--out", "out"), "needs --frame-rate-hz"),
        (("frames", "--frame-rate-hz", 10, "--out", "out"), "--frame-rate-hz is for a video or --sequence"),
        (("frames", "--ego-speed-m-per-s", "v.txt", "--out", "out"), "v.txt is a file of speeds"),
        (("scene:test-track", "--sensor", "radar", "--ego-speed-m-per-s", "v.txt", "--out", "o"), "a file of speeds"),
        (("frames", "--sensor", "lidar:hdl-64e", "--sequence", "--out", "out"), "--sequence is for a camera"),
        (("frames", "--out", "out.mp4"), "out.mp4 is a video; give --sequence"),
        (("frames", *SEQUENCE, "--out", "frames"), "would be overwritten"),
        (("frames", *SEQUENCE, "--out", "out.avi"), "must be a folder or end in .mp4"),
        (("frames", "--sequence", "--frame-rate-hz", 0, "--out", "out"), "--frame-rate-hz must be"),
        (("frames", "more", *SEQUENCE, "--out", "out"), "the same name"),
        (("a.mp4", "b.mp4", "--out", "out"), "one video at a time"),
        (("frames", *SEQUENCE, "--preview", "--out", "out"), "--preview is of single frames"),
        (("a.mp4", "--out", "out"), "a.mp4: no such file"),
        (("other", *SEQUENCE, "--out", "out"), "expected the sequence's size and kind"),
    ],
)
def test_mistakes_are_said_in_one_line(
    run: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, arguments: tuple[object, ...], complaint: str
) -> None:
    if "a.mp4" in arguments:
        pytest.importorskip("av", reason="PyAV is not installed: no videos here")
    monkeypatch.chdir(tmp_path)
    for name in ("frames", "more"):
        drive(tmp_path / name, 2)
    drive(tmp_path / "other", 2)
    write_image(tmp_path / "other" / "0000000001.png", torch.zeros(3, 10, 12, dtype=torch.uint8))
    code, _, err = run(*arguments, *(SNOW if "--sensor" not in arguments else SNOW[:2]))
    assert code == 2
    assert complaint in err.splitlines()[-1]
    assert not list(tmp_path.glob("**/.*"))


# ---- videos --------------------------------------------------------------------------------------------------------


def clip(path: Path, count: int = 5, height: int = HEIGHT, width: int = WIDTH) -> Path:
    pytest.importorskip("av", reason="PyAV is not installed: no videos here (pip install 'torchweather[video]')")
    from torchweather.io.video import write_video

    with write_video(path, height, width, 25) as video:
        for number in range(count):
            video.add(torch.full((3, height, width), 60 + 5 * number, dtype=torch.uint8))
    return path


def test_a_video_becomes_a_video(run: Any, tmp_path: Path) -> None:
    from torchweather.io.video import VideoReader

    source = clip(tmp_path / "clip.mp4")
    code, out, err = run(source, *SNOW, "--ego-speed-m-per-s", 14, "--out", tmp_path / "new" / "out.mp4")
    assert code == 0, err
    assert "5 frames at 25 Hz" in out
    before, after = VideoReader(source), VideoReader(tmp_path / "new" / "out.mp4")
    assert after.frame_rate_hz == before.frame_rate_hz
    times = [[float((frame.pts or 0) * video.time_base) for frame in video] for video in (before, after)]
    assert times[0] == pytest.approx(times[1])
    changes = [(b.rgb.float() - a.rgb.float()).abs().mean() for b, a in zip(before, after, strict=True)]
    assert min(changes) > 1.0  # it snows in every frame
    import av

    with av.open(str(tmp_path / "new" / "out.mp4")) as container:
        about = json.loads(container.metadata["comment"])
    assert about["settings"]["seed"] == 0
    assert about["found"]["depth_confidence"] == "exact"
    assert [path.name for path in (tmp_path / "new").iterdir()] == ["out.mp4"]


def test_a_video_becomes_frames_and_frames_a_video(run: Any, tmp_path: Path) -> None:
    source = clip(tmp_path / "clip.mp4", 4, 26, 34)
    assert run(source, *SNOW, "--ego-speed-m-per-s", 14, "--out", tmp_path / "out")[0] == 0
    assert list(files(tmp_path / "out")) == [f"{number:06d}.png" for number in range(4)]
    (tmp_path / "out" / "000002.png").unlink()
    again = (source, *SNOW, "--ego-speed-m-per-s", 14, "--out", tmp_path / "out", "--json")
    assert json.loads(run(*again)[1])["files"][0]["frames_kept"] == 3
    from torchweather.io.video import VideoReader

    frames = drive(tmp_path / "frames", 3, 25, 33)
    code, _, err = run(frames, *SNOW, *SEQUENCE, "--out", tmp_path / "out.mp4")
    assert code == 0, err
    assert "needs even sizes" in err
    video = VideoReader(tmp_path / "out.mp4")
    assert (len(list(video)), video.height, video.width, float(video.frame_rate_hz)) == (3, 26, 34, 10.0)


def test_a_video_that_is_interrupted_leaves_nothing(run: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    source = clip(tmp_path / "clip.mp4")
    calls = 0
    forward = BayerWeather.weathered

    def stops(self: BayerWeather, *arguments: Any) -> Any:
        nonlocal calls
        calls += 1
        if calls == 3:
            raise KeyboardInterrupt
        return forward(self, *arguments)

    monkeypatch.setattr(BayerWeather, "weathered", stops)
    assert run(source, *SNOW, "--out", tmp_path / "out.mp4")[0] == 130
    assert [path.name for path in tmp_path.iterdir()] == ["clip.mp4"]
