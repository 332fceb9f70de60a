"""Training and evaluation: everything that writes a run's files."""
