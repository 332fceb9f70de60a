"""What a run leaves: descriptions and tables, written and read; without PyTorch."""
