"""The recordings that can be simulated, and how one is written."""
