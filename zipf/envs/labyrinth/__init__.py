"""Zipf's Labyrinth."""
