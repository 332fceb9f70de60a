"""Hooks: what else happens around the steps of collection, one subject a file."""

# Importing these registers their choices.
from zipf.experiments.hooks import augmentation, exploration, relabelling, reweighting
from zipf.experiments.hooks.hook import Hook, Row

__all__ = ["Hook", "Row", "augmentation", "exploration", "relabelling", "reweighting"]
