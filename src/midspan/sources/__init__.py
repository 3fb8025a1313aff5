"""The only place that reads files and devices."""
