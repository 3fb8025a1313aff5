"""One validated settings tree: `recording.toml` and nothing else decides what a run does."""
