"""`midspan compare RESULT REFERENCE`."""
