"""Mie scattering of spheres, for many sizes and angles at once.

Source: Bohren and Huffman (1983), chapter 4 and appendix A.
"""

from __future__ import annotations

import numpy as np

from sabench.utils.arrays import C128, F64

_ROWS, _ANGLES = 512, 2048  # sizes and angles of one product of matrices


def intensities(index: complex, size_parameters: F64, angles_rad: F64) -> tuple[F64, F64]:
    """Compute |S1|^2 and |S2|^2 of spheres: (size, angle) each.

    S1 belongs to light polarised across the plane of scattering, S2 to light polarised in it. Both
    are even functions of the angle, which may be negative.

    Parameters
    ----------
    index : n - i k of the spheres, divided by that of the fluid.
    size_parameters : (size,) pi d n / lambda.

    Source: Bohren and Huffman (1983), eq. 4.74. The sums are taken as products of matrices: S1 + S2
    has the terms (a_n + b_n) (pi_n + tau_n), and S1 - S2 those with differences.
    """
    across, along = np.empty((2, len(size_parameters), len(angles_rad)))
    for top in range(0, len(size_parameters), _ROWS):
        rows = slice(top, top + _ROWS)
        a, b = scaled_coefficients(index, size_parameters[rows])
        for left in range(0, len(angles_rad), _ANGLES):
            columns = slice(left, left + _ANGLES)
            pi, tau = _angular_functions(np.cos(angles_rad[columns]), a.shape[1])
            total, difference = _product(a + b, pi + tau), _product(a - b, pi - tau)
            across[rows, columns] = np.abs(total + difference) ** 2 / 4.0
            along[rows, columns] = np.abs(total - difference) ** 2 / 4.0
    return across, along


def extinction_efficiency(index: complex, size_parameters: F64) -> F64:
    """Compute extinction cross-sections (size,) over geometric ones.

    Source: Bohren and Huffman (1983), eq. 4.62.
    """
    a, b = scaled_coefficients(index, size_parameters)
    n = np.arange(1, a.shape[1] + 1)
    return np.asarray(2.0 / size_parameters**2 * ((a + b).real @ (n * (n + 1.0))))


def scaled_coefficients(index: complex, size_parameters: F64) -> tuple[C128, C128]:
    """Compute a_n and b_n times (2 n + 1) / (n (n + 1)): (size, order).

    Orders start at 1; beyond its own number of them, a size has zeros.

    Source: Bohren and Huffman (1983), eq. 4.88 and 4.89, and appendix A for the recurrences and the
    number of orders.
    """
    x = np.asarray(size_parameters, dtype=np.float64)
    m = complex(index.real, abs(index.imag))  # their sign of absorption
    needed = np.floor(x + 4.05 * np.cbrt(x) + 2.0).astype(np.int64)
    count = int(needed.max(initial=1))
    derivative = _logarithmic_derivative(np.asarray(m * x, dtype=np.complex128), count)
    a, b = np.zeros((2, len(x), count), dtype=np.complex128)
    psi_before, psi, chi_before, chi = np.cos(x), np.sin(x), -np.sin(x), np.cos(x)
    for n in range(1, count + 1):
        own = needed >= n  # the functions of the others would overflow
        factor = np.where(own, (2 * n - 1) / x, 0.0)
        psi_before, psi = psi, factor * psi - psi_before
        chi_before, chi = chi, factor * chi - chi_before
        xi_before, xi = psi_before - 1j * chi_before, psi - 1j * chi
        scale = (2.0 * n + 1.0) / (n * (n + 1.0))
        for out, ratio in ((a, derivative[n] / m), (b, derivative[n] * m)):
            bracket = ratio + n / x
            fraction = (bracket * psi - psi_before) / (bracket * xi - xi_before)
            out[:, n - 1] = np.where(own, scale * fraction, 0.0)
    return a, b


def _logarithmic_derivative(z: C128, count: int) -> C128:
    """Compute psi_n' / psi_n of z (size,), orders 0 to `count`: (order, size).

    The recurrence downwards forgets its start above |z|, and keeps its error below.
    """
    out = np.zeros((count + 1, len(z)), dtype=np.complex128)
    current = np.zeros(len(z), dtype=np.complex128)
    largest = max(float(count), float(np.abs(z).max(initial=0.0)))
    start = int(largest + 10.0 * np.cbrt(largest)) + 16
    for n in range(start, 0, -1):
        current = n / z - 1.0 / (current + n / z)
        if n <= count + 1:
            out[n - 1] = current
    return out


def _angular_functions(cosines: F64, count: int) -> tuple[F64, F64]:
    """Compute pi_n and tau_n (order, angle) for the orders 1 to `count`.

    Source: Bohren and Huffman (1983), eq. 4.47.
    """
    pi, tau = np.zeros((2, count, len(cosines)))
    before, pi[0] = np.zeros_like(cosines), 1.0
    for n in range(1, count + 1):
        tau[n - 1] = n * cosines * pi[n - 1] - (n + 1) * before
        if n < count:
            pi[n] = ((2 * n + 1) * cosines * pi[n - 1] - (n + 1) * before) / n
            before = pi[n - 1]
    return pi, tau


def _product(series: C128, functions: F64) -> C128:
    """Multiply a complex matrix by a real one."""
    parts = np.concatenate([series.real, series.imag]) @ functions
    return np.asarray(parts[: len(series)] + 1j * parts[len(series) :])
