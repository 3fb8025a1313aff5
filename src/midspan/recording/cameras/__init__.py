"""Calibrated cameras: tracked to their end, and which of two is believed."""
