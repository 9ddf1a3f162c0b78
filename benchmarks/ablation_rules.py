"""What the ablation must not scale, what switches rules off, and where it keeps what it makes."""

from pathlib import Path

FOLDER = Path(__file__).resolve().parents[1] / "work" / "ablation"

# numbers that are no rules: indices, sizes of arrays, units, series and formats
STRUCTURE = {
    "algorithms.particles.image_model.WEIGHT",
    "algorithms.particles.image_model.SUMS",
    "algorithms.particles.image_model.SHAPES",
    "algorithms.particles.image_model._ANY_ORDER",
    "algorithms.particles.image_model._NONE",
    "algorithms.particles.particle_search._BOX",
    "algorithms.particles.particle_search._BY_PARTICLE",
    "algorithms.particles.candidate_search._STEP",
    "algorithms.particles.candidate_search._STEPS",
    "algorithms.particles.candidate_search._DIAGONALS",
    "algorithms.particles.candidate_search._DARK",
    "images.widths.PIXEL",
    "images.peaks._NEIGHBOURS",
    "images.preprocessing.WHITE",
    "images.statistics.DEPTHS",
    "images.statistics.SCALED_WHITE",
    "images.statistics._FROM_MAD",
    "images.dark_noise._GOLDEN",
}

# a rule's value, or the body of a function, that switches it off
OFF = {
    "algorithms.particles.bayesian_ipr._NARROWER": "0.0",
    "algorithms.particles.bayesian_ipr._DARKEST": "(0.45,)",
    "algorithms.particles.bayesian_ipr._flatten": "pass",
    "algorithms.particles.bayesian_ipr.split_and_find": "return 0",
    "algorithms.particles.particle_search._CROWDED": "1e9, 1e9, 0.0",
    "algorithms.particles.particle_search._FLOOR": "0.0, 0.0, 0.0",
    "algorithms.particles.particle_search._SETTLED": "0.0",
    "algorithms.particles.particle_search._CONTESTED": "1e9",
    "algorithms.particles.particle_search._TRIAL_FITS": "0",
    "algorithms.particles.learned_model.align_cameras": "pass",
    "algorithms.particles.learned_model.learn_widths": "pass",
    "algorithms.particles.learned_model._keep_plain": "pass",
    "algorithms.particles.learned_model.learn_light": "pass",
    "algorithms.particles.obstacles.find_partly_hidden": "return []",
    "algorithms.particles.obstacles.find_dark_views": "return np.zeros(clear.images.shape, bool)",
    "algorithms.particles.obstacles.are_doubtful": "return True",
    "algorithms.particles.obstacles.without_wrong_cameras": "return search",
    "algorithms.particles.candidate_search.wide_enough": "return images, sigma",
    "algorithms.particles.dense_start.are_mostly_wrong": "return False",
    "images.background.find_patches": "return np.zeros_like(image)",
    "images.background.find_bright_spots": "return np.zeros(image.shape, dtype=np.bool_)",
    "images.background.estimate_background": "return None",
    "images.background.clear_images": "return images, flaws",
    "images.widths._without_brightest": "return valid",
    "images.widths.measure_flatness": "return np.zeros(3)",
    "images.widths._light_of_peaks": "return math.inf",
    "images.dark_noise._measure_dense": "return None",
    "images.dark_noise._leave_out_bright": "return noise",
    "images.dark_noise._shape": "return 0.0, 1.0, 0.0",
    "images.repair.find_points": "return np.zeros(grey.shape, dtype=np.bool_)",
    "images.repair.find_reflections": "return np.zeros(grey.shape, dtype=np.bool_)",
}
