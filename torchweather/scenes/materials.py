"""Reflectances of surfaces: linear red, green, blue and near-infrared reflectances and their grain, by position.

Values are generic: typical diffuse reflectances in the visible (weathered asphalt 0.10-0.15 and worn white paint as in
Pomerantz et al. 2003, LBNL-53148; vegetation, bark, soil, metals and textiles of the order found in the ECOSTRESS
spectral library, Meerdink et al. 2019), not measured ones. The calibration boards are what their name says.

The near-infrared pairs are generic in the same way. What they keep of the spectra: green plants are bright near 900 nm
and, like skin, dark at 1550 nm, where water absorbs (Meerdink et al. 2019; Cooksey and Allen 2013, Proc. SPIE 8734);
dyes of textiles and coloured paints mostly let near-infrared light pass to the bright fibre or pigment beneath; carbon
black (tyres, black plastic) stays dark. Window glass has what its dust scatters: a laser goes through it or is mirrored
away, and there is no interior behind it to send it back.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from torchweather.core.errors import check_at_least, check_between, check_finite, check_one_of
from torchweather.scenes.position_noise import cell_noise, value_noise

__all__ = [
    "BOARD_REFLECTANCES",
    "MATERIALS",
    "NEAR_INFRARED_NM",
    "TEXTURES",
    "Material",
    "board",
    "laser_reflectivity",
    "surface_reflectance",
]

RGB = tuple[float, float, float]

TEXTURES = ("plain", "speckle", "clumps", "checker", "ribs")

# Grey boards of a radiometric target set; 5, 10, 50, 80 and 90 % are sold as calibrated diffuse panels.
BOARD_REFLECTANCES = (0.05, 0.10, 0.50, 0.80, 0.90)

# Wavelengths of a material's near-infrared pair: the silicon detectors' 850-940 nm, and the eye-safe 1550 nm.
NEAR_INFRARED_NM = (900.0, 1550.0)


@dataclass(frozen=True)
class Material:
    """A diffuse surface with grain, and for glossy ones a clear coat that mirrors the surroundings.

    Args:
        rgb: mean diffuse reflectance, linear, 0..1.
        texture: ``plain``; ``speckle`` (fine cells with soft patches); ``clumps`` (smooth, two scales);
            ``checker`` (cells of ``rgb`` and of ``rgb * (1 - contrast)``); ``ribs`` (dark hoops every
            ``cell_m`` along x).
        contrast: amplitude of the texture relative to ``rgb``, 0..1.
        cell_m: size of a cell, metres.
        gloss: share mirrored at normal incidence (Fresnel); 0.04 is a clear coat of n = 1.5, 0 is matt.
        emission_rgb: radiance that the surface sends by itself, as a share of the sensor's saturation
            (a translucent roof in daylight).
        near_infrared: mean diffuse reflectance at the two wavelengths of `NEAR_INFRARED_NM`, 0..1; ``None`` takes
            the mean of ``rgb`` for both.
        retroreflectivity: what a retroreflector sends straight back, as the reflectance of a Lambertian surface that
            would send back as much: pi times its coefficient of retroreflection in cd/(lx m^2). 0 is none.
    """

    rgb: RGB
    texture: str = "plain"
    contrast: float = 0.0
    cell_m: float = 0.1
    gloss: float = 0.0
    emission_rgb: RGB = (0.0, 0.0, 0.0)
    near_infrared: tuple[float, float] | None = None
    retroreflectivity: float = 0.0

    def __post_init__(self) -> None:
        check_one_of("texture", self.texture, TEXTURES, owner=self)
        for value in self.rgb:
            check_between("rgb", value, 0.0, 1.0, owner=self)
        check_between("contrast", self.contrast, 0.0, 1.0, owner=self)
        check_between("gloss", self.gloss, 0.0, 1.0, owner=self)
        for value in self.near_infrared or ():
            check_between("near_infrared", value, 0.0, 1.0, owner=self)
        check_at_least("retroreflectivity", self.retroreflectivity, 0.0, owner=self)
        check_finite("retroreflectivity", self.retroreflectivity, owner=self)


def board(reflectance: float) -> Material:
    """A diffuse grey board of known reflectance, the same at every wavelength (as sintered PTFE panels nearly are).

    Example:
        >>> board(0.5).rgb
        (0.5, 0.5, 0.5)
    """
    check_between("reflectance", reflectance, 0.0, 1.0, owner="board")
    return Material(rgb=(reflectance, reflectance, reflectance), near_infrared=(reflectance, reflectance))


MATERIALS: dict[str, Material] = {
    "asphalt": Material(
        rgb=(0.118, 0.116, 0.115), texture="speckle", contrast=0.45, cell_m=0.012, near_infrared=(0.17, 0.22)
    ),
    "lane_paint": Material(
        rgb=(0.58, 0.58, 0.56), texture="speckle", contrast=0.25, cell_m=0.015, near_infrared=(0.60, 0.52)
    ),
    "concrete": Material(
        rgb=(0.31, 0.30, 0.28), texture="speckle", contrast=0.25, cell_m=0.02, near_infrared=(0.36, 0.40)
    ),
    "hall_floor": Material(
        rgb=(0.16, 0.16, 0.16), texture="speckle", contrast=0.25, cell_m=0.02, near_infrared=(0.22, 0.25)
    ),
    "grass": Material(
        rgb=(0.072, 0.108, 0.034), texture="clumps", contrast=0.75, cell_m=0.06, near_infrared=(0.50, 0.25)
    ),
    "foliage": Material(
        rgb=(0.058, 0.088, 0.028), texture="clumps", contrast=0.85, cell_m=0.13, near_infrared=(0.45, 0.25)
    ),
    "dark_foliage": Material(
        rgb=(0.040, 0.062, 0.026), texture="clumps", contrast=0.85, cell_m=0.15, near_infrared=(0.40, 0.20)
    ),
    "distant_wood": Material(
        rgb=(0.048, 0.066, 0.036), texture="clumps", contrast=0.7, cell_m=1.6, near_infrared=(0.38, 0.20)
    ),
    "bark": Material(
        rgb=(0.105, 0.082, 0.060), texture="clumps", contrast=0.6, cell_m=0.05, near_infrared=(0.32, 0.38)
    ),
    "paint_red": Material(rgb=(0.36, 0.030, 0.028), gloss=0.04, near_infrared=(0.45, 0.42)),
    "paint_blue": Material(rgb=(0.040, 0.085, 0.26), gloss=0.04, near_infrared=(0.38, 0.38)),
    "paint_silver": Material(rgb=(0.42, 0.43, 0.44), gloss=0.04, near_infrared=(0.45, 0.45)),
    # Two faces of 0.04 over a dark interior.
    "glass": Material(rgb=(0.022, 0.026, 0.026), gloss=0.08, near_infrared=(0.02, 0.02)),
    "tyre": Material(rgb=(0.035, 0.035, 0.036), near_infrared=(0.04, 0.04)),
    "rim": Material(rgb=(0.36, 0.36, 0.37), gloss=0.05, near_infrared=(0.40, 0.42)),
    "black_plastic": Material(rgb=(0.028, 0.028, 0.030), near_infrared=(0.04, 0.04)),
    "tail_light": Material(rgb=(0.42, 0.020, 0.018), gloss=0.05, near_infrared=(0.45, 0.40)),
    "head_light": Material(rgb=(0.52, 0.53, 0.55), gloss=0.06, near_infrared=(0.30, 0.25)),
    # Retroreflection: generic orders, R_A = 32 cd/(lx m^2) for a plate in use, 95 for the prisms of a post.
    "number_plate": Material(rgb=(0.72, 0.72, 0.68), near_infrared=(0.70, 0.62), retroreflectivity=100.0),
    "skin": Material(rgb=(0.46, 0.29, 0.21), near_infrared=(0.55, 0.10)),
    "hair": Material(rgb=(0.050, 0.036, 0.026), near_infrared=(0.30, 0.35)),
    "jacket_orange": Material(rgb=(0.62, 0.20, 0.035), near_infrared=(0.65, 0.58)),
    "jacket_yellow": Material(rgb=(0.64, 0.66, 0.06), near_infrared=(0.70, 0.60)),
    "trousers_dark": Material(rgb=(0.040, 0.046, 0.075), near_infrared=(0.45, 0.50)),
    "shoes": Material(rgb=(0.045, 0.040, 0.036), near_infrared=(0.12, 0.14)),
    "bag": Material(rgb=(0.045, 0.10, 0.15), near_infrared=(0.45, 0.42)),
    "bicycle": Material(rgb=(0.05, 0.20, 0.24), gloss=0.04, near_infrared=(0.35, 0.35)),
    "helmet": Material(rgb=(0.66, 0.66, 0.66), gloss=0.03, near_infrared=(0.68, 0.60)),
    "galvanised": Material(
        rgb=(0.34, 0.35, 0.36), texture="clumps", contrast=0.12, cell_m=0.2, near_infrared=(0.42, 0.46)
    ),
    "white_plastic": Material(rgb=(0.74, 0.74, 0.73), near_infrared=(0.75, 0.65)),
    "reflector": Material(rgb=(0.70, 0.34, 0.04), gloss=0.05, near_infrared=(0.50, 0.45), retroreflectivity=300.0),
    "wood": Material(rgb=(0.30, 0.21, 0.13), texture="clumps", contrast=0.3, cell_m=0.03, near_infrared=(0.55, 0.40)),
    "checker": Material(
        rgb=(0.86, 0.86, 0.86), texture="checker", contrast=0.95, cell_m=0.25, near_infrared=(0.86, 0.86)
    ),
    "membrane_roof": Material(
        rgb=(0.30, 0.31, 0.31),
        texture="ribs",
        contrast=0.6,
        cell_m=2.5,
        emission_rgb=(0.53, 0.555, 0.565),
        near_infrared=(0.32, 0.28),
    ),
    "membrane_wall": Material(
        rgb=(0.30, 0.31, 0.31),
        texture="ribs",
        contrast=0.6,
        cell_m=2.5,
        emission_rgb=(0.28, 0.295, 0.30),
        near_infrared=(0.32, 0.28),
    ),
    "end_wall": Material(
        rgb=(0.36, 0.37, 0.38), texture="clumps", contrast=0.06, cell_m=0.6, near_infrared=(0.42, 0.42)
    ),
    "door": Material(rgb=(0.22, 0.23, 0.24), near_infrared=(0.30, 0.30)),
}


def _grain(material: Material, point_m: Tensor, footprint_m: Tensor) -> Tensor:
    """Factor on ``rgb``, mean near 1, ``(N,)``.

    A pixel that sees n cells at once sees their mean: the grain's standard deviation falls with ``1 / sqrt(n)``,
    n = 1 + (footprint / cell)^2.
    """

    def averaged(cell_m: float) -> Tensor:
        return (1 + (footprint_m / cell_m) ** 2).rsqrt()

    size = material.cell_m
    if material.texture == "speckle":
        fine = (cell_noise(point_m, size, seed=1) - 0.5) * averaged(size)
        soft = (value_noise(point_m, 1.3, seed=2) - 0.5) * averaged(1.3)
        return 1 + material.contrast * (1.2 * fine + 0.5 * soft)
    if material.texture == "clumps":
        fine = (value_noise(point_m, size, seed=6) - 0.5) * averaged(size)
        soft = (value_noise(point_m, 9 * size, seed=7) - 0.5) * averaged(9 * size)
        return 1 + material.contrast * (1.2 * fine + 0.8 * soft)
    if material.texture == "checker":
        # Boards stand across the road with their edges at multiples of a cell; the hair keeps the edges on one side.
        odd = torch.remainder(torch.floor(point_m[:, 1] / size + 1e-4) + torch.floor(point_m[:, 2] / size + 1e-4), 2)
        return 1 - material.contrast * odd
    if material.texture == "ribs":
        hoop = torch.remainder(point_m[:, 0], size) < 0.04 * size
        return torch.where(hoop, 1 - material.contrast, 1.0).to(point_m.dtype)
    return torch.ones_like(footprint_m)


def laser_reflectivity(material: Material, wavelength_nm: float) -> float:
    """Mean diffuse reflectance of a material for a laser in the near infrared.

    Between the two wavelengths of `NEAR_INFRARED_NM` it is interpolated, outside the nearer one's value holds.

    Args:
        material: what the surface is made of.
        wavelength_nm: of the laser; meant for 800-1600 nm.

    Returns:
        Reflectance, 0..1.

    Example:
        >>> laser_reflectivity(MATERIALS["grass"], 865.0), laser_reflectivity(MATERIALS["grass"], 1550.0)
        (0.5, 0.25)
    """
    short, long = material.near_infrared or (sum(material.rgb) / 3,) * 2
    low, high = NEAR_INFRARED_NM
    share = min(max((wavelength_nm - low) / (high - low), 0.0), 1.0)
    return short + share * (long - short)


def surface_reflectance(material: Material, point_m: Tensor, footprint_m: Tensor) -> tuple[Tensor, Tensor]:
    """Diffuse reflectance and emitted radiance of points on a material.

    Args:
        material: what the surface is made of.
        point_m: positions, metres, ``(N, 3)``.
        footprint_m: width of what one ray stands for there, metres, ``(N,)``; 0 is a point. Grain finer than it
            is averaged out.

    Returns:
        Reflectance in [0, 1] and emission (share of saturation), both ``(N, 3)``.

    Example:
        >>> surface_reflectance(board(0.5), torch.zeros(1, 3), torch.zeros(1))[0]
        tensor([[0.5000, 0.5000, 0.5000]])
    """
    grain = _grain(material, point_m, footprint_m)[:, None]
    reflectance = (grain * point_m.new_tensor(material.rgb)).clamp(0, 1)
    emission = point_m.new_tensor(material.emission_rgb).expand_as(reflectance)
    return reflectance, emission * grain if material.texture == "ribs" else emission
