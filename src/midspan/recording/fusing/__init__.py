"""Prepared measurements become one displacement, and what the calibration's own error adds."""
