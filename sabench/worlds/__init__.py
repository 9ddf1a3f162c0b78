"""From a scene to the truth: tracers, bubbles, bodies and calibration targets of every frame."""
