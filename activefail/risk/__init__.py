"""From probabilities to decisions: fragility, design for a target, and what a probability depends on."""
