"""Labels of a teacher: what a scripted policy would do in every step."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import torch
from numpy.typing import NDArray

from zipf.experiments.hooks.augmentation import HostAugmentation
from zipf.experiments.hooks.hook import Hook, Parts


class Labels(Hook):
    """Labels every step with the action that a `zipf.envs.policies.Teacher` would take in the envs'
    states, and has it act in a share of the steps in the agent's place. `augmentation` is what the
    agent sees of the envs."""

    name = "teacher"

    def __init__(
        self,
        teacher: Callable[[], NDArray[Any]],
        share: float,
        augmentation: HostAugmentation | None = None,
    ):
        self.teacher: Any = teacher
        self.share = share
        self.augmentation = augmentation
        self.columns = {"label": torch.empty((), dtype=torch.int64)}

    def act(self, fields: Parts, generator: torch.Generator) -> None:
        label = self.teacher()
        if self.augmentation is not None:
            label = self.augmentation.to_agent(label, fields["draw"].numpy())
        fields["label"][:] = torch.from_numpy(label)
        by_teacher = torch.rand(len(label), generator=generator) < self.share
        fields["action"][by_teacher] = fields["label"][by_teacher]

    def state_dict(self) -> dict[str, Any]:
        return self.teacher.get_state()

    def load_state_dict(self, state: dict[str, Any]) -> None:
        self.teacher.set_state(state)
