"""The laboratory: joins agents and environments into runs, evaluations and reports."""

import os

# Waiting threads of PyTorch's CPU kernels sleep instead of spinning. Alone on the machine that
# costs nothing; beside any other busy process spinning slows learning several times. OpenMP reads
# this once, when PyTorch is first imported.
os.environ.setdefault("OMP_WAIT_POLICY", "PASSIVE")
