"""Several processes that train one run: Ray and torchrun."""
