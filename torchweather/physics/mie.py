"""Mie efficiencies of homogeneous spheres: extinction, scattering, backscatter, asymmetry."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor

from torchweather.core.arguments import check_arguments, check_broadcast
from torchweather.core.errors import InputValueError, check_between, check_positive
from torchweather.physics.float64 import Quantity, to_complex128, to_float64

__all__ = ["MieEfficiencies", "mie_coefficients", "mie_efficiencies", "mie_scattered_power"]

Real = npt.NDArray[np.float64]
Complex = npt.NDArray[np.complex128]

# Water at radio frequencies has 9, metals have below 100; squares of smaller size parameters underflow.
_INDEX_MAX, _SIZE_PARAMETER_MIN = 1e3, 1e-12
SIZE_PARAMETER_MAX = 1e5  # tested to 3e4; beyond, the series is too slow to be wanted
_BLOCK_ELEMENTS = 1_000_000  # orders times sizes that one block of the series holds in memory
_BUCKET_RATIO = 1.7  # sizes within this ratio share a block: small spheres do not pay for the orders of large ones


class MieEfficiencies(NamedTuple):
    """Efficiencies of a sphere: cross-section over ``pi r^2``; float64, of the broadcast shape of the arguments."""

    q_ext: Tensor
    """Extinction: scattering plus absorption."""
    q_sca: Tensor
    """Scattering."""
    q_back: Tensor
    """Backscatter as a radar cross-section, ``4 pi dC_sca/dOmega(180 deg) / (pi r^2)`` (Bohren & Huffman)."""
    g: Tensor
    """Asymmetry: mean cosine of the scattering angle."""


def mie_efficiencies(size_parameter: Quantity, refractive_index: complex | Tensor) -> MieEfficiencies:
    r"""Extinction, scattering and backscatter efficiencies and asymmetry of a sphere in air.

    ``Q_ext = 2/x^2 sum (2n+1) Re(a_n + b_n)``, ``Q_sca = 2/x^2 sum (2n+1)(|a_n|^2 + |b_n|^2)``,
    ``Q_back = |sum (2n+1)(-1)^n (a_n - b_n)|^2 / x^2``.

    Args:
        size_parameter: ``x = pi D / lambda`` (D the *diameter*), above 0, any shape, also empty.
        refractive_index: ``n + i k`` with ``k >= 0``, a number or a tensor that broadcasts against ``size_parameter``.

    Returns:
        ``MieEfficiencies(q_ext, q_sca, q_back, g)``, float64, on the device of the tensor arguments.

    Note:
        Tested from x = 1e-3 to 3e4: 1e-9 relative on Q_ext, Q_sca and g, 1e-5 on Q_back (its sum cancels). The
        recurrences run over thousands of orders one after the other, so the series is summed on the CPU in float64,
        vectorised over the sizes, and the result is moved to the device; it carries no gradient.

    References:
        PHYSICS.md 3.1; Bohren & Huffman 1983, chapter 4; Wiscombe 1980.

    Example:
        >>> q = mie_efficiencies(5.212819668567135, 1.55)  # Bohren & Huffman, appendix A
        >>> [round(float(v), 5) for v in (q.q_ext, q.q_sca, q.q_back)]
        [3.10543, 3.10543, 2.92534]
    """
    check_arguments("mie_efficiencies(size_parameter: Quantity)", size_parameter)
    x, m, device = _checked(size_parameter, refractive_index, "mie_efficiencies")
    shape = x.shape
    x, m = x.ravel(), m.ravel()
    out = np.empty((4, x.size))
    order = np.argsort(x, kind="stable")
    start = 0
    while start < x.size:
        stop = int(np.searchsorted(x[order], x[order[start]] * _BUCKET_RATIO, side="right"))
        stop = max(start + 1, min(stop, start + int(_BLOCK_ELEMENTS / _orders(x[order[stop - 1]]))))
        block = order[start:stop]
        out[:, block] = _sums(x[block], m[block])
        start = stop
    return MieEfficiencies(*(torch.from_numpy(row.reshape(shape).copy()).to(device) for row in out))


def mie_coefficients(size_parameter: float, refractive_index: complex) -> tuple[Tensor, Tensor]:
    """Scattering coefficients ``a_n, b_n`` of one sphere, complex128, ``(N,)``, n from 1.

    Args:
        size_parameter: ``x = pi D / lambda``, above 0.
        refractive_index: ``n + i k`` with ``k >= 0``.

    References:
        PHYSICS.md 3.1; Bohren & Huffman 1983, equation 4.88.

    Example:
        >>> a, b = mie_coefficients(3.0, 1.33 + 1e-8j)
        >>> print(f"{complex(a[0]):.5f} {complex(b[0]):.5f}")
        0.51631-0.49973j 0.73767-0.43990j
    """
    check_arguments("mie_coefficients(size_parameter: float)", size_parameter)
    x, m, _ = _checked(size_parameter, refractive_index, "mie_coefficients")
    if x.size != 1:
        raise InputValueError(f"mie_coefficients: expected one sphere; got shape {x.shape}.")
    a, b = _coefficients(x.reshape(1), m.reshape(1))
    return torch.from_numpy(a[1:, 0].copy()), torch.from_numpy(b[1:, 0].copy())


def mie_scattered_power(size_parameter: Real, refractive_index: complex, angle_rad: Real) -> tuple[Real, Real]:
    """Power that spheres scatter, in all and into each direction, per unit of irradiance and in units of ``1/k^2``.

    ``(|S1|^2 + |S2|^2) / 2`` per steradian, with ``S1 = sum (2n+1)/(n(n+1)) (a_n pi_n + b_n tau_n)`` and S2 the same
    with pi_n and tau_n exchanged; unpolarised light.

    Args:
        size_parameter: ``x = pi D / lambda``, ``(K,)``.
        refractive_index: ``n + i k`` with ``k >= 0``, of all spheres.
        angle_rad: scattering angles, ``(A,)``.

    Returns:
        ``(K,)`` in all, and ``(K, A)`` per steradian.

    References:
        Bohren & Huffman 1983, equations 4.46, 4.47 and 4.74.

    Example:
        >>> whole, ahead = mie_scattered_power(np.array([0.01]), 1.33, np.array([0.0]))
        >>> round(float(ahead[0, 0] / whole[0] * 8 * np.pi / 3), 4)  # Rayleigh: 3 / (8 pi) onward
        1.0
    """
    x, m, _ = _checked(torch.from_numpy(np.asarray(size_parameter, float)), refractive_index, "mie_scattered_power")
    whole, per_sr = np.empty(x.size), np.empty((x.size, len(angle_rad)))
    order = np.argsort(x, kind="stable")
    pi, tau = _angular_functions(np.cos(angle_rad), int(_orders(x.max())))
    for block in np.array_split(order, max(1, x.size // 64)):
        a, b = (values[1:] for values in _coefficients(x[block], m[block]))
        n = np.arange(1.0, len(a) + 1.0)[:, None]
        weight = (2.0 * n + 1.0) / (n * (n + 1.0))
        a_pi, b_pi = ((weight * one).T @ pi[: len(a)] for one in (a, b))
        a_tau, b_tau = ((weight * one).T @ tau[: len(a)] for one in (a, b))
        per_sr[block] = 0.5 * (_squared(a_pi + b_tau) + _squared(a_tau + b_pi))
        whole[block] = 2.0 * np.pi * ((2.0 * n + 1.0) * (_squared(a) + _squared(b))).sum(0)
    return whole, per_sr


def _angular_functions(cosine: Real, last: int) -> tuple[Real, Real]:
    """``pi_n`` and ``tau_n`` for n = 1..last, ``(last, A)`` each (Bohren & Huffman 1983, equation 4.47)."""
    pi, tau = np.empty((last, cosine.size)), np.empty((last, cosine.size))
    before, now = np.zeros_like(cosine), np.ones_like(cosine)
    for n in range(1, last + 1):
        pi[n - 1], tau[n - 1] = now, n * cosine * now - (n + 1) * before
        before, now = now, ((2 * n + 1) * cosine * now - (n + 1) * before) / n
    return pi, tau


def _checked(size_parameter: Any, refractive_index: Any, owner: str) -> tuple[Real, Complex, torch.device]:
    tensors = [v for v in (size_parameter, refractive_index) if isinstance(v, Tensor)]
    device = tensors[0].device if tensors else torch.device("cpu")
    size, index = (*to_float64(size_parameter), *to_complex128(refractive_index))
    check_broadcast(owner, size_parameter=size, refractive_index=index)
    x, m = np.broadcast_arrays(size.detach().cpu().numpy(), index.detach().cpu().numpy())
    if x.size:
        check_positive("size_parameter", torch.from_numpy(x.copy()), owner=owner)
        check_between("size_parameter", torch.from_numpy(x.copy()), 0.0, SIZE_PARAMETER_MAX, owner=owner)
        check_positive("the real part of refractive_index", torch.from_numpy(m.real.copy()), owner=owner)
        if not np.isfinite(m).all() or float(np.abs(m).max()) > _INDEX_MAX:
            raise InputValueError(
                f"{owner}: refractive_index must be finite and at most {_INDEX_MAX:g}; got {complex(m.flat[0])}."
            )
        if float(x.min()) < _SIZE_PARAMETER_MIN:
            raise InputValueError(
                f"{owner}: size_parameter must be {_SIZE_PARAMETER_MIN:g} or more; got {float(x.min()):g}. Smaller "
                "spheres are Rayleigh's."
            )
        if not bool((m.imag >= 0).all()):
            raise InputValueError(f"{owner}: refractive_index must be n + i k with k >= 0 (not n - i k); got k < 0.")
    return x, m, device


def _orders(x: Any) -> Any:
    """Number of terms: Wiscombe's x + 4.05 x^(1/3) + 2 and some to spare."""
    return np.floor(x + 4.05 * np.cbrt(x) + 10.0).astype(np.int64)


def _ratios_downward(z: Any, top: int, last: int, first: int = 0) -> Any:
    """``psi_{n+1}(z) / psi_n(z)`` for n = first..last, by ``rho_{n-1} = 1 / ((2n+1)/z - rho_n)`` from n = top down."""
    out = np.empty((last - first + 1, z.size), dtype=z.dtype)
    inverse = 1.0 / z
    rho = np.zeros_like(z)
    with np.errstate(all="ignore"):  # psi_n may vanish at an argument below n, where its ratio is not used
        for n in range(top, first, -1):
            # rho_n is known, rho_{n-1} comes out
            np.subtract((2 * n + 1) * inverse, rho, out=rho)
            np.divide(1.0, rho, out=rho)
            if n - 1 <= last:
                out[n - 1 - first] = rho
    return out


def _coefficients(x: Real, m: Any) -> tuple[Complex, Complex]:
    """``a_n, b_n`` for n = 0..N of spheres of similar size, ``(N + 1, S)``; 0 above each sphere's own N.

    Written with ``rho_n(z) = psi_{n+1}/psi_n`` in place of the logarithmic derivative ``D_n = (n+1)/z - rho_n``: the
    terms (n+1)/x, which cancel in b_n, are then gone, and spheres as small as x = 1e-3 keep all their digits.
    """
    own = _orders(x)
    last = int(own.max())
    if not m.imag.any():
        m = m.real
    mx = m * x
    size = float(np.abs(mx).max())
    # Starting lower is not enough for nearly real m: Q_back is off by 5 % and more at x = 1e4 (PHYSICS.md 3.1).
    top = int(max(last, size) + 40.0 + 8.0 * np.cbrt(size))
    inside = _ratios_downward(mx, top, last)
    psi, chi = _riccati_bessel(x, last)
    n = np.arange(last + 1)[:, None]
    with np.errstate(all="ignore"):
        over_x = (n + 1) / x
        electric = over_x * (1.0 / m**2 - 1.0) - inside / m
        magnetic = -m * inside
        a, b = (_ratio(factor * psi[:-1] + psi[1:], factor * chi[:-1] + chi[1:]) for factor in (electric, magnetic))
    beyond = (n > own) | (n == 0)
    a[beyond] = 0.0
    b[beyond] = 0.0
    return a, b


def _ratio(regular: Any, irregular: Any) -> Complex:
    """``p / (p - i q)``: xi = psi - i chi in the denominator, psi alone in the numerator."""
    if np.iscomplexobj(regular):
        return np.asarray(regular / (regular - 1j * irregular))
    # A transparent sphere: all real, and then three times as fast.
    ratio = np.empty(regular.shape, dtype=np.complex128)
    scale = regular / (regular**2 + irregular**2)
    np.multiply(scale, regular, out=ratio.real)
    np.multiply(scale, irregular, out=ratio.imag)
    return ratio


def _riccati_bessel(x: Real, last: int) -> tuple[Real, Real]:
    """``psi_n(x)`` and ``chi_n(x) = -x y_n(x)`` for n = 0..last+1, ``(last + 2, S)``.

    chi grows with n and is stable upward. psi is stable upward up to n = x; beyond it decays and follows from the
    downward ratios.
    """
    both = np.empty((last + 2, 2, x.size))
    both[0] = np.sin(x), np.cos(x)
    both[1] = both[0, 0] / x - both[0, 1], both[0, 1] / x + both[0, 0]
    inverse = 1.0 / x
    step = np.empty_like(both[0])
    with np.errstate(all="ignore"):
        for n in range(1, last + 1):
            np.multiply(both[n], (2 * n + 1) * inverse, out=step)
            np.subtract(step, both[n - 1], out=both[n + 1])
    psi, chi = both[:, 0].copy(), both[:, 1]
    turn = np.floor(x).astype(np.int64)  # the first order at which the ratios take over
    first = int(turn.min())
    top = int(max(last, float(x.max())) + 40.0 + 8.0 * float(np.cbrt(x.max())))
    rho = _ratios_downward(x, top, last, first)  # n = first..last
    order = np.arange(first, last + 1)[:, None]
    with np.errstate(all="ignore"):
        decay = np.cumprod(np.where(order >= turn, rho, 1.0), axis=0)
        at_turn = np.take_along_axis(psi, turn[None, :], axis=0)
        psi[first + 1 :] = np.where(order >= turn, at_turn * decay, psi[first + 1 :])
    return psi, chi


def _sums(x: Real, m: Complex) -> Real:
    """Q_ext, Q_sca, Q_back, g of spheres of similar size, ``(4, S)``."""
    a, b = _coefficients(x, m)
    a, b = a[1:], b[1:]
    n = np.arange(1.0, a.shape[0] + 1.0)[:, None]
    weight = 2.0 * n + 1.0
    q_ext = 2.0 / x**2 * (weight * (a.real + b.real)).sum(0)
    q_sca = 2.0 / x**2 * (weight * (_squared(a) + _squared(b))).sum(0)
    sign = np.where(n % 2 == 0, weight, -weight)
    q_back = _squared((sign * (a - b)).sum(0)) / x**2
    neighbours = (n * (n + 2.0) / (n + 1.0))[:-1] * (_dot(a[:-1], a[1:]) + _dot(b[:-1], b[1:]))
    same = weight / (n * (n + 1.0)) * _dot(a, b)
    g = 4.0 / x**2 * (neighbours.sum(0) + same.sum(0)) / np.where(q_sca > 0, q_sca, 1.0)  # 0 for a sphere of m = 1
    return np.stack([q_ext, q_sca, q_back, g])


def _squared(z: Complex) -> Real:
    return z.real**2 + z.imag**2


def _dot(a: Complex, b: Complex) -> Real:
    """``Re(a b*)``."""
    return a.real * b.real + a.imag * b.imag
