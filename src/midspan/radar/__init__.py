"""Radar: from raw chirps to range profiles, targets, unwrapped phase and blockage, all on arrays."""
