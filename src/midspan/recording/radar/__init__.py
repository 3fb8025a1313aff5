"""The radar of a recording: opened, calibrated, followed, and as printed in the paper."""
