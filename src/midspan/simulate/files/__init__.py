"""Simulated recordings as files: whole folders, tables, videos."""
