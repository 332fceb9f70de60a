"""The options of a run: their schema, composing them, and explaining them."""
