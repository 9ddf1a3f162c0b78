"""Rings of Airy's pattern around images of particles.

A Gaussian has the core of the pattern, but not the light far from it: 4 to 8 % of all light lies
more than five pixels away. A filter turns the Gaussian pattern of a whole image into Airy's.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from sabench.geometry.camera import Camera
from sabench.simulation.rendering.particle_images import diffraction_px
from sabench.utils.arrays import F64

_PARTS = 2  # of a pixel's edge
_MARGIN = 128  # parts around the image, beyond which light does not come back from the other side


def render_with_rings(camera: Camera, wavelength_nm: float, render: Callable[[Camera], F64]) -> F64:
    """Render photons (rows, columns) of Gaussian images, and give them rings.

    Pixels are rendered in four parts, since the lens resolves more than the pixels do.

    Parameters
    ----------
    render : photons (rows, columns) in any camera.
    """
    fine = _finer(camera)
    image = _filter(fine, render(fine), wavelength_nm)
    shape = (camera.rows, _PARTS, camera.columns, _PARTS)
    return np.asarray(image.reshape(shape).sum(axis=(1, 3)))


def _finer(camera: Camera) -> Camera:
    """Divide the pixels of a camera."""
    column, row = ((place + 0.5) * _PARTS - 0.5 for place in camera.principal_point_px)
    return replace(
        camera,
        rows=camera.rows * _PARTS,
        columns=camera.columns * _PARTS,
        pixel_mm=camera.pixel_mm / _PARTS,
        principal_point_px=(column, row),
    )


def _filter(camera: Camera, photons: F64, wavelength_nm: float) -> F64:
    """Multiply an image's spectrum by the ratio of the two transfer functions.

    They are Airy's and the Gaussian's. Light that leaves the image is lost. Source: Goodman,
    Introduction to Fourier Optics (2005), eq. 6-31.
    """
    from scipy import fft  # takes long to load

    rows, columns = (fft.next_fast_len(size + _MARGIN, real=True) for size in photons.shape)
    frequency = np.hypot(fft.fftfreq(rows)[:, None], fft.rfftfreq(columns))
    gaussian = np.exp(-2.0 * (np.pi * diffraction_px(camera, wavelength_nm) * frequency) ** 2)
    ratio = airy_transfer(frequency / cutoff(camera, wavelength_nm)) / gaussian
    spectrum = fft.rfft2(photons, (rows, columns)) * ratio
    filtered = fft.irfft2(spectrum, (rows, columns))[: photons.shape[0], : photons.shape[1]]
    return np.asarray(np.maximum(filtered, 0.0))


def airy_transfer(frequency: F64) -> F64:
    """Compute a round aperture's transfer function; frequencies are over the cut-off."""
    x = np.minimum(frequency, 1.0)
    return np.asarray(2.0 / np.pi * (np.arccos(x) - x * np.sqrt(1.0 - x**2)))


def cutoff(camera: Camera, wavelength_nm: float) -> float:
    """Compute the highest frequency that a lens transfers, cycles per pixel."""
    number = camera.f_number * camera.principal_distance_mm / camera.focal_length_mm
    return camera.pixel_mm / (wavelength_nm * 1e-6 * number)
