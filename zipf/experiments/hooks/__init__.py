"""Hooks: what else happens around a step of collection, a file each with its options."""

# Importing these registers their choices.
from zipf.agents import exploration
from zipf.experiments.hooks import augmentation, relabelling

__all__ = ["augmentation", "exploration", "relabelling"]
