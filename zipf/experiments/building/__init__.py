"""From options to objects: agents, run folders and checkpoints."""
