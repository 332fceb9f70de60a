"""Other people's environments: a batch of them, and families made of them."""
