"""Alarms of a live site: rules over rows, what is kept of them, and who is notified."""
