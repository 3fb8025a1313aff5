"""What a recording holds: its settings, its opened streams and their segments of time."""
