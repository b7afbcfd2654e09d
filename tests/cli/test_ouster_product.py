"""A recording of one Ouster is not simulated as another sensor."""

from __future__ import annotations

import argparse
from dataclasses import replace

import pytest

from torchweather.cli.ouster_product import refuse_other_product
from torchweather.core.errors import TorchweatherError
from torchweather.sensors import Lidar

ARGS = argparse.Namespace(force=False)


@pytest.mark.parametrize("preset", ["ouster-os0-128", "ouster-os1-128", "velodyne-hdl-64e", "generic-1550nm"])
def test_another_preset_is_refused_with_the_one_to_take(preset: str) -> None:
    with pytest.raises(TorchweatherError, match=r"a\.pcap: recorded by an OS-2-128, .*--sensor lidar:ouster-os2-128"):
        refuse_other_product("a.pcap", "OS-2-128", Lidar.preset(preset), ARGS, "apply")
    refuse_other_product("a.pcap", "OS-2-128", Lidar.preset(preset), argparse.Namespace(force=True), "apply")


@pytest.mark.parametrize("product", ["OS-1-128", "OS-1-64", "OS1-32", "", None, "OT128"])
def test_the_product_itself_its_siblings_and_unknown_ones_pass(product: str | None) -> None:
    own = Lidar.preset("ouster-os1-128")
    refuse_other_product("a.pcap", product, own, ARGS, "apply")
    # A unit's own calibration differs by hundredths of a degree; a sensor without elevations is not judged by them.
    beams = tuple(beam * 1.02 for beam in own.elevations_deg or ())
    refuse_other_product("a.pcap", product, replace(own, elevations_deg=beams), ARGS, "apply")
    bare = replace(own, elevations_deg=None, azimuth_offsets_deg=None, origin_heights_m=None)
    refuse_other_product("a.pcap", product, bare, ARGS, "apply")
