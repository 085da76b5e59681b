"""What prints a document: HTML for a page, plain text for a terminal."""
