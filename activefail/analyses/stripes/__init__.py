"""Questions over finitely many values: the doubtful ones are simulated, the others predicted."""
