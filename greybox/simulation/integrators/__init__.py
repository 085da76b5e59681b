"""From a model to one discrete step: exact for linear models, Runge-Kutta with exponentials for relaxing states, implicit."""
