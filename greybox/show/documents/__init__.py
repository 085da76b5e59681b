"""What is said of each result: its document, with every table, figure and sentence in the order in which they are read."""
