"""A result as one HTML file that can be read anywhere and printed."""
