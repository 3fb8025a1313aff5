"""Recordings made from physics alone, without midspan's simulator, that obey or break the estimator's model."""
