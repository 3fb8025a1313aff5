"""A radar that looks at reflectors: its signal, its files, its place in a scenario."""
