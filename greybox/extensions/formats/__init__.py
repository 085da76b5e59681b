"""Files of measuring systems as tables of named columns; each needs the package of its extra."""
