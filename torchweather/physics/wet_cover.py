r"""Loss of a film of water on a cover in front of an antenna, in rain and while it dries.

Rain of rate R makes a film that costs ``film_db (R / 1 mm/h)^film_exponent``; with a share w of it there, a rain that
has stopped for t leaves ``w = exp(-t / drying_min)``. Of several rains the one that left most counts:

    loss(t) = loss_db + film_db max over s <= t of (R(s) / 1 mm/h)^film_exponent exp(-(t - s) / drying_min)

While the rain lasts or grows that is the film of its rate. A radar loses this on the way out and back together, a
microwave link at both of its ends together.

References:
    PHYSICS.md 6.7. The exponential drying: Schleiss, Rieckermann and Berne 2013, IEEE Geosci. Remote Sens. Lett. 10,
    1195 (38 GHz, at most 2.3 dB; abstract seen).
"""

from __future__ import annotations

import torch
from torch import Tensor

from torchweather.core.arguments import check_arguments, check_broadcast
from torchweather.core.errors import InputTypeError, InputValueError, check_at_least, check_between
from torchweather.physics.float64 import to_float64

__all__ = ["wet_cover_loss_db", "wet_cover_series_db"]

Value = float | Tensor


def wet_cover_loss_db(
    rain_mm_per_h: Tensor,
    age_min: Tensor,
    loss_db: Value,
    film_db: Value,
    film_exponent: Value,
    drying_min: Value,
) -> Tensor:
    """Present loss of the cover from the rain of now and of before, dB.

    Args:
        rain_mm_per_h: ``(..., T)`` rates, 0 or more.
        age_min: ``(..., T)`` how long ago each was, minutes; 0 is now.
        loss_db: of a film that does not depend on the rain; this and the following broadcast over ``(...)``.
        film_db: of the film at 1 mm/h.
        film_exponent: of the rate.
        drying_min: minutes in which a film dries to 1 / e.

    Returns:
        ``(...)``.

    Example:
        >>> rain, age = torch.tensor([8.0, 0.0]), torch.tensor([10.0, 0.0])
        >>> wet_cover_loss_db(rain, age, 0.5, 1.0, 1.0 / 3.0, 10.0)
        tensor(1.2358)
    """
    check_arguments(
        "wet_cover_loss_db(rain_mm_per_h: floating(..., 1+), age_min: real(..., 1+), loss_db: Quantity, "
        "film_db: Quantity, film_exponent: Quantity, drying_min: Quantity)",
        rain_mm_per_h,
        age_min,
        loss_db,
        film_db,
        film_exponent,
        drying_min,
    )
    check_broadcast("wet_cover_loss_db", rain_mm_per_h=rain_mm_per_h, age_min=age_min)
    _check_over_time("wet_cover_loss_db", rain_mm_per_h, loss_db, film_db, film_exponent, drying_min)
    check_at_least("age_min", age_min, 0.0, unit="min", owner="wet_cover_loss_db")
    loss_db, film_db = (_over_time(value, rain_mm_per_h)[..., 0] for value in (loss_db, film_db))
    dry = _over_time(drying_min, rain_mm_per_h)
    wet = torch.exp(_log_wetness(rain_mm_per_h, film_exponent) - age_min.to(rain_mm_per_h) / dry).amax(-1)
    return loss_db + film_db * wet


def wet_cover_series_db(
    rain_mm_per_h: Tensor,
    time_min: Tensor,
    loss_db: Value,
    film_db: Value,
    film_exponent: Value,
    drying_min: Value,
) -> Tensor:
    """Loss of the cover at each time of a series of rain, dB.

    Args:
        rain_mm_per_h: ``(..., T)`` rates, 0 or more.
        time_min: ``(T,)`` rising, minutes.
        loss_db, film_db, film_exponent, drying_min: as in ``wet_cover_loss_db``.

    Returns:
        ``(..., T)``.

    Example:
        >>> rain, time = torch.tensor([0.0, 8.0, 8.0, 0.0, 0.0]), torch.arange(5.0)
        >>> wet_cover_series_db(rain, time, 0.0, 1.0, 1.0 / 3.0, 1.0)
        tensor([0.0000, 2.0000, 2.0000, 0.7358, 0.2707])
    """
    check_arguments("wet_cover_series_db(rain_mm_per_h: floating(..., T), time_min: real(T))", rain_mm_per_h, time_min)
    _check_over_time("wet_cover_series_db", rain_mm_per_h, loss_db, film_db, film_exponent, drying_min)
    # A running maximum of logarithms that grow with time: double precision, for series of many drying times.
    rain = rain_mm_per_h.double()
    elapsed = (time_min.double() - time_min.double()[..., :1]) / _over_time(drying_min, rain)
    log_wet = (_log_wetness(rain, film_exponent) + elapsed).cummax(-1).values - elapsed
    loss = _over_time(loss_db, rain) + _over_time(film_db, rain) * log_wet.exp()
    return loss.to(rain_mm_per_h.dtype)


def _check_over_time(owner: str, rain_mm_per_h: Tensor, *values: Value) -> None:
    """Values ``(...)`` that broadcast over rates ``(..., T)``."""
    names = ("loss_db", "film_db", "film_exponent", "drying_min")
    check_arguments(f"{owner}({', '.join(f'{name}: Quantity' for name in names)})", *values)
    check_at_least("rain_mm_per_h", rain_mm_per_h, 0.0, unit="mm/h", owner=owner)
    check_between("film_exponent", to_float64(values[2])[0], 0.0, 5.0, owner=owner)
    check_between("drying_min", to_float64(values[3])[0], 1e-3, 1e6, unit="min", owner=owner)
    check_broadcast(owner, rain_at_one_time=rain_mm_per_h[..., :1].squeeze(-1), **dict(zip(names, values, strict=True)))


def _log_wetness(rain_mm_per_h: Tensor, film_exponent: Value) -> Tensor:
    """``ln R^e`` of each rate, minus infinity without rain."""
    raining = rain_mm_per_h > 0
    log_film = _over_time(film_exponent, rain_mm_per_h) * torch.where(raining, rain_mm_per_h, 1.0).log()
    return torch.where(raining, log_film, -torch.inf)


def _over_time(value: Value, like: Tensor) -> Tensor:
    """A value shaped to broadcast over times ``(..., T)``."""
    check_arguments("wet_cover(value: Quantity)", value)
    try:
        check_between("value", torch.as_tensor(value), -1e3, 1e3, owner="wet_cover")
        return torch.as_tensor(value, dtype=like.dtype, device=like.device)[..., None]
    except InputValueError:
        raise
    except (TypeError, ValueError, RuntimeError, OverflowError) as error:
        raise InputTypeError(f"wet_cover: expected a number or a tensor of numbers; got {value!r:.100}.") from error
