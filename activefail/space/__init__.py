"""The variables and their joint distribution: choices, constraints, systems, expressions, weighted rows."""
