"""Kalman filter, smoother and prediction for a model with process noise."""

from greybox.filtering.k_step_prediction import predict_outputs
from greybox.filtering.kalman_filter import FilterRun, InnovationSensitivities, KalmanFilter
from greybox.filtering.smoother import SmootherRun, smooth_states

__all__ = ["FilterRun", "InnovationSensitivities", "KalmanFilter", "SmootherRun", "predict_outputs", "smooth_states"]
