"""The camera beside the accelerometer: every target along every axis, movers, the temperature range."""
