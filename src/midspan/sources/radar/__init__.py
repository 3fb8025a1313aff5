"""Radar data: raw captures, slow-time files, Acconeer recordings and a live capture card."""
