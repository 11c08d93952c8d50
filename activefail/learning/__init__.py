"""What the classifier sees of a design, the classifier, and which designs to simulate next."""
