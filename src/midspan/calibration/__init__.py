"""Calibration: scale factor, time offset and noise levels, each with its standard deviation."""
