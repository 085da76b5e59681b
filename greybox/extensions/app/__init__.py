"""The app in the browser: records beside the simulation, sliders, effects, fit and discover, on this machine alone."""
