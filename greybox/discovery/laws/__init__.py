"""Missing terms composed from the grammar of a balance, where the catalogue holds no name for them."""
