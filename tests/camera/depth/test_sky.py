"""Sky masks of drawn scenes whose sky is known."""

from __future__ import annotations

import pytest
import torch
from torch import Tensor

from torchweather.camera.depth import sky_seeds
from torchweather.camera.depth.sky import find_sky, sky_mask

SKIES = {
    "blue": ((0.35, 0.55, 0.80), (0.60, 0.75, 0.88)),
    "deep blue": ((0.15, 0.35, 0.70), (0.40, 0.60, 0.85)),
    "cyan": ((0.60, 0.95, 1.00), (0.85, 1.00, 1.00)),
    "white": ((1.00, 1.00, 1.00), (1.00, 1.00, 1.00)),
    "overcast": ((0.55, 0.56, 0.58), (0.70, 0.71, 0.72)),
}


def random(*shape: int, seed: int = 0) -> Tensor:
    return torch.rand(*shape, generator=torch.Generator().manual_seed(seed))


def ground(height: int, width: int) -> Tensor:
    """Textured greenish ground, 0.05..0.35."""
    return (0.05 + 0.3 * random(1, height, width)) * torch.tensor([0.8, 1.0, 0.6])[:, None, None]


def sky_of(name: str, height: int, width: int) -> Tensor:
    top, low = (torch.tensor(colour)[:, None, None] for colour in SKIES[name])
    down = torch.linspace(0, 1, height)[None, :, None]
    return (top + (low - top) * down).expand(3, height, width)


def scene(sky: str = "blue", height: int = 240, width: int = 800) -> tuple[Tensor, Tensor]:
    """A photograph whose skyline is wavy, and its sky ``(1, H, W)``."""
    columns = torch.arange(width)
    skyline = height * (0.33 + 0.08 * torch.sin(columns / width * 9.0))
    truth = torch.arange(height)[:, None] < skyline[None]
    return torch.where(truth, sky_of(sky, height, width), ground(height, width)), truth[None]


def overlap(share: Tensor, truth: Tensor) -> float:
    found = share >= 0.5
    return float((found & truth).sum() / (found | truth).sum())


@pytest.mark.parametrize("sky", SKIES)
def test_sky_of_any_colour_over_textured_ground_is_found(sky: str) -> None:
    photograph, truth = scene(sky)
    share = sky_mask(photograph)
    assert share.shape == (1, 240, 800)
    assert share.dtype == torch.float32
    assert overlap(share, truth) > 0.99
    assert bool((share[:, :50] == 1).all())  # the skyline's highest point is row 60
    assert bool((share[:, 110:] == 0).all())  # its lowest is row 98
    assert find_sky(photograph).blue == (sky not in ("white", "overcast"))


def test_noise_of_a_camera_does_not_break_the_sky() -> None:
    photograph, truth = scene("cyan")
    noise = 0.01 * torch.randn(photograph.shape, generator=torch.Generator().manual_seed(1))
    assert overlap(sky_mask((photograph + noise).clamp(0, 1)), truth) > 0.98


@pytest.mark.parametrize("sky", ["blue", "white"])
def test_sky_on_both_sides_of_a_pole_is_sky_and_the_pole_is_not(sky: str) -> None:
    photograph, truth = scene(sky)
    photograph[:, :200, 150:158] = 0.15
    share = sky_mask(photograph)
    assert bool((share[:, :50, 130:148] > 0.9).all())
    assert bool((share[:, :50, 160:180] > 0.9).all())
    assert float(share[:, :50, 152:156].max()) < 0.1
    truth[:, :200, 150:158] = False
    assert overlap(share, truth) > 0.98


@pytest.mark.parametrize("sky", ["blue", "white"])
def test_mixed_pixels_of_branches_have_the_share_of_sky_that_shows(sky: str) -> None:
    times = 4
    fine, sharp = scene(sky, 240 * times, 800 * times)
    rows, columns = torch.meshgrid(torch.arange(240 * times), torch.arange(800 * times), indexing="ij")
    # Twigs of 2.5 pixels every 10 pixels, slanting, below row 20 of a crown 200 pixels wide.
    twig = ((columns + rows // 2) % (10 * times) < 10) & (rows > 20 * times) & (columns // times // 200 == 1)
    fine = torch.where(twig, torch.tensor(0.1), fine)
    photograph = torch.nn.functional.avg_pool2d(fine[None], times)[0]
    truth = torch.nn.functional.avg_pool2d((sharp & ~twig).float()[None], times)[0]
    share = sky_mask(photograph)
    crown = (slice(None), slice(25, 60), slice(210, 390))
    mixed = (truth[crown] > 0.2) & (truth[crown] < 0.8)
    error = (share[crown] - truth[crown]).abs()
    # Shares are stretched (0.15..0.85 becomes 0..1), which moves a share by 0.15 at most; the filter adds to it.
    assert float(error[mixed].mean()) < 0.2
    assert float(error.mean()) < 0.15
    assert float(((share[crown] > 0.05) & (share[crown] < 0.95)).float().mean()) > 0.1


def test_white_wall_below_the_horizon_is_no_sky() -> None:
    photograph, truth = scene("white")
    photograph[:, 125:230, 300:500] = 1.0
    share = sky_mask(photograph)
    assert bool((share[:, 110:] == 0).all())
    assert overlap(share, truth) > 0.99


@pytest.mark.parametrize("sky", ["blue", "white"])
def test_white_wall_from_the_top_to_the_ground_is_no_sky(sky: str) -> None:
    photograph, truth = scene(sky)
    photograph[:, :200, 560:760] = 0.2  # its shaded sides
    photograph[:, :200, 580:740] = 0.95
    truth[:, :, 560:760] = False
    share = sky_mask(photograph)
    assert float(share[:, :, 590:730].max()) == 0
    assert overlap(share[..., :560], truth[..., :560]) > 0.98


def test_white_gable_that_ends_above_the_horizon_is_no_sky() -> None:
    photograph, truth = scene("white")
    photograph[:, :110, 560:] = ground(110, 240)
    photograph[:, :90, 600:760] = 1.0
    truth[:, :, 560:] = False
    share = sky_mask(photograph)
    assert float(share[:, :, 580:].max()) == 0
    assert overlap(share, truth) > 0.98


def test_dim_wall_at_the_top_is_no_sky() -> None:
    photograph, truth = scene("overcast")
    photograph[:, :110, 560:] = ground(110, 240)
    photograph[:, :30, 600:760] = 0.42
    truth[:, :, 560:] = False
    share = sky_mask(photograph)
    assert float(share[:, :, 580:].max()) == 0
    assert overlap(share, truth) > 0.98


def test_blue_sky_in_a_gap_far_from_the_rest_of_it_is_found() -> None:
    photograph, truth = scene("blue")
    crown = torch.zeros(240, 800, dtype=torch.bool)
    crown[:120, 500:] = True
    crown[30:60, 650:700] = False  # a gap below the picture's top
    photograph = torch.where(crown, ground(240, 800), photograph)
    truth = truth & ~crown
    share = sky_mask(photograph)
    assert float(share[:, 35:55, 655:695].min()) > 0.9
    assert overlap(share, truth) > 0.98


def test_bright_cloud_with_a_sharp_rim_is_sky_and_a_dark_bird_is_not() -> None:
    photograph, truth = scene("blue")
    photograph[:, 20:40, 300:360] = 0.95
    photograph[:, 20:40, 500:520] = 0.1
    share = sky_mask(photograph)
    assert float(share[:, 22:38, 302:358].min()) > 0.9
    assert float(share[:, 24:36, 504:516].max()) < 0.1
    assert overlap(share[..., :480], truth[..., :480]) > 0.99


def test_textured_town_as_bright_as_the_sky_is_no_sky() -> None:
    photograph, truth = scene("overcast")
    windows = random(1, 60, 200, seed=3).repeat_interleave(4, 1).repeat_interleave(4, 2)
    town = photograph[:, 20:21] + 0.4 * (windows - 0.5)
    below = torch.arange(240)[:, None] >= 60
    photograph = torch.where(below & (torch.arange(240)[:, None] < 140), town, photograph)
    truth = truth & ~below
    share = sky_mask(photograph)
    # A few windows beside the sky have its colour by chance; without the stop at rough ground it is 0.41.
    assert float(share[:, 75:140].mean()) < 0.01
    assert overlap(share, truth) > 0.95


def test_pale_line_between_white_wall_and_white_sky_is_seen_at_full_size() -> None:
    photograph, truth = scene("white", 360, 1440)
    photograph[:, 60:, 900:1100] = 1.0
    photograph[:, 60, 900:1100] = 0.85  # one pixel: 0.025 a pixel and more at full size, a third of it in the cells
    photograph[:, 60:, 899] = photograph[:, 60:, 1100] = 0.85
    truth[:, 60:, 899:1101] = False
    assert overlap(sky_mask(photograph), truth) > 0.98


def test_frame_without_sky_has_none() -> None:
    photograph = ground(240, 800)
    photograph[:, 20:100, 200:300] = torch.tensor([0.3, 0.5, 0.8])[:, None, None]  # a blue sign
    photograph[:, 100:, 350:450] = 0.9  # a white van
    found = find_sky(photograph)
    assert not found.found
    assert not found.blue
    assert torch.equal(found.share, torch.zeros(1, 240, 800))


@pytest.mark.parametrize("sky", SKIES)
def test_frame_of_sky_alone_is_sky_everywhere(sky: str) -> None:
    assert torch.equal(sky_mask(sky_of(sky, 240, 800)), torch.ones(1, 240, 800))


def test_no_sky_below_a_given_horizon() -> None:
    photograph = sky_of("white", 240, 800).clone()
    share = sky_mask(photograph, horizon_row=100.0)
    assert bool((share[:, 101:] == 0).all())
    assert bool((sky_mask(photograph, horizon_row=-5.0) == 0).all())
    photograph, truth = scene("blue")
    assert overlap(sky_mask(photograph, horizon_row=400.0), truth) > 0.99


def test_sky_that_meets_the_horizon_without_an_edge_fades() -> None:
    photograph, _ = scene("white")
    photograph[:, :130] = 0.9
    share = sky_mask(photograph, horizon_row=100.0)[0, :, 400]
    assert float((share[1:] - share[:-1]).abs().max()) < 0.15
    assert float(share[80]) > 0.9


def test_night_has_no_sky_below_the_horizon() -> None:
    photograph = 0.12 * ground(240, 800) + 0.02
    photograph[:, :90] = torch.tensor([0.05, 0.05, 0.09])[:, None, None]
    photograph[:, 60:70, 100:110] = 1.0  # lamps
    photograph[:, 150:170, 300:340] = 1.0
    assert bool((sky_mask(photograph) == 0).all())


def test_region_on_lidar_returns_is_rejected() -> None:
    photograph, truth = scene("white")
    photograph[:, :, 380:420] = 0.2
    truth[:, :, 380:420] = False
    returns = torch.zeros(1, 240, 800, dtype=torch.bool)
    returns[:, ::4, 420::4] = True
    share = sky_mask(photograph, returns=returns)
    assert float(share[:, :, 430:].max()) == 0
    assert overlap(share[..., :380], truth[..., :380]) > 0.98
    returns[:] = False
    returns[:, 110::4, ::4] = True  # the ground alone
    assert torch.equal(sky_mask(photograph, returns=returns), sky_mask(photograph))


@pytest.mark.parametrize("size", [(1, 1), (1, 9), (8, 8), (5, 300), (640, 360), (120, 2400), (1000, 3300), (61, 83)])
def test_any_size_gives_shares_of_its_own_size(size: tuple[int, int]) -> None:
    photograph, truth = scene("blue", *size)
    share = sky_mask(photograph)
    assert share.shape == (1, *size)
    assert float(share.min()) >= 0
    assert float(share.max()) <= 1
    if min(size) > 60:
        assert overlap(share, truth) > 0.97


def test_batch_is_its_frames_and_bytes_are_their_floats() -> None:
    photographs = torch.stack([(255 * scene(sky)[0]).round().to(torch.uint8) for sky in ("blue", "white")])
    before = photographs.clone()
    share = sky_mask(photographs)
    assert torch.equal(photographs, before)
    assert share.shape == (2, 1, 240, 800)
    for frame, own in zip(photographs, share, strict=True):
        assert torch.equal(sky_mask(frame), own)
        assert torch.equal(sky_mask(frame.float() / 255), own)


def test_pole_is_upright_and_eaves_are_not() -> None:
    smooth = torch.ones(40, 60, dtype=torch.bool).numpy()
    smooth[:, 20:24] = False  # a pole
    assert sky_seeds.behind_poles(smooth, 1.0)[:, 20:24].all()
    smooth[:] = True
    for row in range(40):
        smooth[row, 10 + row : 14 + row] = False  # eaves
    assert not sky_seeds.behind_poles(smooth, 1.0).any()


@pytest.mark.parametrize(
    ("arguments", "error", "words"),
    [
        ({"rgb": torch.zeros(1, 8, 8)}, ValueError, r"expected \(3, H, W\)"),
        ({"rgb": torch.zeros(3, 8, 8, dtype=torch.int32)}, TypeError, "uint8 or float"),
        ({"rgb": torch.full((3, 8, 8), 255.0)}, ValueError, r"0\.\.1"),
        ({"rgb": torch.full((3, 8, 8), torch.nan)}, ValueError, r"0\.\.1"),
        ({"rgb": torch.zeros(3, 8, 8), "horizon_row": float("nan")}, ValueError, "horizon_row"),
        ({"rgb": torch.zeros(3, 8, 8), "returns": torch.zeros(1, 8, 8)}, ValueError, "returns"),
    ],
)
def test_wrong_arguments_are_named(arguments: dict[str, Tensor], error: type[Exception], words: str) -> None:
    with pytest.raises(error, match=words):
        sky_mask(**arguments)


def test_hill_in_mist_is_no_sky_and_the_mist_before_it_fades() -> None:
    height, width = 240, 800
    across = torch.linspace(0.0, 1.0, width)
    grey = (0.9 - 0.7 * ((across - 0.3) / 0.4).clamp(0.0, 1.0)).expand(3, height // 2, width)  # 0.9 to 0.2, no edge
    picture = torch.cat([grey, ground(height - height // 2, width)], 1)
    share = sky_mask(picture, horizon_row=height / 2)[0, : height // 2 - 20]
    assert float(share[:, : width // 4].min()) == 1.0
    assert float(share[:, 3 * width // 4 :].max()) < 0.01
    assert float((share[:, 1:] - share[:, :-1]).abs().max()) < 0.1, "a torn edge"
