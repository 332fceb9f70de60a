"""The training loop, the collector and its hooks."""
