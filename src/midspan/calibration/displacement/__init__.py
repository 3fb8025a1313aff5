"""A displacement sensor beside the accelerometer: noise, clock offset, scale."""
