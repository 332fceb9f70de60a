"""Playing and watching levels, on a screen or in a recording."""
