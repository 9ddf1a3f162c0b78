"""Figures of the array's view: resolution, depth, overlap and blur."""

from __future__ import annotations

import math

import numpy as np

from sabench.evaluation.planning.quantities import Advice, Quantity, Section
from sabench.evaluation.planning.viewing import Viewing
from sabench.geometry.camera import Camera
from sabench.geometry.common_view import pixel_size_mm
from sabench.scenes import Scene
from sabench.scenes.focusing import apparent_distance_mm
from sabench.simulation.rendering.particle_images import defocus_px, diffraction_px
from sabench.utils.arrays import F64

DIAMETER = 4.0  # diameter of a Gaussian image in standard deviations: the e^-2 circle
_OVERLAP = 0.95  # of the volume that all cameras should see
_COARSE = 1.5  # pixels: a larger voxel loses resolution
_LONG = 1.05  # of the distance of focal planes: thesis's voxels are as long, rounded
_SHARP_PX = 1.0  # of defocus harm nothing, however fine diffraction is
_WAVELENGTH_NM = 550.0  # of white light


def plan_view(scene: Scene, view: Viewing) -> Section:
    """Compute field of view, resolution and overlap of an array."""
    spec, pixel = scene.cameras, view.pixel_mm(0.5)
    voxels = math.prod(view.rig.grid.shape)
    shares = view.shares_seen
    quantities = (
        Quantity("cameras", len(view.rig.cameras), "cameras of the array", "scene"),
        Quantity("view_width_mm", spec.columns * pixel, "width of an image in the volume", "(2.5)"),
        Quantity("view_height_mm", spec.rows * pixel, "height of an image in the volume", "(2.5)"),
        Quantity("pixel_front_mm", view.pixel_mm(0.0), "pixel dX at the front face", "(2.5)"),
        Quantity("pixel_center_mm", pixel, "pixel dX at the middle, inner camera", "(2.5)"),
        Quantity("pixel_back_mm", view.pixel_mm(1.0), "pixel dX at the back face", "(2.5)"),
        Quantity("pixel_coarsest_mm", view.pixels_mm.max(), "of the farthest camera", "(2.5)"),
        Quantity(
            "voxel_over_pixel", max(_across(scene, view)) / pixel, "voxel width / dX", "grid, (2.5)"
        ),
        Quantity(
            "voxel_length",
            scene.grid.voxel_mm[view.axis] / pixel,
            "voxel length / dX",
            "grid, (2.5)",
        ),
        Quantity("voxels_million", voxels / 1e6, "voxels of a volume", "grid"),
        Quantity("volume_mb", 4.0 * voxels / 1e6, "memory of one float32 volume, MB", "grid"),
        Quantity(
            "common_share", view.share_common, "share of the volume all cameras see", "traced"
        ),
        Quantity("scored_share", view.share_scored, "the same of its scored part", "traced"),
        Quantity("least_share", float(shares.min()), "share that the worst camera sees", "traced"),
    )
    return Section("view", quantities, tuple(_advise_view(scene, view, shares, quantities)))


def _across(scene: Scene, view: Viewing) -> list[float]:
    return [size for edge, size in enumerate(scene.grid.voxel_mm) if edge != view.axis]


def _advise_view(
    scene: Scene, view: Viewing, shares: F64, quantities: tuple[Quantity, ...]
) -> list[Advice]:
    advice, values = [], {one.key: one.value or 0.0 for one in quantities}
    if values["scored_share"] < _OVERLAP:
        worst = view.rig.cameras[int(np.argmin(shares))].name
        advice.append(
            Advice(
                "cameras.focal_length_mm",
                f"all cameras see {values['common_share']:.0%} of the volume together, and {worst} "
                f"sees {values['least_share']:.0%}: shorten cameras.focal_length_mm, set "
                "cameras.aim_mm to the volume's middle, or raise grid.crop_mm",
            )
        )
    if values["voxel_over_pixel"] > _COARSE:
        advice.append(
            Advice(
                "grid.voxel_mm",
                f"a voxel is {values['voxel_over_pixel']:.2g} pixels wide: reduce grid.voxel_mm to "
                f"{values['pixel_center_mm']:.3g} mm across the lines of sight",
            )
        )
    return advice


def plan_depth(scene: Scene, view: Viewing) -> Section:
    """Compute baseline, spacing and number of focal planes, and viewable depth."""
    pixel, ratio, pair = view.pixel_mm(0.5), view.plane_spacing_ratio, view.inner_pair
    spacing = None if ratio is None else ratio * pixel
    voxel, common = scene.grid.voxel_mm[view.axis], view.common_depth_mm
    field = min(depth_of_field_mm(scene, camera, view) for camera in view.rig.cameras)
    planes = None if spacing is None else view.depth_mm / spacing
    quantities = (
        Quantity(
            "baseline_ratio", _baseline(view, pair), "D of the two inner cameras", "dX_C / s_o"
        ),
        Quantity("plane_spacing_ratio", ratio, "dZ / dX at the middle", "(2.11), traced"),
        Quantity("plane_spacing_mm", spacing, "distance dZ of focal planes", "(2.11)"),
        Quantity("planes", planes, "focal planes in the volume's depth", "(2.12)"),
        Quantity("elongation", view.elongation, "length / width of a particle", "outer cameras"),
        Quantity("depth_mm", view.depth_mm, "depth of the volume", "volume.size_mm"),
        Quantity("common_depth_mm", common, "depth that all cameras see", "traced"),
        Quantity("depth_of_field_mm", field, "depth of field of one camera", _DEPTH_SOURCE),
        Quantity("viewable_depth_mm", min(common, field), "the smaller of the two", "2.2.3"),
    )
    advice = []
    if view.depth_mm > common:
        advice.append(
            Advice(
                "volume.size_mm",
                f"the cameras' views meet over {common:.3g} mm of depth and the volume has "
                f"{view.depth_mm:.3g} mm: reduce volume.size_mm or cameras.focal_length_mm",
            )
        )
    if spacing is not None and voxel > _LONG * spacing:
        advice.append(
            Advice(
                "grid.voxel_mm",
                f"voxels are {voxel:.3g} mm long and focal planes {spacing:.3g} mm apart: reduce "
                f"grid.voxel_mm to {spacing:.3g} mm along the lines of sight",
            )
        )
    if pair is None:
        advice.append(
            Advice("cameras.layout", "one camera sees no depth: add cameras to cameras.layout")
        )
    return Section("depth", quantities, tuple(advice))


def _baseline(view: Viewing, pair: tuple[int, int] | None) -> float | None:
    """Compute D, two cameras' distance over that of the front face in air."""
    if pair is None:
        return None
    first, second = (view.rig.cameras[number] for number in pair)
    distance = float(np.linalg.norm(np.subtract(first.center_mm, second.center_mm)))
    return distance / apparent_distance_mm(first, view.at(0.0))


_DEPTH_SOURCE = "4.88 n lambda N^2 (1 + 1/M)^2, Raffel et al. (2018)"


def depth_of_field_mm(scene: Scene, camera: Camera, view: Viewing) -> float:
    """Compute the depth over which defocus widens images less than diffraction does.

    It is 4.88 lambda N^2 ((M + 1) / M)^2 in air (Raffel et al., Particle Image Velocimetry, 2018,
    section 2.6); in a fluid of index n it is n times as deep, as the apparent depth is 1 / n of the
    true one.
    """
    magnification = camera.pixel_mm / pixel_size_mm([camera], view.center_mm)
    optical = wavelength_nm(scene) * 1e-6 * (camera.f_number * (1.0 + 1.0 / magnification)) ** 2
    return 4.88 * scene.fluid_index * optical


def wavelength_nm(scene: Scene) -> float:
    """Return the wavelength of a scene's light, of the laser first."""
    lights = (scene.illumination, scene.backlight, scene.lighting)
    return next((one.wavelength_nm for one in lights if one is not None), _WAVELENGTH_NM)


def plan_sharpness(scene: Scene, view: Viewing) -> Section:
    """Compare the blur at the volume's faces with diffraction, in e^-2 diameters."""
    cameras, size = view.rig.cameras, np.asarray(scene.volume.size_mm)
    airy = DIAMETER * max(diffraction_px(one, wavelength_nm(scene)) for one in cameras)
    front, middle, back = (
        DIAMETER * max(_largest(defocus_px(one, view.face(share, size))) for one in cameras)
        for share in (0.0, 0.5, 1.0)
    )
    quantities = (
        Quantity("diffraction_px", airy, "e^-2 diameter of diffraction", "Adrian and Yao (1985)"),
        Quantity("blur_front_px", front, "of defocus, front face, worst camera", "traced"),
        Quantity("blur_center_px", middle, "of defocus, middle section", "traced"),
        Quantity("blur_back_px", back, "of defocus, back face", "traced"),
    )
    worst = max(front, back)
    advice = []
    allowed = max(airy, _SHARP_PX)
    if worst > allowed and scene.cameras.particle_sigma_px is None:
        stop = min(one.f_number for one in cameras) * math.sqrt(worst / allowed)
        advice.append(
            Advice(
                "cameras.f_number",
                f"defocus at the volume's faces is {worst:.2g} px wide and diffraction {airy:.2g} "
                f"px: raise cameras.f_number to {stop:.2g}, or set cameras.focus_normal",
            )
        )
    return Section("sharpness", quantities, tuple(advice))


def _largest(values: F64) -> float:
    known = values[np.isfinite(values)]
    return float(known.max()) if len(known) else 0.0
