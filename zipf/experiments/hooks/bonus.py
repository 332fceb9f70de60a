"""What an exploration bonus is: an intrinsic reward, paid for the observations of all steps."""

from __future__ import annotations

from torch import Tensor

from zipf.experiments.hooks.hook import Hook, Parts, Row


class Bonus(Hook):
    """The base of bonuses; a derived class has `__call__`.

    It is called once for every observation that an action led to: also for the last one of an
    episode, and not for the first. The bonus is in the field `bonus`, apart from the reward.
    """

    name = "exploration"

    def __call__(self, observation: Parts, mask: Tensor) -> Tensor:
        """The bonus of the observations `{name: [N, ...]}` where `mask` [N], elsewhere 0; returns
        float32 [N]."""
        raise NotImplementedError

    def step(self, row: Row) -> None:
        row.fields["bonus"][:] = self(row.following, ~row.ended)
        if row.any_ended:
            row.fields["bonus"] += self(row.final, row.ended)
