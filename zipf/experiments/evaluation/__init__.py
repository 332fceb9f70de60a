"""Scores of any policy."""
