"""Fragility: probabilities against an intensity or any variable, verified, fitted, and exported."""
