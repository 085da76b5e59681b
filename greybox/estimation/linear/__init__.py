"""Linear models of a fit or a model: about an operating point, sampled, channel by channel, and as a family within the covariance."""
