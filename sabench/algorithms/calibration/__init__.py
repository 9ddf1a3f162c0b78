"""From image points to cameras: the equations that the calibration solvers share."""
