"""Active against static sampling."""
