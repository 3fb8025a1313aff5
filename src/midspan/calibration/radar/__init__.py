"""The radar compared with the accelerometer: fixed targets, conversion factors, clock, own motions."""
