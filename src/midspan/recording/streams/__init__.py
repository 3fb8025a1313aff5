"""What a recording holds: its settings, its opened streams and their stretches of time."""
