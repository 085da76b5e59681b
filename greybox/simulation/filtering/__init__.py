"""Kalman filter, smoother and prediction for a model with process noise."""
