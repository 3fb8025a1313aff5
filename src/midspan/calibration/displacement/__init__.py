"""A displacement sensor compared with the accelerometer: noise, clock offset, scale."""
