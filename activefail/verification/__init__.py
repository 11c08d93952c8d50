"""How good a classifier is, from simulations outside the budget, with confidence bounds."""
