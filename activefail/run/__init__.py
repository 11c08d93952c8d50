"""A run folder with its questions: create, open, ask, tell, add."""
