"""Benchmarks: one file a hot path or a promise; `python -m benchmarks [NAME …]` prints goal and measured."""
