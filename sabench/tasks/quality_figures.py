"""Figures that judge a result without truth, as `sabench quality` computes them."""

from __future__ import annotations

from sabench.tasks.task import ANY, SHARE, Score

# fmt: off
FIGURES = {one.key: one for one in (
    Score("residual_px", "residual px", "px", "smaller", 3,
          "RMS distance of particles' images from their projections, px"),
    Score("explained", "explained", "", "larger", 3,
          "share of the images' light that the result explains", range=ANY),
    Score("held_out", "held out", "", "larger", 3,
          "share of particles found without a camera that this camera shows", counted=True,
              range=SHARE),
    Score("held_out_correlation", "held-out correlation", "", "larger", 3,
          "correlation of an image with the others' prediction", range=ANY),
    Score("ghost_percent", "expected ghosts %", "%", "smaller", 2,
          "expected ghosts, relative to true particles, %", counted=True),
    Score("chance_percent", "chance %", "%", "smaller", 2,
          "found with a scrambled camera, relative to what is found, %", counted=True),
    Score("jitter_mm", "jitter mm", "mm", "smaller", 4,
          "scatter of positions along an axis, from jitter of trajectories, mm"),
    Score("followed", "followed", "", "larger", 3,
          "share of particles in trajectories of three frames or more", counted=True, range=SHARE),
)}
# fmt: on

# figures that results of a task have; other tasks have none
FIGURES_OF: dict[str, tuple[Score, ...]] = {
    "particles": tuple(FIGURES.values()),
    "reconstruction": tuple(
        FIGURES[key] for key in ("explained", "held_out_correlation", "chance_percent")
    ),
}
