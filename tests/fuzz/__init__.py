"""Damaged files, settings and results, fed to the command: `make fuzz` for many, `test_fuzz.py` for some of each."""
