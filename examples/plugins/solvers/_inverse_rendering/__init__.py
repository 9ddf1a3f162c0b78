"""Parts of the solver `inverse_rendering`: the descent, rendered images, and projections."""
