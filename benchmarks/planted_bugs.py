"""Bugs that the benchmark of the gate plants: changes of one line each."""

from dataclasses import dataclass


@dataclass(frozen=True)
class Bug:
    """Replacement of a line in a file; `old` must be there exactly once.

    Attributes
    ----------
    case : case of `ci` that is meant to catch it; the whole suite by default.
    tests : unit tests that catch it where `ci` does not.
    """

    title: str
    file: str
    old: str
    new: str
    case: str = ""
    tests: str = ""


BUGS = (
    Bug(
        "light half a pixel to the right of where it belongs",
        "sabench/simulation/rendering/particles_splatted.py",
        "fill_shares(pixel[i, 0], sigma[i, 0], left, width, across[0])",
        "fill_shares(pixel[i, 0] + 0.5, sigma[i, 0], left, width, across[0])",
        case="particles",
    ),
    Bug(
        "x and z of a velocity field's lattice swapped",
        "sabench/algorithms/velocimetry/multipass.py",
        "np.asarray(values[::-1]) for values in lattice",
        "np.asarray(values) for values in lattice",
        case="vortex",
    ),
    Bug(
        "light in the fluid at the angle that it has in the glass",
        "sabench/geometry/refraction.py",
        "angle_in(self.indices, -1, slope)",
        "angle_in(self.indices, 1, slope)",
        case="particles",
    ),
    Bug(
        "a camera's rotation transposed",
        "sabench/geometry/camera.py",
        "local = np.asarray(self.rotation) @ leaving.T\n",
        "local = np.asarray(self.rotation).T @ leaving.T\n",
        case="particles",
    ),
    Bug(
        "planes counted from one",
        "sabench/algorithms/refocus/slabs.py",
        "depths = grid.axes_mm[2][first : first + planes]",
        "depths = grid.axes_mm[2][first : first + planes] + grid.voxel_mm[2]",
        case="particles",
    ),
    Bug(
        "sign of the distortion's p1",
        "sabench/geometry/lens.py",
        "u = x * radial + 2.0 * lens.p1 * x * y",
        "u = x * radial - 2.0 * lens.p1 * x * y",
        case="particles",
    ),
    Bug(
        "thickness of the glass forgotten in fast projection",
        "sabench/geometry/projection_kernels.py",
        "float(ratios[0]), before + wall.thickness_mm",
        "float(ratios[0]), before",
        case="particles",
    ),
    Bug(
        "black level not subtracted",
        "sabench/images/levels.py",
        "grey.astype(np.float64) - black_dn",
        "grey.astype(np.float64) - 0.0",
        case="particles",
    ),
    Bug(
        "SMART's exponents not over the number of cameras",
        "sabench/algorithms/tomography/art_updates.py",
        "exponents /= state.seen",
        "exponents /= 1.0",
        case="particles",
    ),
    Bug(
        "SMART's relaxation left out",
        "sabench/algorithms/tomography/art_updates.py",
        "\n    on_cores(multiply, len(exponents), state.values, exponents, np.float32(relaxation))",
        "\n    on_cores(multiply, len(exponents), state.values, exponents, np.float32(1.0))",
        case="particles",
    ),
    Bug(
        "no median test of vectors",
        "sabench/algorithms/velocimetry/multipass.py",
        "    valid = near_the_median(peaks.shift, valid, plan.median)\n",
        "",
        case="vortex",
    ),
    Bug(
        "bubbles' diameters for radii",
        "solvers/minimum_image.py",
        "np.sqrt(kept[:, 3] * kept[:, 4])",
        "2.0 * np.sqrt(kept[:, 3] * kept[:, 4])",
        case="bubbles",
    ),
    Bug(
        "degrees taken for radians",
        "sabench/scenes/focusing.py",
        "rotation_matrices(np.deg2rad(spec.turn_deg) * rng",
        "rotation_matrices(spec.turn_deg * rng",
        case="boards",
    ),
    Bug(
        "the last camera left out where lines of sight are intersected",
        "sabench/geometry/triangulation.py",
        "zip(cameras, pixels, strict=True):\n        here, valid",
        "zip(cameras[:-1], pixels, strict=False):\n        here, valid",
        case="boards",
    ),
    Bug(
        "Snell's law upside down on the way into the fluid",
        "sabench/geometry/refraction.py",
        "normal) * (before / after)",
        "normal) * (after / before)",
        case="particles",
    ),
    Bug(
        "ghosts relative to all detections",
        "sabench/metrics/particle_detection.py",
        "100.0 * ghosts / self.matched if",
        "100.0 * ghosts / self.detections if",
        case="particles",
    ),
    Bug(
        "bubbles match within their radius, not half of it",
        "sabench/metrics/bubble_detection.py",
        "NEAR * radius_mm",
        "2.0 * NEAR * radius_mm",
        case="bubbles",
    ),
    Bug(
        "a factor 2 lost in the calibration's distortion",
        "sabench/algorithms/calibration/kernels.py",
        "p1 * (s + 2.0 * v * v) + 2.0 * p2 * u * v\n    uu",
        "p1 * (s + v * v) + 2.0 * p2 * u * v\n    uu",
        case="boards",
    ),
    Bug(
        "quantum efficiency forgotten",
        "sabench/simulation/rendering/sensor.py",
        "mean = chain.quantum_efficiency * photons[row, column]",
        "mean = photons[row, column]",
        case="particles",
    ),
    Bug(
        "index of bubbles over that of the fluid upside down",
        "sabench/simulation/rendering/bubble_integrator.py",
        "self.eta = dr.opaque(mi.Float, stage.eta)",
        "self.eta = dr.opaque(mi.Float, 1.0 / stage.eta)",
        case="bubbles",
    ),
    Bug(
        "planes refocused .3 px to the right",
        "sabench/algorithms/refocus/slabs.py",
        "return camera.project(polynomials.plane_points(box, z_mm, unit))[0]",
        "return camera.project(polynomials.plane_points(box, z_mm, unit))[0] + [0.3, 0.0]",
        case="particles",
    ),
    Bug(
        "index of the fluid off by .5 %",
        "sabench/scenes/build.py",
        "media = (spec.air_index, layers, spec.fluid_index)",
        "media = (spec.air_index, layers, 1.005 * spec.fluid_index)",
        case="particles",
    ),
    Bug(
        "the last frame of a sequence lost",
        "sabench/metrics/trajectories.py",
        "itertools.pairwise(frames):",
        "itertools.pairwise(frames[:-1]):",
        case="tracking",
    ),
    Bug(
        "column and row swapped in one camera",
        "sabench/simulation/rendering/particle_images.py",
        "    return ParticleImages(seen.pixel, photons,",
        "    swapped = seen.pixel[:, ::-1] if camera.name == 'camera_02' else seen.pixel\n"
        "    return ParticleImages(swapped, photons,",
        case="particles",
    ),
    Bug(
        "the automatic threshold one step too low",
        "sabench/algorithms/refocus/thresholding.py",
        "float(levels[enough[0]]) if len(enough)",
        "float(levels[max(enough[0] - 1, 0)]) if len(enough)",
        tests="tests/unit/algorithms/refocus/test_thresholding.py",
    ),
    Bug(
        "Mie's lobes rotated by a degree",
        "sabench/simulation/rendering/particle_light.py",
        "np.arccos(np.clip(-arriving @ unit(direction), -1.0, 1.0))",
        "np.arccos(np.clip(-arriving @ unit(direction), -1.0, 1.0)) + np.deg2rad(1.0)",
        case="particles",
    ),
    Bug(
        "two cameras share their sensor's noise",
        "sabench/simulation/frames.py",
        'stream(self.seed, "sensor", self.number, camera)',
        'stream(self.seed, "sensor", self.number, camera // 2)',
        tests="tests/unit/simulation/test_frame_content.py",
    ),
    Bug(
        "the sensor's noise ignores the seed",
        "sabench/simulation/frames.py",
        'stream(self.seed, "sensor", self.number, camera)',
        'stream(0, "sensor", self.number, camera)',
        tests="tests/unit/simulation/test_frame_content.py",
    ),
    Bug(
        "the sensor's noise is the same in all frames",
        "sabench/simulation/frames.py",
        'stream(self.seed, "sensor", self.number, camera)',
        'stream(self.seed, "sensor", 0, camera)',
        tests="tests/unit/simulation/test_frame_content.py",
    ),
    Bug(
        "duplicate detections are no ghosts",
        "sabench/metrics/particle_detection.py",
        "    return _counts(chosen, matched, estimate, truth, scored_estimate, scored_truth)\n",
        "    near = np.isfinite(distance) & ~np.isin(np.arange(len(distance)), chosen)\n"
        "    return _counts(chosen, matched, estimate, truth, scored_estimate & ~near, "
        "scored_truth)\n",
        tests="tests/unit/metrics/test_quality_factor.py",
    ),
    Bug(
        "links are searched for where a particle is a frame later",
        "sabench/algorithms/particles/linking.py",
        "live.velocity[old] * (time - live.time[old])[:, None]",
        "2.0 * live.velocity[old] * (time - live.time[old])[:, None]",
        case="tracking",
    ),
    Bug(
        "trajectories of the first two links swapped",
        "sabench/algorithms/particles/linking.py",
        "number[j] = live.number[i]",
        "number[j] = live.number[np.concatenate([i[:2][::-1], i[2:]])]",
        tests="tests/unit/algorithms/particles/test_linking.py",
    ),
    Bug(
        "the sign of w wrong",
        "sabench/algorithms/velocimetry/multipass.py",
        "self.shift * voxel / interval_s,",
        "self.shift * voxel * [1.0, 1.0, -1.0] / interval_s,",
        tests="tests/unit/algorithms/velocimetry/test_windows.py",
    ),
    Bug(
        "Snell's law upside down at a cylinder",
        "sabench/geometry/cylinder_kernels.py",
        "if _cross(faces[m], indices[m] / indices[m + 1], at",
        "if _cross(faces[m], indices[m + 1] / indices[m], at",
        tests="tests/unit/geometry/test_cylinder_wall.py",
    ),
    Bug(
        "all cameras behind the first face of a tank",
        "sabench/scenes/build.py",
        "return walls[int(np.argmax(entered))]",
        "return walls[0]",
        tests="tests/unit/scenes/test_tank.py",
    ),
    Bug(
        "bubbles' radii drawn as diameters",
        "sabench/worlds/library/sizes.py",
        "out[left] = spectrum.radius_mm * np.exp(",
        "out[left] = 0.5 * spectrum.radius_mm * np.exp(",
        case="bubbles",
    ),
    Bug(
        "the gain applied twice",
        "sabench/simulation/rendering/sensor.py",
        "value * chain.gain_dn_e",
        "value * chain.gain_dn_e**2",
        case="particles",
    ),
    Bug(
        "the read noise's variance for its standard deviation",
        "sabench/simulation/rendering/sensor.py",
        "chain.read_noise_e * noise[column]",
        "chain.read_noise_e**2 * noise[column]",
        case="particles",
    ),
    Bug(
        "the same particles enter in every frame",
        "sabench/worlds/tracers.py",
        'stream(self.seed, "entering", frame)',
        'stream(self.seed, "entering", 1)',
        case="tracking",
    ),
    Bug(
        "the distance of matched particles without z",
        "sabench/metrics/particle_detection.py",
        "    offset = estimate[a[inside]] - truth[b[inside]]\n",
        "    offset = (estimate[a[inside]] - truth[b[inside]])[:, :2]\n",
        case="particles",
    ),
    Bug(
        "effectiveness counts particles of one frame",
        "sabench/metrics/trajectories.py",
        "(most / frames)[frames > 1]",
        "(most / frames)[frames > 0]",
        tests="tests/unit/metrics/test_trajectories.py",
    ),
    Bug(
        "the optical axis at half the columns",
        "sabench/scenes/build.py",
        "or ((spec.columns - 1) / 2.0,",
        "or (spec.columns / 2.0,",
        case="particles",
    ),
    Bug(
        "hot pixels are not looked for",
        "sabench/images/repair.py",
        "points[:] = find_points(grey, black_dn)",
        "points[:] = False",
        tests="tests/unit/images/test_repair.py",
    ),
    Bug(
        "the brightest pixel alone sets the brightness scale",
        "sabench/images/levels.py",
        "min(levels[-1], BRIGHT * peak) if peak else levels[-1]",
        "levels[-1]",
        tests="tests/unit/images/test_repair.py",
    ),
    Bug(
        "two cameras share their sensor's pattern",
        "sabench/simulation/camera_view.py",
        'stream(seed, "sensor pattern", camera)',
        'stream(seed, "sensor pattern", camera // 2)',
        tests="tests/unit/simulation/test_grey_values.py",
    ),
    Bug(
        "the mean diameter's light for every particle",
        "sabench/simulation/rendering/particle_light.py",
        "for values in (particles.diameter_mm, *given)",
        "for values in (0.0 * numbers + particles.diameter_mm.mean(), *given)",
        tests="tests/unit/simulation/rendering/test_particle_light.py",
    ),
    Bug(
        "mirror images as far behind the back wall as particles are before the front wall",
        "sabench/simulation/rendering/particle_images.py",
        "mirror_mm = inner_mm + wall.depth_mm\n",
        "mirror_mm = inner_mm\n",
        tests="tests/unit/simulation/rendering/test_light_routes.py",
    ),
    Bug(
        "a tilted sensor's two turns in the other order",
        "sabench/geometry/lens.py",
        "np.array(about_y) @ np.array(about_x)",
        "np.array(about_x) @ np.array(about_y)",
        tests="tests/unit/geometry/test_lens.py",
    ),
    Bug(
        "the plane of focus tilted to the other side",
        "sabench/simulation/rendering/particle_images.py",
        "sign * lens / camera.principal_distance_mm",
        "-sign * lens / camera.principal_distance_mm",
        tests="tests/unit/simulation/rendering/test_tilted_sensors.py",
    ),
)
