"""Truth of every frame: tracers, bubbles, bodies, calibration targets."""
