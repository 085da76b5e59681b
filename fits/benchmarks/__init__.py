"""How long fits take, here and elsewhere."""
