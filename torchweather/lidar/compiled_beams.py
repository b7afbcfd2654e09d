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
        range_m, signal, strength: ``(beams, echoes)``; strength is 0 of echoes that are not seen.
        number: ``(beams,)`` echoes of each.
        chosen: ``(beams, 2)`` those that are reported, -1 for none.
    """

    range_m: Array
    signal: Array
    strength: Array
    number: NDArray[np.int32]
    chosen: NDArray[np.int32]


@jit
def _clear_signal(
    given: np.float32, range_m: np.float32, uniform: np.float32, zero_intensity: np.float32, receiver: Receiver
) -> np.float32:
    """Signal of an object in clear air, as ``ToEnergy``."""
    if given == ZERO:
        given = zero_intensity
    square_m2 = max(PI * (range_m * range_m), receiver.least_range_m2)
    ramp = (range_m - receiver.near_start_m) / (receiver.near_full_m - receiver.near_start_m)
    ramp = min(max(ramp, ZERO), ONE)
    if receiver.unit == PHOTONS:
        signal = given * (receiver.threshold / receiver.photons_at_threshold)
    else:
        if receiver.unit == NONE:
            reflectivity = receiver.assumed
        elif receiver.unit == CALIBRATED and given > HUNDRED:
            reflectivity = exp_of((min(given, FULL_8_BITS) - HUNDRED) * receiver.log_step)
        else:
            reflectivity = given / receiver.white
        response = ramp
        if ramp < ONE and receiver.near_power != ONE:
            response = np.float32(ramp**receiver.near_power) if ramp > ZERO else ZERO
        signal = reflectivity * response / square_m2
    drawn = -log_of_sum(ZERO, ONE - uniform)
    margin = receiver.mean_margin * drawn
    if ramp < ONE:
        end = max(log_of_sum(ZERO, receiver.full_signal / square_m2 / receiver.threshold), ZERO)
        margin = min(receiver.mean_margin / max(ramp, receiver.least_ramp) * drawn, max(end, margin))
    return max(signal, receiver.threshold * exp_of(margin))


@jit
def _add_objects(
    echoes: Echoes, clear_signal: Array, cloud: Cloud, margin: Array, receiver: Receiver, first: int
) -> None:
    """Begin the lists of a block of beams with their objects, as ``ToEnergy`` and ``Extinction``."""
    twice = np.float32(-2) * cloud.extinction_per_m
    points, range_m, zero = cloud.points, cloud.range_m, cloud.zero_intensity
    ranges, signals, counts = echoes.range_m, echoes.signal, echoes.number
    for at in range(counts.size):
        beam = first + at
        clear_m, signal = range_m[beam], ZERO
        ranges[at, 0], signals[at, 0], counts[at] = clear_m, ZERO, 1
        if clear_m > ZERO:
            signal = _clear_signal(points[beam, 3], clear_m, margin[beam], zero, receiver)
            signals[at, 0] = signal * exp_of(twice * clear_m) if twice < ZERO else signal
        clear_signal[beam] = signal


@jit
def _strongest(strength: Array, at: int, count: int) -> int:
    """The first of the strongest echoes; -1 where none is seen."""
    found, best = -1, ZERO
    for echo in range(count):
        if strength[at, echo] > best:
            found, best = echo, strength[at, echo]
    return found


@jit
def _end(range_m: Array, strength: Array, at: int, count: int, apart_m: np.float32, is_first: bool) -> int:
    """The first or the last echo, of those that are not part of a stronger one; -1 where none is seen."""
    found = -1
    for echo in range(count):
        if not strength[at, echo] > ZERO:
            continue
        absorbed = False
        for other in range(count):
            if other == echo or not abs(range_m[at, other] - range_m[at, echo]) < apart_m:
                continue
            # Of two equal echoes the earlier in the list counts as the stronger.
            ahead = strength[at, other] - strength[at, echo]
            if ahead > ZERO or (other < echo and ahead == ZERO):
                absorbed = True
        if absorbed:
            continue
        if found < 0 or (range_m[at, echo] < range_m[at, found]) == is_first:
            found = echo
    return found


@jit
def _choose(echoes: Echoes, clear_m: Array, receiver: Receiver, first: int) -> None:
    """Choose the reported echoes of a block of beams, as ``Detection``."""
    strength, range_m = echoes.strength, echoes.range_m
    signals, counts, chosen = echoes.signal, echoes.number, echoes.chosen
    for at in range(counts.size):
        count = counts[at]
        for echo in range(count):
            signal = signals[at, echo]
            strength[at, echo] = signal if signal >= receiver.threshold else ZERO
        # Nothing lies in front of an object that near; one without any signal was taken away.
        own_m = clear_m[first + at]
        if own_m > ZERO and own_m < receiver.nearest_m and signals[at, 0] > ZERO:
            strength[at, 0] = INFINITE
        strongest = _strongest(strength, at, count)
        end = strongest
        if receiver.mode > 0 and count > 1:
            end = _end(range_m, strength, at, count, receiver.apart_m, receiver.mode == 1)
        chosen[at, 0] = strongest if receiver.mode == 3 else end
        if receiver.mode == 3:
            # One echo is reported once: a beam whose strongest echo is its last has no second return.
            again = end >= 0 and range_m[at, end] == range_m[at, strongest]
            chosen[at, 1] = -1 if again else end


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
    given, is_integral = cloud.points, bool(cloud.integral > ZERO)
    columns = given.shape[1]
    cloud_m, direction, borrowed, clear_signal = cloud.range_m, cloud.direction, cloud.borrowed, out.clear_signal
    kinds, ranges, signals = out.kind, out.range_m, out.signal
    chosen, echo_m, echo_signal = echoes.chosen, echoes.range_m, echoes.signal
    for at in range(echoes.number.size):
        beam, echo = first + at, chosen[at, number]
        label, range_m, signal, clear_m = LOST, ZERO, ZERO, cloud_m[beam]
        if echo >= 0:
            label = OBJECT if echo == 0 else PARTICLE
            range_m, signal = echo_m[at, echo], echo_signal[at, echo]
        kinds[beam, number], ranges[beam, number], signals[beam, number] = label, range_m, signal
        for column in range(columns):
            points[beam, column] = given[beam, column]
        if label == LOST:
            # A beam that was empty and stayed so keeps what it came with.
            for column in range(4 if clear_m > ZERO else 0):
                points[beam, column] = ZERO
            continue
        if label == OBJECT:
            gain = signal / clear_signal[beam]
            points[beam, 3] = _dimmed(given[beam, 3], gain, is_integral, receiver)
            continue
        if receiver.range_noise_m > ZERO:
            range_m = max(range_m + receiver.range_noise_m * noise[number, beam], ZERO)
        if receiver.range_step_m > ZERO:
            range_m = np.rint(range_m / receiver.range_step_m) * receiver.range_step_m
        scale = range_m / clear_m if clear_m > ZERO else range_m
        for column in range(3):
            points[beam, column] = (given[beam, column] if clear_m > ZERO else direction[beam, column]) * scale
        if borrowed.size > 0:
            points[beam, 3] = borrowed[beam]
        else:
            points[beam, 3] = _of_particle(signal, range_m, is_integral, receiver)


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
    maps = np.empty((3, BLOCK, most), np.float32)
    counts, chosen = np.empty(BLOCK, np.int32), np.empty((BLOCK, 2), np.int32)
    no_density = np.empty(0, np.float32)
    for begin in range(first, last, BLOCK):
        some = min(BLOCK, last - begin)
        echoes = Echoes(maps[0, :some], maps[1, :some], maps[2, :some], counts[:some], chosen[:some])
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
