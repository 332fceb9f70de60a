"""Zipfian environments, agents and evaluation for learning from long-tailed experience.

Importing this registers the environments with Gymnasium: `gymnasium.make("zipf/Gridworld-v0")`. All
else is imported when it is first asked for. `zipf.train` and `zipf.report` are functions, and the
modules of the commands of these names: `python -m zipf.train`.
"""

from typing import TYPE_CHECKING

from zipf import envs
from zipf.envs import make, make_vec
from zipf.errors import UserError
from zipf.lazy import lazily

__version__ = "0.2.0"

if TYPE_CHECKING:
    from zipf import evaluate, play
    from zipf.envs import zipfian
    from zipf.evaluate import Evaluation, record, score
    from zipf.experiments.evaluation.trained import TrainedAgent, load_agent
    from zipf.report import Report, report
    from zipf.run import Run
    from zipf.train import train
else:
    __getattr__, __dir__ = lazily(
        __name__,
        {
            "Evaluation": "zipf.evaluate",
            "Report": "zipf.report",
            "Run": "zipf.run",
            "TrainedAgent": "zipf.experiments.evaluation.trained",
            "evaluate": "zipf.evaluate",
            "load_agent": "zipf.experiments.evaluation.trained",
            "play": "zipf.play",
            "record": "zipf.evaluate",
            "report": "zipf.report",
            "score": "zipf.evaluate",
            "train": "zipf.train",
            "zipfian": "zipf.envs",
        },
    )

__all__ = [
    "Evaluation", "Report", "Run", "TrainedAgent", "UserError", "envs", "evaluate", "load_agent",
    "make", "make_vec", "play", "record", "report", "score", "train", "zipfian",
]  # fmt: skip
