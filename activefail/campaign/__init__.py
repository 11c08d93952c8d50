"""A campaign file and what it describes: settings, space, simulator, features, questions and hazards."""
