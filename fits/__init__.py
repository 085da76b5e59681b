"""Studies: one question, its data, its fit and its verdict per file."""
