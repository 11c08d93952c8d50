"""A run folder, open, below all questions; what a Python user passes, progress on the terminal, Ctrl-C."""
