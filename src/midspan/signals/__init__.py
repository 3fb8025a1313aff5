"""Arrays in, arrays out: what a signal is like, independent of any sensor."""
