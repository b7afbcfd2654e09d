"""Words of the demo page: why each weather looks as it does, and what the pictures are not."""

from __future__ import annotations

from torchweather.report import parts
from torchweather.report.report import Section

__all__ = ["NAMES", "WHY", "limits"]

NAMES = {"rain": "Rain", "fog": "Fog", "snow": "Snow", "mixture": "Rain in fog"}

WHY = {
    "rain": (
        """Rain is seen through its streaks, not through its haze: even heavy rain takes little of the light from the
        next car. A drop of 2 mm falls about 6.5 m in a second, so in an exposure of 5 ms it draws a stroke of 3 cm. It
        covers any one pixel for only a part of that time, which is why near streaks are long, wide and faint.""",
        """A drop is a lens that gathers light from nearly half of space, so it shows the mean colour of the scene, with
        6 % of the sky mirrored on its outside. In front of dark trees it is bright; in front of a bright sky it is
        dark. Far drops are smaller than a pixel and merge into a soft veil that lifts the shadows.""",
    ),
    "fog": (
        """Fog droplets are a few micrometres to some tens of micrometres wide, far too many and too small to be seen.
        Each metre of air takes the same share of the light that passes and puts light from all around in its place, so
        contrast falls as exp(−αr) with the distance r along the ray. At the visibility, 5 % of it is left.""",
        """The droplets are larger than the wavelength: red, green and blue lose nearly the same, and fog is grey rather
        than blue. Far objects do not get dark but turn into airlight. The raw signal of the whole frame gathers in a
        narrow peak at that level, and the contrast that a detector needs sinks towards the noise.""",
    ),
    "snow": (
        """Flakes are loose and large, and fall at about 1 m/s. In 5 ms they move only some 5 mm, about their own size,
        so they look like soft dots and not like streaks. They stay in front of the same pixels for most of the
        exposure, and hide what is behind them far better than a drop does.""",
        parts.markup("""A flake scatters about 90 % of the light of the sky: it is white in front of trees and road, and
        a little darker than the sky itself. For the same water, flakes have several times the area of drops. That is
        why snow of 3 mm/h can hide more than rain of 50 mm/h. A far flake is smaller than a pixel and lights only one
        colour of the filter array: demosaicing turns it into a coloured speck. The blur of a real lens
        (<code>Camera(lens_blur_px=1.5)</code>) softens it to grey."""),
    ),
    "mixture": (
        """Both weathers act in one chain, before the sensor: fog dims the scene along the ray, and drops cover it. Near
        streaks stay clear, far ones fade into the airlight together with the scene behind them.""",
        """The optical depths of fog and rain add up. Rain alone would leave the far car visible; the fog decides how
        far one sees, the rain decides how restless the near field is.""",
    ),
}

# An item of a sensor is shown where the page shows the sensor.
MODEL = """
    - Single scattering. Fog of a visibility below about 50 m also blurs a real image; here it only fades.
    - Daylight: particles and fog are lit by the sky. Headlights and street lamps are left out here (night=True).
    - The weather is in the air only: no wet road, no spray, no snow on the ground, no drops on the lens.
    - Drops and flakes are disks of their outline in the picture; a drop shows the mean colour of the scene and a share
      of the sky, not a small upside-down image. Snow is dry.
    - Rain and snow reach 200 m far; the sky is seen through that much of them.
    - Particles too faint to be seen one by one enter through the exact mean and variance of their sum.
    - LiDAR: a beam is a uniform cone, one ray stands for it in the scene, and echoes of several scatterings are left
      out. Objects weaken without noise of their own.
    - Radar: nothing hides anything, and no echo comes by way of road or guard rail. Ground and walls return nothing.
      The radar's cover is dry.
    - Sensor noise belongs to the clear frame; the noise of light that the weather adds is not drawn again.
"""
CHECKED = """
    - Extinction and visibility: Mie theory against independent computations, in the test suite.
    - Rain and snow: mean, spread, streak correlation and extremes of the mask against a reference that draws every
      particle, in the test suite.
    - LiDAR: returns of drops and flakes, in every return mode, against a reference that lists every particle in the
      beam; the fog's echo against direct integration, in the test suite.
    - Radar: range, speed, angle and power of corner reflectors through the whole chain, facets against closed forms,
      false alarms of the detector, in the test suite.
    - On this page: dots against lines, and the mean of each particle mask against its expectation.
"""
OPEN = """
    - The finished pictures have not been compared with recordings of the same place in real weather.
    - The size distributions are averages of many events; a single shower may differ by a factor.
    - LiDAR: pulse width and near-range response of the preset are generic. They decide most of what fog and snow look
      like to it.
    - Radar: cross sections of all but cars and corner reflectors, and the link budget, are generic.
    - Exposure time and focus of the camera preset are generic, not measured on the camera.
"""
TABLE = """How to read the table. Extinction is all light that leaves the straight path, by Mie theory. Visibility is
    the meteorological optical range, at which contrast falls to 5 %. The camera's optical depth counts for rain and
    snow only the area of the particles: the equally large share that is diffracted around a drop stays within a blur
    of its pixel. Numbers of particles are expected values for this depth map. Times are for one frame on this
    machine, the first of its kind."""


def limits(version: str, seed: int, *, lidar: bool, radar: bool) -> Section:
    """Limits of the pictures: the model, the checks, the open points.

    Args:
        version, seed: of the demo.
        lidar, radar: whether the page shows one.
    """
    hidden = tuple(name for name, shown in (("LiDAR: ", lidar), ("Radar: ", radar)) if not shown)
    columns = {"Limits of the model": MODEL, "What is checked": CHECKED, "What is not": OPEN}
    made = parts.markup("torchweather {} · seed {} · all numbers in {}", version, seed, parts.link("summary.json"))
    lists = [
        (title, [parts.Listing([one for one in parts.items(text) if not one.startswith(hidden)])])
        for title, text in columns.items()
    ]
    return Section(
        "What these pictures are, and what they are not", [parts.Columns(lists), parts.Fine(TABLE), parts.Fine(made)]
    )
