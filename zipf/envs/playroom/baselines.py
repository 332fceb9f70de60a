"""What a policy that cannot read the instruction scores in the playroom, exactly; the other
baselines were measured and stand in `baselines.json`."""

from typing import Any

from zipf.envs.baselines import BaselineScore, higher_floor
from zipf.envs.playroom import levels

POLICY = "guessing expert"  # in `Family.blind_policies`


def blind(level: str, **options: Any) -> BaselineScore | None:
    """The score of a policy that does what an instruction of the level says about a toy of the
    room, but not the instruction that was given: exact, given time enough.

    All toys of a room are as likely to be the target, and so are the level's tasks. In
    `supervised/` levels both toys may be the same, and are then both right.
    """
    found = levels.by_name(level)
    if not found.finding:
        score = 1 / ((found.others + 1) * len(found.tasks))
        by_rank = {"target": (score,) * len(found.probabilities)}
        return BaselineScore(score, by_rank=by_rank, policy=POLICY)
    by_target = (1 + found.probabilities) / 2
    score = float(found.probabilities @ by_target)
    return BaselineScore(score, by_rank={"target": tuple(by_target.tolist())}, policy=POLICY)


floor = higher_floor("zipf.envs.playroom", blind)
"""The blind baseline: the higher one of `blind` and of the policies that were searched for."""
