"""Frames in, pixel translations out: regions of interest and the trackers that follow them."""
