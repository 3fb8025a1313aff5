"""A recording's cameras opened: light, lens, targets, temperatures; and the camera alone."""
