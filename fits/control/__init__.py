"""Controllers from found models, run on the rigs themselves."""
