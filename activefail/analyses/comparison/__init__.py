"""Active against static sampling, for one campaign and over seeds."""
