"""Pulses at a site: the hazard file, its question, its curve and its risk."""
