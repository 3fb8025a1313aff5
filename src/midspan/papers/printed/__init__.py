"""The papers' methods as printed, each entered by its name where the rooms below need it."""
