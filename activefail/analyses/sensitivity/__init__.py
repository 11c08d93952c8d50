"""Sensitivity: which variables move a probability."""
