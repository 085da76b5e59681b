"""The ground: errors, arithmetic, values, findings, units, files, journals and parallel work. It knows nothing of models."""
