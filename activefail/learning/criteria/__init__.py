"""Which designs to simulate next: the criteria, and the batch that they choose."""
