"""The two papers: their tables and figures, and what only the physical model can do."""
