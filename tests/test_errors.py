"""The checks speak with one voice: who, what was wanted with its unit, what came, what to do."""

from __future__ import annotations

import math
import re

import numpy as np
import pytest
import torch

from torchweather.core.errors import (
    TorchweatherError,
    TorchweatherWarning,
    check_at_least,
    check_between,
    check_finite,
    check_one_of,
    check_positive,
    nearest_name,
)


class Gauge:
    pass


def test_message_names_owner_quantity_unit_value_and_advice() -> None:
    with pytest.raises(ValueError, match=re.escape("Gauge: depth_m must be 0 m or more; got -1.0. Flip the sign.")):
        check_at_least("depth_m", -1.0, 0.0, unit="m", owner=Gauge(), advice="Flip the sign.")
    with pytest.raises(ValueError, match=re.escape("Gauge: mor_m must be above 0 m; got 0.")):
        check_positive("mor_m", 0, unit="m", owner=Gauge)
    with pytest.raises(ValueError, match=re.escape("gauge: share must lie in 0..1; got 1.5.")):
        check_between("share", 1.5, 0.0, 1.0, owner="gauge")
    with pytest.raises(ValueError, match=re.escape("gauge: fx must be a finite number in px; got inf.")):
        check_finite("fx", math.inf, unit="px", owner="gauge")


def test_unknown_name_lists_the_known_ones_and_suggests_the_nearest() -> None:
    with pytest.raises(ValueError, match=re.escape("one of rain, snow; got 'rian'. Did you mean 'rain'?")):
        check_one_of("weather", "rian", ("rain", "snow"), owner="gauge")
    assert nearest_name("zebra", ("rain", "snow")) == ""


@pytest.mark.parametrize("value", [math.nan, torch.tensor(math.nan), torch.tensor([1.0, math.nan]), "3", None, True])
def test_nan_and_what_is_no_number_never_pass(value: object) -> None:
    for check in (check_finite, check_positive):
        with pytest.raises(ValueError, match="gauge: x"):
            check("x", value, owner="gauge")
    with pytest.raises(ValueError, match="gauge: x"):
        check_at_least("x", value, -math.inf, owner="gauge")
    with pytest.raises(ValueError, match="gauge: x"):
        check_between("x", value, -math.inf, math.inf, owner="gauge")


@pytest.mark.parametrize("value", [1, 1.0, np.float32(1), np.int64(1), torch.tensor(1.0), torch.tensor([1, 2])])
def test_numbers_of_python_numpy_and_torch_pass(value: object) -> None:
    check_finite("x", value, owner="gauge")
    check_positive("x", value, owner="gauge")
    check_at_least("x", value, 1, owner="gauge")
    check_between("x", value, 1, 2, owner="gauge")


def test_a_tensor_is_shown_by_its_range() -> None:
    with pytest.raises(ValueError, match=re.escape("got a tensor with values -2..3.")):
        check_positive("x", torch.tensor([3.0, -2.0]), owner="gauge")


def test_an_empty_tensor_has_no_wrong_value() -> None:
    check_positive("x", torch.empty(0), owner="gauge")


def test_library_errors_are_no_value_errors_and_warnings_can_be_filtered() -> None:
    assert not issubclass(TorchweatherError, ValueError)
    assert issubclass(TorchweatherWarning, UserWarning)
