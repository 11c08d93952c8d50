"""How wrong a classifier is and how likely an outcome, with intervals: populations, integrals, fresh simulations."""
