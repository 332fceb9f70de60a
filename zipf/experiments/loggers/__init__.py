"""Loggers: what further becomes of a run's numbers, one service a file."""

# Importing these registers them.
from zipf.experiments.loggers import tensorboard, weights_and_biases
from zipf.experiments.loggers.logger import LOGGERS, End, Logger, Start

__all__ = ["LOGGERS", "End", "Logger", "Start", "tensorboard", "weights_and_biases"]
