"""Own_calibration."""
