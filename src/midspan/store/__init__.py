"""Rows, raw records, calibrations and checkpoints of live points, in SQLite files or PostgreSQL."""
