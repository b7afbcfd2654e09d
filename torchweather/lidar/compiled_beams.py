"""Compiled beams of a LiDAR: from the drawn numbers to the points that go out, one beam after the other.

The same formulas as the stages ``ToEnergy``, ``Extinction``, ``ParticleReturns``, ``Detection`` and ``ToPoints``, with
polynomials for exp and ln (relative error below 2e-7). Blocks of beams
are worked on, whose echoes stay in the cache.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from torchweather.core.compiled import jit
from torchweather.core.compiled_math import exp_of, log_of_sum
from torchweather.lidar.returns.compiled_echoes import Part, write_echoes
from torchweather.pipeline.point_kind import PointKind

__all__ = ["UNITS", "Cloud", "Drawn", "Out", "Receiver", "weather_beams"]

Array = NDArray[np.float32]

ZERO, HALF, ONE = np.float32(0), np.float32(0.5), np.float32(1)
PI = np.float32(np.pi)
HUNDRED, FULL_8_BITS = np.float32(100), np.float32(255)
INFINITE, FAINTEST_GAIN = np.float32(np.inf), np.float32(1e-30)

BLOCK = 512  # beams whose echoes stay in the cache

UNITS = {"photons": 0, "none": 1, "reflectivity": 2, "reflectivity_percent": 3, "uint8_linear": 4}
UNITS["uint8_calibrated"] = 5
"""Numbers of the units of intensity."""
PHOTONS, NONE, REFLECTIVITY, LINEAR_8_BITS, CALIBRATED = 0, 1, 2, 4, 5

OBJECT, PARTICLE, LOST = (np.int8(kind) for kind in (PointKind.OBJECT, PointKind.PARTICLE, PointKind.LOST))


class Out(NamedTuple):
    """Arrays that are written.

    Args:
        points: ``(N, C)``.
        second: ``(N, C)`` second returns; ``(0, 0)``: not wanted.
        clear_signal: ``(N,)``.
        range_m, signal: ``(N, reported)``.
        kind: ``(N, reported)``.
    """

    points: Array
    second: Array
    clear_signal: Array
    range_m: Array
    signal: Array
    kind: NDArray[np.int8]


class Cloud(NamedTuple):
    """The cloud of one sample.

    Args:
        points: ``(N, C)``.
        direction: ``(N, 3)`` of beams without return; ``(0, 0)``: not known.
        range_m: ``(N,)`` of the objects, 0 without one.
        reach_m: ``(N,)`` up to which particles count.
        borrowed: ``(N,)`` intensity of a particle; ``(0,)``: from its signal.
        integral: 1 where intensities are integers.
        zero_intensity: what an intensity of 0 stands for.
        extinction_per_m: of all weather.
    """

    points: Array
    direction: Array
    range_m: Array
    reach_m: Array
    borrowed: Array
    integral: np.float32
    zero_intensity: np.float32
    extinction_per_m: np.float32


class Drawn(NamedTuple):
    """Numbers of one sample that belong to no particle.

    Args:
        margin: ``(N,)`` probability of a smaller one.
        range_noise: ``(reported, N)``; ``(0, 0)``: none.
    """

    margin: Array
    range_noise: Array


class Receiver(NamedTuple):
    """The sensor, in single precision.

    Args:
        threshold: signal that is detected.
        mean_margin: of a return's signal over it, ln.
        near_start_m, near_full_m, near_power: near-range response.
        least_ramp: of the response, so that margins stay finite.
        full_signal: signal, times the square of the range, that ends the margin in a rising response.
        nearest_m: objects nearer than this are always reported.
        apart_m: echoes closer than this merge.
        unit: number of the unit of intensity.
        white: intensity of a white target; 0 in units without one.
        assumed: reflectivity where intensities have no meaning.
        log_step: of the calibrated scale above 100.
        least_range_m2: keeps a beam without return from dividing by 0.
        photons_at_threshold: of the unit ``photons``.
        range_noise_m, range_step_m: of a particle's range.
        mode: 0 strongest, 1 first, 2 last, 3 dual.
    """

    threshold: np.float32
    mean_margin: np.float32
    near_start_m: np.float32
    near_full_m: np.float32
    near_power: np.float32
    least_ramp: np.float32
    full_signal: np.float32
    nearest_m: np.float32
    apart_m: np.float32
    unit: int
    white: np.float32
    assumed: np.float32
    log_step: np.float32
    least_range_m2: np.float32
    photons_at_threshold: np.float32
    range_noise_m: np.float32
    range_step_m: np.float32
    mode: int


class Echoes(NamedTuple):
    """Echoes of a block of beams, the object first.

    Args:
        range_m, signal, strength: ``(echoes, BLOCK)``; strength is 0 of echoes that are not seen.
        number: ``(beams,)`` echoes of each.
        chosen: ``(2, beams)`` those that are reported, -1 for none.
    """

    range_m: Array
    signal: Array
    strength: Array
    number: NDArray[np.int32]
    chosen: NDArray[np.int32]


@jit
def _clear_signals(
    clear: Array, points: Array, range_m: Array, uniform: Array, zero_intensity: np.float32, receiver: Receiver
) -> None:
    """Write the signals of a block of objects in clear air, as ``ToEnergy``; 0 of beams without one.

    One loop a step, each without branches and on few arrays: so the processor takes several beams at once.

    Args:
        clear: ``(beams,)``, written.
        points, range_m: of the block.
        uniform: of the margin.
        zero_intensity: what an intensity of 0 stands for.
        receiver: the sensor.
    """
    count = clear.size
    spare = np.empty((3, BLOCK), np.float32)
    value, ramp, margin = spare[0], spare[1], spare[2]
    unit, threshold, mean = receiver.unit, receiver.threshold, receiver.mean_margin
    start_m, width_m = receiver.near_start_m, receiver.near_full_m - receiver.near_start_m
    least_m2, least_ramp, full, power = (
        receiver.least_range_m2,
        receiver.least_ramp,
        receiver.full_signal,
        receiver.near_power,
    )
    for at in range(count):
        given = points[at, 3]
        value[at] = zero_intensity if given == ZERO else given
    nearest_m = INFINITE
    for at in range(count):
        nearest_m = min(nearest_m, range_m[at] if range_m[at] > ZERO else INFINITE)
        ramp[at] = min(max((range_m[at] - start_m) / width_m, ZERO), ONE)
    if unit == PHOTONS:
        factor = threshold / receiver.photons_at_threshold
        for at in range(count):
            value[at] *= factor
    elif unit == NONE:
        for at in range(count):
            value[at] = receiver.assumed
    else:
        white, log_step = receiver.white, receiver.log_step
        for at in range(count):
            given = value[at]
            of_scale = given / white
            if unit == CALIBRATED and given > HUNDRED:
                of_scale = exp_of((min(given, FULL_8_BITS) - HUNDRED) * log_step)
            value[at] = of_scale
    if unit != PHOTONS:
        for at in range(count):
            response = ramp[at]
            if power != ONE and response < ONE:
                response = np.float32(response**power) if response > ZERO else ZERO
            margin[at] = response
        for at in range(count):
            value[at] = value[at] * margin[at] / max(PI * (range_m[at] * range_m[at]), least_m2)
    for at in range(count):
        margin[at] = mean * -log_of_sum(ZERO, ONE - uniform[at])
    if nearest_m < receiver.near_full_m:
        for at in range(count):
            if ramp[at] < ONE:
                drawn = -log_of_sum(ZERO, ONE - uniform[at])
                square_m2 = max(PI * (range_m[at] * range_m[at]), least_m2)
                end = max(log_of_sum(ZERO, full / square_m2 / threshold), ZERO)
                margin[at] = min(mean / max(ramp[at], least_ramp) * drawn, max(end, margin[at]))
    for at in range(count):
        margin[at] = threshold * exp_of(margin[at])
    for at in range(count):
        clear[at] = max(value[at], margin[at]) if range_m[at] > ZERO else ZERO


@jit
def _add_objects(
    echoes: Echoes, clear_signal: Array, cloud: Cloud, margin: Array, receiver: Receiver, first: int
) -> None:
    """Begin the lists of a block of beams with their objects, as ``ToEnergy`` and ``Extinction``."""
    count = echoes.number.size
    twice = np.float32(-2) * cloud.extinction_per_m
    last = first + count
    ranges, signals, clear = echoes.range_m[0], echoes.signal[0], clear_signal[first:last]
    range_m, number = cloud.range_m[first:last], echoes.number
    _clear_signals(clear, cloud.points[first:last], range_m, margin[first:last], cloud.zero_intensity, receiver)
    for at in range(count):
        ranges[at], number[at] = range_m[at], 1
    for at in range(count):
        signals[at] = clear[at] * exp_of(twice * range_m[at]) if twice < ZERO else clear[at]


@jit
def _strongest(strength: Array, at: int, count: int) -> int:
    """The first of the strongest echoes; -1 where none is seen."""
    found, best = -1, ZERO
    for echo in range(count):
        if strength[echo, at] > best:
            found, best = echo, strength[echo, at]
    return found


@jit
def _end(range_m: Array, strength: Array, at: int, count: int, apart_m: np.float32, is_first: bool) -> int:
    """The first or the last echo, of those that are not part of a stronger one; -1 where none is seen."""
    found = -1
    for echo in range(count):
        if not strength[echo, at] > ZERO:
            continue
        absorbed = False
        for other in range(count):
            if other == echo or not abs(range_m[other, at] - range_m[echo, at]) < apart_m:
                continue
            # Of two equal echoes the earlier in the list counts as the stronger.
            ahead = strength[other, at] - strength[echo, at]
            if ahead > ZERO or (other < echo and ahead == ZERO):
                absorbed = True
        if absorbed:
            continue
        if found < 0 or (range_m[echo, at] < range_m[found, at]) == is_first:
            found = echo
    return found


@jit
def _choose(echoes: Echoes, clear_m: Array, receiver: Receiver, first: int) -> None:
    """Choose the reported echoes of a block of beams, as ``Detection``."""
    strength, range_m = echoes.strength, echoes.range_m
    signals, counts, chosen = echoes.signal, echoes.number, echoes.chosen
    beams, threshold, nearest_m = counts.size, receiver.threshold, receiver.nearest_m
    own_m, best, found = clear_m[first : first + beams], strength[0], chosen[0]
    for at in range(beams):
        signal = signals[0, at]
        # Nothing lies in front of an object that near; one without any signal was taken away.
        near = own_m[at] > ZERO and own_m[at] < nearest_m and signal > ZERO
        best[at] = INFINITE if near else (signal if signal >= threshold else ZERO)
        found[at] = 0 if best[at] > ZERO else -1
    if receiver.mode == 0:
        for at in range(beams):
            for echo in range(1, counts[at]):
                signal = signals[echo, at]
                if signal >= threshold and signal > best[at]:
                    best[at], found[at] = signal, echo
        return
    for at in range(beams):
        count = counts[at]
        for echo in range(1, count):
            signal = signals[echo, at]
            strength[echo, at] = signal if signal >= threshold else ZERO
        strongest = _strongest(strength, at, count)
        end = strongest
        if count > 1:
            end = _end(range_m, strength, at, count, receiver.apart_m, receiver.mode == 1)
        chosen[0, at] = strongest if receiver.mode == 3 else end
        if receiver.mode == 3:
            # One echo is reported once: a beam whose strongest echo is its last has no second return.
            again = end >= 0 and range_m[end, at] == range_m[strongest, at]
            chosen[1, at] = -1 if again else end


@jit
def _calibrated(reflectivity: np.float32, receiver: Receiver) -> np.float32:
    """Value of the calibrated scale."""
    if reflectivity > ONE:
        return HUNDRED + log_of_sum(ZERO, reflectivity) / receiver.log_step
    return reflectivity * receiver.white


@jit
def _of_particle(signal: np.float32, range_m: np.float32, is_integral: bool, receiver: Receiver) -> np.float32:
    """Intensity of a particle, as ``intensity_from_signal``."""
    if receiver.unit == PHOTONS:
        value = signal * (receiver.photons_at_threshold / receiver.threshold)
    else:
        reflectivity = PI * signal * (range_m * range_m)
        value = _calibrated(reflectivity, receiver) if receiver.unit == CALIBRATED else reflectivity * receiver.white
    if is_integral and receiver.unit != REFLECTIVITY:
        value = np.floor(value)
        if receiver.unit >= LINEAR_8_BITS:
            value = min(value, FULL_8_BITS)
    return value


@jit
def _dimmed(intensity: np.float32, gain: np.float32, is_integral: bool, receiver: Receiver) -> np.float32:
    """Intensity of a dimmed object, as ``dimmed_intensity``."""
    if receiver.unit == NONE or gain == ONE:
        return intensity
    is_counted = is_integral and receiver.unit != REFLECTIVITY
    middle = intensity + HALF if is_counted else intensity
    value = middle * gain
    if receiver.unit == CALIBRATED and middle > HUNDRED:
        value = middle + log_of_sum(ZERO, max(gain, FAINTEST_GAIN)) / receiver.log_step
        if not value > HUNDRED:
            value = HUNDRED * exp_of((value - HUNDRED) * receiver.log_step)
    if is_counted:
        value = np.floor(value)
        if receiver.unit >= LINEAR_8_BITS:
            value = min(value, FULL_8_BITS)
    return value


@jit
def _report(
    out: Out, points: Array, echoes: Echoes, noise: Array, cloud: Cloud, receiver: Receiver, number: int, first: int
) -> None:
    """Write one of the reported echoes of a block of beams and its points, as ``ToPoints``."""
    beams, columns = echoes.number.size, cloud.points.shape[1]
    last = first + beams
    given, written, cloud_m = cloud.points[first:last], points[first:last], cloud.range_m[first:last]
    kinds, ranges, signals = out.kind[first:last], out.range_m[first:last], out.signal[first:last]
    chosen, echo_m, echo_signal, clear_signal = (
        echoes.chosen[number],
        echoes.range_m,
        echoes.signal,
        out.clear_signal[first:last],
    )
    is_integral, unit = bool(cloud.integral > ZERO), receiver.unit
    direction, borrowed = cloud.direction, cloud.borrowed
    from_rows, to_rows = given.reshape(beams * columns), written.reshape(beams * columns)
    for place in range(beams * columns):
        to_rows[place] = from_rows[place]
    others, changed = 0, np.empty(BLOCK, np.int32)
    spare = np.empty((2, BLOCK), np.float32)
    gain, value = spare[0], spare[1]
    for at in range(beams):
        echo = chosen[at]
        seen = max(echo, 0)
        ranges[at, number] = echo_m[seen, at] if echo >= 0 else ZERO
        signals[at, number] = echo_signal[seen, at] if echo >= 0 else ZERO
        kinds[at, number] = LOST if echo < 0 else (OBJECT if echo == 0 else PARTICLE)
        changed[others] = at
        others += 1 if echo != 0 else 0
    if unit != NONE:
        for at in range(beams):
            value[at] = given[at, 3]
        for at in range(beams):
            gain[at] = echo_signal[0, at] / clear_signal[at]
        if unit == CALIBRATED:
            for at in range(beams):
                gain[at] = _dimmed(value[at], gain[at], is_integral, receiver) if chosen[at] == 0 else ZERO
        elif is_integral and unit != REFLECTIVITY:
            most = FULL_8_BITS if unit >= LINEAR_8_BITS else INFINITE
            for at in range(beams):
                dimmed = min(np.floor((value[at] + HALF) * gain[at]), most)
                gain[at] = value[at] if gain[at] == ONE else dimmed
        else:
            for at in range(beams):
                gain[at] *= value[at]
        for at in range(beams):
            written[at, 3] = gain[at] if chosen[at] == 0 else value[at]
    for place in range(others):
        at = changed[place]
        beam, echo, clear_m = first + at, chosen[at], cloud_m[at]
        if echo < 0:
            # A beam that was empty and stayed so keeps what it came with.
            for column in range(4 if clear_m > ZERO else 0):
                written[at, column] = ZERO
            continue
        range_m, signal = echo_m[echo, at], echo_signal[echo, at]
        if receiver.range_noise_m > ZERO:
            range_m = max(range_m + receiver.range_noise_m * noise[number, beam], ZERO)
        if receiver.range_step_m > ZERO:
            range_m = np.rint(range_m / receiver.range_step_m) * receiver.range_step_m
        scale = range_m / clear_m if clear_m > ZERO else range_m
        for column in range(3):
            written[at, column] = (given[at, column] if clear_m > ZERO else direction[beam, column]) * scale
        if borrowed.size > 0:
            written[at, 3] = borrowed[beam]
        else:
            written[at, 3] = _of_particle(signal, range_m, is_integral, receiver)


@jit
def weather_beams(
    out: Out,
    cloud: Cloud,
    drawn: Drawn,
    first_part: Part,
    second_part: Part,
    third_part: Part,
    receiver: Receiver,
    first: int,
    last: int,
) -> None:
    """Write the beams ``first..last`` of one cloud.

    Args:
        out: written.
        cloud, drawn: of one sample.
        first_part, second_part, third_part: kinds of weather.
        receiver: the sensor.
        first, last: beams.
    """
    most = 1 + first_part.arrival.shape[0] + second_part.arrival.shape[0] + third_part.arrival.shape[0]
    maps = np.empty((3, most, BLOCK), np.float32)
    counts, chosen = np.empty(BLOCK, np.int32), np.empty((2, BLOCK), np.int32)
    no_density = np.empty(0, np.float32)
    for begin in range(first, last, BLOCK):
        some = min(BLOCK, last - begin)
        echoes = Echoes(maps[0], maps[1], maps[2], counts[:some], chosen)
        _add_objects(echoes, out.clear_signal, cloud, drawn.margin, receiver, begin)
        for part in (first_part, second_part, third_part):
            write_echoes(
                echoes.range_m,
                echoes.signal,
                echoes.number,
                cloud.reach_m,
                no_density,
                part,
                True,
                receiver.threshold,
                begin,
                begin + some,
                begin,
            )
        _choose(echoes, cloud.range_m, receiver, begin)
        _report(out, out.points, echoes, drawn.range_noise, cloud, receiver, 0, begin)
        if receiver.mode == 3:
            _report(out, out.second, echoes, drawn.range_noise, cloud, receiver, 1, begin)
