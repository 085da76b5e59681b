"""All samples of an experiment with sensitivities in one call: compiled where there is a C compiler, else interpreted."""
