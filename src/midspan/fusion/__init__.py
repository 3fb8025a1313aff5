"""Fusion of acceleration and displacement: state-space model, Kalman filter and smoother."""
