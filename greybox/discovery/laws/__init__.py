"""What the catalogue does not hold, written down as an equation: terms that a balance may lack, tried in the model like effects."""
