"""The classifier: Gaussian processes that learn each boundary from outcomes or from a margin."""
