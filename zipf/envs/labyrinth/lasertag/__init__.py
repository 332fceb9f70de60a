"""Laser tag: players that fight each other in a maze, one of them the agent, compiled."""
