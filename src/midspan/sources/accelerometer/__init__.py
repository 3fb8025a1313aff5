"""Channels of logger files: one reader a format, chosen by the suffix."""
