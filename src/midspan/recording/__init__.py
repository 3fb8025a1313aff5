"""A recording: its files opened, its parts prepared, run through calibration and fusion to a result."""
