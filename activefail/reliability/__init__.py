"""Failure probabilities: samples that reach rare failure, their integration, and where a rare failure may hide."""
