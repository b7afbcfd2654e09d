"""Videos: what is written comes back, one frame at a time, with its times and colours; other files are refused."""

from __future__ import annotations

import gc
import sys
import weakref
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from torch import Tensor

from torchweather.core.errors import TorchweatherError
from torchweather.io.video import VideoReader, write_video

av: Any = pytest.importorskip("av", reason="PyAV is not installed: no videos here (pip install 'torchweather[video]')")


def picture(number: int, height: int = 32, width: int = 48) -> Tensor:
    """A smooth picture, at most 2 levels from pixel to pixel, that differs from frame to frame."""
    down = torch.linspace(0, 60, height)[:, None].expand(height, width)
    across = torch.linspace(0, 60, width)[None].expand(height, width)
    return torch.stack([down + 20, across + 10 * number, 200 - down]).to(torch.uint8)


def write(path: Path, frames: list[Tensor], rate: Any = 10, **more: Any) -> Path:
    with write_video(path, *frames[0].shape[-2:], rate, **more) as video:
        for frame in frames:
            video.add(frame)
    return path


@pytest.mark.parametrize("suffix", [".mp4", ".mkv", ".mov"])
def test_a_written_video_comes_back(tmp_path: Path, suffix: str) -> None:
    frames = [picture(number) for number in range(7)]
    reader = VideoReader(write(tmp_path / f"clip{suffix}", frames, Fraction(30000, 1001)))
    assert (reader.height, reader.width, reader.has_audio) == (32, 48, False)
    assert float(reader.frame_rate_hz) == pytest.approx(30000 / 1001, rel=1e-3)
    back = [frame.rgb for frame in reader]
    assert len(back) == 7
    for before, after in zip(frames, back, strict=True):
        # Quantisation at crf 16, and colour at half the resolution: half a step between pixels, 1 level.
        assert (before.float() - after.float()).abs().mean() < 2.0


def test_flat_colours_keep_their_value(tmp_path: Path) -> None:
    # With the matrix of BT.601 for that of BT.709 pure green comes back 20 levels darker.
    colours = [(200, 40, 40), (40, 200, 40), (40, 40, 200), (128, 128, 128), (250, 250, 250), (5, 5, 5)]
    frames = [torch.tensor(colour, dtype=torch.uint8)[:, None, None].expand(3, 32, 48) for colour in colours]
    for before, after in zip(frames, VideoReader(write(tmp_path / "flat.mp4", frames)), strict=True):
        assert (before.float() - after.rgb.float()).abs().amax() <= 4.0
    with av.open(str(tmp_path / "flat.mp4")) as container:
        codec = container.streams.video[0].codec_context
        assert (codec.colorspace, codec.color_primaries, codec.color_trc, codec.color_range) == (1, 1, 1, 1)


@pytest.mark.parametrize(
    ("matrix", "height", "marked"), [(5, 48, False), (1, 720, False), (5, 720, True), (1, 48, True)]
)
def test_the_matrix_of_a_video_is_its_own(tmp_path: Path, matrix: int, height: int, marked: bool) -> None:
    # Luma and colour differences of (40, 200, 40), by the luma weights of BT.709 and BT.601; video range.
    red, green, blue = 40 / 255, 200 / 255, 40 / 255
    weight_r, weight_b = (0.2126, 0.0722) if matrix == 1 else (0.299, 0.114)
    luma = weight_r * red + (1 - weight_r - weight_b) * green + weight_b * blue
    values = [
        16 + 219 * luma,
        128 + 224 * 0.5 * (blue - luma) / (1 - weight_b),
        128 + 224 * 0.5 * (red - luma) / (1 - weight_r),
    ]
    source = av.VideoFrame(64, height, "yuv420p")
    for plane, value in zip(source.planes, values, strict=True):
        plane.update(np.full(plane.buffer_size, round(value), np.uint8).tobytes())
    with av.open(str(tmp_path / "clip.mkv"), "w") as container:
        stream = container.add_stream("ffv1", rate=10)
        stream.width, stream.height, stream.pix_fmt = 64, height, "yuv420p"
        if marked:
            stream.codec_context.colorspace = matrix
        container.mux(stream.encode(source))
        container.mux(stream.encode(None))
    (frame,) = list(VideoReader(tmp_path / "clip.mkv"))
    wanted = torch.tensor([40.0, 200.0, 40.0])[:, None, None]
    assert (frame.rgb.float() - wanted).abs().amax() <= 3.0  # the other matrix: 20 levels and more


def test_odd_sizes_gain_a_copy_of_the_last_row_and_column(tmp_path: Path) -> None:
    frame = picture(0, 33, 47)
    (back,) = [frame.rgb for frame in VideoReader(write(tmp_path / "odd.mp4", [frame]))]
    assert back.shape == (3, 34, 48)
    assert (back[:, :33, :47].float() - frame.float()).abs().mean() < 2.0
    assert (back[:, 33].float() - back[:, 32].float()).abs().mean() < 4.0


def test_presentation_times_are_kept(tmp_path: Path) -> None:
    times = [0, 40, 80, 200, 210]  # of a variable frame rate, in milliseconds
    with write_video(tmp_path / "vfr.mp4", 32, 48, 25, time_base=Fraction(1, 1000)) as video:
        for number, pts in enumerate(times):
            video.add(picture(number), pts)
    reader = VideoReader(tmp_path / "vfr.mp4")
    seconds = [float((frame.pts or 0) * reader.time_base) for frame in reader]
    assert seconds == pytest.approx([time / 1000 for time in times], abs=1e-4)


def test_the_video_has_its_name_only_when_it_is_complete(tmp_path: Path) -> None:
    target = tmp_path / "clip.mp4"
    target.write_bytes(b"what stood here")

    def interrupted() -> None:
        with write_video(target, 32, 48, 10) as video:
            video.add(picture(0))
            assert target.read_bytes() == b"what stood here"
            raise RuntimeError("stop")

    with pytest.raises(RuntimeError, match="stop"):
        interrupted()
    assert [path.name for path in tmp_path.iterdir()] == ["clip.mp4"]
    assert target.read_bytes() == b"what stood here"
    write(target, [picture(0)])
    assert [path.name for path in tmp_path.iterdir()] == ["clip.mp4"]
    assert len(list(VideoReader(target))) == 1


def test_the_same_frames_give_the_same_bytes(tmp_path: Path) -> None:
    frames = [picture(number, 128, 160) for number in range(5)]
    generator = torch.Generator().manual_seed(0)
    written = set()
    for height in (32, 120, 48, 64, 32, 96, 720, 50):  # other videos in between leave other memory behind
        other = torch.randint(0, 256, (2, 3, height, 64), dtype=torch.uint8, generator=generator)
        list(VideoReader(write(tmp_path / "other.mp4", list(other))))
        written.add(write(tmp_path / "same.mp4", frames, comment="a").read_bytes())
    assert len(written) == 1


def test_frames_are_decoded_one_at_a_time(tmp_path: Path) -> None:
    reader = VideoReader(write(tmp_path / "clip.mp4", [picture(number) for number in range(40)]))
    alive: list[weakref.ref[Tensor]] = []
    most = 0
    gc.freeze()  # else each collection walks all that earlier tests left
    for frame in reader:
        alive.append(weakref.ref(frame.rgb))
        gc.collect()
        most = max(most, sum(one() is not None for one in alive))
    assert len(alive) == 40
    assert most <= 2  # the present one, and the last one while the next is made


@pytest.mark.skipif(
    not hasattr(getattr(av, "VideoStream", None), "set_display_rotation"), reason="this PyAV cannot write a rotation"
)
def test_a_turned_video_comes_out_upright(tmp_path: Path) -> None:
    frame = picture(0)
    with av.open(str(tmp_path / "turned.mp4"), "w") as container:
        stream = container.add_stream("libx264", rate=10)
        stream.width, stream.height, stream.pix_fmt = 48, 32, "yuv420p"
        stream.set_display_rotation(90)
        encoded = av.VideoFrame.from_ndarray(np.ascontiguousarray(frame.permute(1, 2, 0).numpy()), format="rgb24")
        container.mux(stream.encode(encoded))
        container.mux(stream.encode(None))
    reader = VideoReader(tmp_path / "turned.mp4")
    with av.open(str(tmp_path / "turned.mp4")) as container:
        quarter = round(next(container.decode(video=0)).rotation / 90)
    assert quarter % 2 == 1
    assert (reader.height, reader.width) == (48, 32)
    upright = torch.rot90(frame, quarter, (1, 2)).float()  # counterclockwise, as FFmpeg defines the angle
    assert (next(iter(reader)).rgb.float() - upright).abs().mean() < 6.0


# ---- refused -------------------------------------------------------------------------------------------------------


def test_without_pyav_the_extra_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "av", None)
    with pytest.raises(ImportError, match=r"pip install 'torchweather\[video\]'"):
        VideoReader(tmp_path / "clip.mp4")
    with (
        pytest.raises(ImportError, match=r"pip install 'torchweather\[video\]'"),
        write_video(tmp_path / "clip.mp4", 32, 48, 10),
    ):
        pass
    assert not list(tmp_path.iterdir())


def test_files_that_are_no_videos_are_refused(tmp_path: Path) -> None:
    with pytest.raises(TorchweatherError, match="no such file"):
        VideoReader(tmp_path / "none.mp4")
    broken = tmp_path / "text.mp4"
    broken.write_text("no video\n" * 100)
    with pytest.raises(TorchweatherError, match=r"text\.mp4: expected a video; it cannot be read"):
        VideoReader(broken)
    whole = write(tmp_path / "whole.mp4", [picture(number) for number in range(9)])
    broken.write_bytes(whole.read_bytes()[:600])  # the index of an mp4 stands at its end
    with pytest.raises(TorchweatherError, match=r"text\.mp4: expected a video"):
        VideoReader(broken)


@pytest.mark.parametrize(("codec", "layout"), [("rawvideo", "bayer_rggb8"), ("ffv1", "gray16le")])
def test_raw_mosaics_are_refused(tmp_path: Path, codec: str, layout: str) -> None:
    path = tmp_path / ("raw.nut" if codec == "rawvideo" else "raw.mkv")
    with av.open(str(path), "w") as container:
        stream = container.add_stream(codec, rate=10)
        stream.width, stream.height, stream.pix_fmt = 32, 32, layout
        container.mux(stream.encode(av.VideoFrame(32, 32, layout)))
        container.mux(stream.encode(None))
    with pytest.raises(TorchweatherError, match=rf"got pixel format {layout}.*mosaic.*give the folder"):
        VideoReader(path)


def test_high_dynamic_range_is_refused(tmp_path: Path) -> None:
    with av.open(str(tmp_path / "hdr.mp4"), "w") as container:
        stream = container.add_stream("libx264", rate=10)
        stream.width, stream.height, stream.pix_fmt = 32, 32, "yuv420p"
        stream.codec_context.color_trc = 16
        container.mux(stream.encode(av.VideoFrame.from_ndarray(np.zeros((32, 32, 3), np.uint8))))
        container.mux(stream.encode(None))
    with pytest.raises(TorchweatherError, match="high dynamic range"):
        VideoReader(tmp_path / "hdr.mp4")


def test_wrong_frames_and_names_are_refused(tmp_path: Path) -> None:
    with (
        pytest.raises(TorchweatherError, match=r"expected a video ending in \.mp4"),
        write_video(tmp_path / "clip.gif", 32, 48, 10),
    ):
        pass
    with (
        pytest.raises(ValueError, match=r"expected rgb \(3, 32, 48\) uint8"),
        write_video(tmp_path / "clip.mp4", 32, 48, 10) as video,
    ):
        video.add(picture(0).float())
    with pytest.raises(ValueError, match="one frame or more"), write_video(tmp_path / "clip.mp4", 32, 48, 10):
        pass
    assert not list(tmp_path.iterdir())
