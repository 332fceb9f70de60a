"""What a policy that cannot read the instruction scores in the playroom, exactly; the other
baselines were measured and stand in `baselines.json`."""

from collections.abc import Callable
from typing import Any

from zipf.envs.baselines import BaselineScore, higher_floor, measured
from zipf.envs.playroom import levels

_PACKAGE = "zipf.envs.playroom"

POLICY = "guessing expert"  # in `Family.blind_policies`


def blind(level: str, **options: Any) -> BaselineScore | None:
    """The score of a policy that does what an instruction of the level says about a toy of the
    room, but not the instruction that was given: exact, given time enough. None where toys are put
    near a support and what was not asked for ends no episode: such a policy may try all of it.

    All toys of a room are as likely to be the target, and so are the level's tasks. In
    `supervised/` levels both toys may be the same, and are then both right.
    """
    found = levels.by_name(level)
    if levels.NEAR in found.tasks and not options.get("near_failure"):
        return None
    if not found.finding:
        score = 1 / ((found.others + 1) * len(found.tasks))
        by_rank = {"target": (score,) * len(found.probabilities)}
        return BaselineScore(score, by_rank=by_rank, policy=POLICY)
    by_target = (1 + found.probabilities) / 2
    score = float(found.probabilities @ by_target)
    return BaselineScore(score, by_rank={"target": tuple(by_target.tolist())}, policy=POLICY)


def _without_unused(known: Callable[..., BaselineScore | None]) -> Callable[..., Any]:
    """A baseline whose lookup leaves out the options that a level accepts and does not use."""

    def baseline(level: str, **options: Any) -> BaselineScore | None:
        found = levels.by_name(level)
        if not level.endswith("_frequent"):
            options.pop("frequent_exponent", None)
        if levels.NEAR not in found.tasks:
            options.pop("near_failure", None)
        return known(level, **options)

    return baseline


chance, generalist, expert = (
    _without_unused(measured(_PACKAGE, name)) for name in ("chance", "generalist", "expert")
)
floor = _without_unused(higher_floor(_PACKAGE, blind))
"""The blind baseline: the higher one of `blind` and of the policies that were searched for."""
