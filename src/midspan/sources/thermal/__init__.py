"""Readers of radiometric sequences: FLIR records, 16-bit TIFF, stacks in °C."""
