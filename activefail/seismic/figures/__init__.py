"""Drawings of bearings, motions and hazards."""
