"""Writers of result tables: one a format, chosen by the suffix."""
