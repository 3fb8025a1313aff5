"""A calibration as it is kept in `calibration.json`."""
