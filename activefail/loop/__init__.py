"""The loop itself: propose, simulate, record, learn, and decide whether to end."""
