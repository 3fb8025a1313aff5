"""What a calibration says of each kind of sensor, as plain records."""
