"""Zipfian environments, agents and evaluation for learning from long-tailed experience."""

__version__ = "0.1.0"
