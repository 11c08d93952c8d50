"""The reproduction of the paper: its statistics, its published numbers, and the verdicts."""
