"""The online machine: measurements in, estimates out; no files, no clock, no threads."""
