"""The radar beside the accelerometer: fixed targets, conversion factors, clock, own motions."""
