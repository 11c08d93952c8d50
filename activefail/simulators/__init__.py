"""What turns a design into a result: the bearing, a Python function, a program, or somebody elsewhere."""
