"""The camera compared with the accelerometer: every target along every axis, movers, the temperature range."""
