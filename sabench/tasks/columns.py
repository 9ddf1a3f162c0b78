"""The scores of every track as tables show them."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Column:
    """A score as tables show it."""

    key: str
    heading: str
    decimals: int
    meaning: str


_COST = (
    Column("seconds", "seconds", 2, "time of the solver alone"),
    Column("peak_mb", "peak MB", 0, "most memory that the solver's process held"),
)
COLUMNS: dict[str, tuple[Column, ...]] = {
    "reconstruction": (
        Column(
            "q",
            "Q",
            3,
            "quality factor, the correlation of the reconstructed with the true intensity: 1 is perfect",
        ),
        Column(
            "true_percent",
            "true %",
            1,
            "share of the true particles that were found within 1.5 voxels",
        ),
        Column(
            "ghost_percent",
            "ghost %",
            1,
            "detections that are no true particle, relative to those that are",
        ),
        Column(
            "precision",
            "precision",
            3,
            "share of the detections that are true, closer than 1 voxel along every axis, one to one",
        ),
        Column(
            "recall", "recall", 3, "share of the true particles that were found, by the same rule"
        ),
        Column("rms_px", "rms px", 3, "root mean square distance between the pairs of that rule"),
        Column(
            "peak_true_percent",
            "peak true %",
            1,
            "true %, but with particles found as local maxima: those that touch are still two",
        ),
        Column("peak_ghost_percent", "peak ghost %", 1, "ghost % of these"),
        *_COST,
    ),
    "particles": (
        Column("f1", "F1", 3, "harmonic mean of precision and recall"),
        Column(
            "precision",
            "precision",
            3,
            "share of the detections that are true, closer than 1 voxel along every axis, one to one",
        ),
        Column("recall", "recall", 3, "share of the true particles that were found"),
        Column(
            "ghost_percent",
            "ghost %",
            1,
            "detections that are no true particle, relative to those that are",
        ),
        Column(
            "rms_px",
            "rms px",
            3,
            "root mean square distance of found from true particles in the images, mean over cameras and pairs",
        ),
        Column("rms_mm", "rms mm", 4, "root mean square distance between them in space"),
        Column(
            "link_recall",
            "link recall",
            3,
            "share of the particles found in two frames that follow each other that one track joins",
        ),
        Column(
            "link_precision",
            "link precision",
            3,
            "share of the links between such frames that join the same particle",
        ),
        Column(
            "effectiveness",
            "effectiveness",
            3,
            "share of a particle's frames in which its longest track has it, mean over the particles",
        ),
        Column(
            "velocity_mm_s",
            "velocity mm/s",
            3,
            "median error of the velocity of right links, against the true mean velocity between the frames",
        ),
        Column("velocity_percent", "velocity %", 2, "the same over that velocity"),
        *_COST,
    ),
    "velocimetry": (
        Column(
            "u_p90_voxel",
            "u 90 % voxel",
            3,
            "half width of the interval about zero that holds 90 % of the errors of the displacement along X",
        ),
        Column("v_p90_voxel", "v 90 % voxel", 3, "the same along Y"),
        Column("w_p90_voxel", "w 90 % voxel", 3, "the same along Z"),
        Column("bias_voxel", "bias voxel", 4, "length of the mean error"),
        Column("rms_voxel", "rms voxel", 3, "root mean square length of the error"),
        Column("yield_percent", "yield %", 1, "share of the vectors that were measured"),
        Column("response", "response", 3, "the part of the true field's variation that is found"),
        Column(
            "divergence_1_s",
            "divergence 1/s",
            3,
            "root mean square error of the divergence, by central differences",
        ),
        Column(
            "vorticity_percent",
            "vorticity %",
            1,
            "root mean square error of the vorticity over its own root mean square",
        ),
        Column(
            "reconstruction_s", "reconstruction s", 2, "time of the reconstruction of one frame"
        ),
        *_COST,
    ),
    "bubbles": (
        Column(
            "f1_large",
            "F1, large",
            3,
            "harmonic mean of precision and recall of bubbles from 0.5 mm radius on; found: closer than half a radius",
        ),
        Column("f1", "F1", 3, "the same, all bubbles"),
        Column("f1_small", "F1, small", 3, "the same, bubbles below 0.5 mm"),
        Column("precision", "precision", 3, "share of the detections that are bubbles, one to one"),
        Column("recall", "recall", 3, "share of the bubbles that were found"),
        Column(
            "recall_hidden",
            "recall, hidden",
            3,
            "share found of bubbles of which the cameras see less than nine tenths, mean over cameras",
        ),
        Column(
            "recall_dense",
            "recall, dense",
            3,
            "share found of bubbles around which, within 6 mm, others fill a hundredth or more",
        ),
        Column(
            "radius_percent",
            "radius %",
            2,
            "median error of the radius of found bubbles of 0.5 mm and more",
        ),
        Column("axes_percent", "axes %", 2, "median error of their semi-axes"),
        Column(
            "tilt_deg",
            "tilt deg",
            1,
            "median error of the short axis's direction, of found bubbles flatter than 0.9",
        ),
        Column(
            "plane_mm", "plane mm", 3, "median error across Z of found bubbles of 0.5 mm and more"
        ),
        Column("depth_mm", "depth mm", 3, "median error along Z"),
        Column(
            "sizes_percent",
            "sizes %",
            1,
            "distance of the distributions of radii (Wasserstein) over the mean radius",
        ),
        Column("void_percent", "void %", 1, "error of the volume of all bubbles"),
        Column(
            "penetration_percent",
            "Y_p %",
            1,
            "error of a jet's penetration depth, against the same analysis of the true bubbles",
        ),
        Column("angle_percent", "angle %", 1, "error of its spreading angle"),
        Column("weight_percent", "A %", 1, "error of A of equation 5.18"),
        Column("width_percent", "s %", 1, "error of s of equation 5.18"),
        Column(
            "link_recall",
            "link recall",
            3,
            "share of the bubbles found in two frames that follow each other that one track joins",
        ),
        Column(
            "link_precision",
            "link precision",
            3,
            "share of the links between such frames that join the same bubble",
        ),
        Column(
            "effectiveness",
            "effectiveness",
            3,
            "share of a bubble's frames in which its longest track has it, mean over the bubbles",
        ),
        Column(
            "velocity_mm_s",
            "velocity mm/s",
            2,
            "median error of the velocity of right links, against the true mean velocity between the frames",
        ),
        Column("velocity_percent", "velocity %", 2, "the same over that velocity"),
        *_COST,
    ),
    "see_through": (
        Column(
            "read_percent",
            "read %",
            1,
            "cells of a code behind bubbles that are read right in the plane where it is; guessing gives 50",
        ),
        Column(
            "separation", "d'", 2, "difference of the mean bright and dark cells over their scatter"
        ),
        Column("contrast", "contrast", 3, "difference of these means over their sum"),
        Column(
            "single_percent",
            "single views, read %",
            1,
            "the same of single images, mean over the cameras",
        ),
        Column("best_single_percent", "best view, read %", 1, "the best single image"),
        Column(
            "single_separation",
            "single views, d'",
            2,
            "the separation in single images, mean over the cameras",
        ),
        *_COST,
    ),
    "calibration": (
        Column(
            "true_px",
            "true px",
            4,
            "mean distance of reprojected points from where they truly are in the images",
        ),
        Column("bound_px", "bound px", 4, "the least of these that the data allow (Cramer-Rao)"),
        Column("true_ratio", "true / bound", 3, "true px over bound px"),
        Column(
            "measured_px",
            "measured px",
            4,
            "mean distance of reprojected points from where they were found",
        ),
        Column(
            "x_std_mm",
            "x std mm",
            4,
            "scatter of the points' errors along X, after a shift in X and Y and a turn about the wall's normal",
        ),
        Column("y_std_mm", "y std mm", 4, "the same along Y"),
        Column("z_std_mm", "z std mm", 4, "the same along Z"),
        Column(
            "z_mean_mm",
            "z mean mm",
            3,
            "mean error along Z, which images through a plane wall hardly show",
        ),
        Column("z_std_ratio", "z std / bound", 3, "scatter along Z over its bound"),
        Column(
            "held_out_mm",
            "held out mm",
            4,
            "root mean square error of other points in the volume, intersected from noisy images",
        ),
        Column("held_out_exact_mm", "with exact cameras", 4, "the same with the true cameras"),
        *_COST,
    ),
}
# of the first column, by which tables are sorted
LARGER_IS_BETTER = {
    "reconstruction": True,
    "particles": True,
    "calibration": False,
    "velocimetry": False,
    "bubbles": True,
    "see_through": True,
}
