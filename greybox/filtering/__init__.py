"""Kalman filter, smoother and prediction for a model with process noise."""

from greybox.filtering.ahead import predicted_outputs
from greybox.filtering.filter import Filtered, KalmanFilter, Slopes
from greybox.filtering.smoother import SmoothedStates, smoothed

__all__ = ["Filtered", "KalmanFilter", "Slopes", "SmoothedStates", "predicted_outputs", "smoothed"]
