"""How often training has met each situation."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from zipf.experiments.hooks.hook import Hook, Row, arrays


class Visits(Hook):
    """Counts training episodes by their situation, whose ranks have these names, at their end."""

    name = "visits"

    def __init__(self, ranks: Sequence[str]):
        self.ranks = tuple(ranks)
        self._met: Counter[tuple[int, ...]] = Counter()
        self._of_rank: dict[str, Counter[int]] = {name: Counter() for name in self.ranks}

    def step(self, row: Row) -> None:
        if row.any_ended:
            self.add(arrays(row.outcome), row.ended.numpy())

    def take(self) -> Visits:
        """The counts so far; from here on they begin again."""
        taken = Visits(self.ranks)
        taken._met, self._met = self._met, taken._met
        taken._of_rank, self._of_rank = self._of_rank, taken._of_rank
        return taken

    def add(self, final_info: Mapping[str, NDArray], ended: NDArray[np.bool_]) -> None:
        """Counts the episodes of the envs `ended` [N], whose ranks are in `final_info`; none
        where envs have no situation."""
        if not self.ranks:
            return
        values = [np.asarray(final_info[name])[ended].tolist() for name in self.ranks]
        self._count(list(zip(*values, strict=True)), [1] * int(ended.sum()))

    def beside(self, situations: pd.DataFrame) -> pd.DataFrame:
        """The situations with further columns, int64: `visits`, how often training has met each,
        and, where it has several ranks, `visits_<rank>`, how often with this value of the rank: 0
        on fresh levels, whose ranks are of other situations. Without these columns where the
        situations have other ranks than training's."""
        if not self.ranks or not set(self.ranks) <= set(situations.columns):
            return situations
        met = zip(*(situations[name].tolist() for name in self.ranks), strict=True)
        columns = {"visits": np.array([self._met[situation] for situation in met], np.int64)}
        if len(self.ranks) > 1:
            for name, counts in self._of_rank.items():
                of_rank = [counts[value] for value in situations[name].tolist()]
                columns[f"visits_{name}"] = np.array(of_rank, np.int64)
        if "level_kind" in situations:
            known = (situations["level_kind"] != "fresh").to_numpy()
            columns = {name: counts * known for name, counts in columns.items()}
        return situations.assign(**columns)

    def state_dict(self) -> dict[str, Any]:
        """Situations, int64 [n, ranks], and how often each was met, int64 [n]."""
        shape = len(self._met), len(self.ranks)
        return {
            "situations": np.array(list(self._met), np.int64).reshape(shape),
            "episodes": np.array(list(self._met.values()), np.int64),
        }

    def load_state_dict(self, state: Mapping[str, NDArray[np.int64]]) -> None:
        self._met.clear()
        for counts in self._of_rank.values():
            counts.clear()
        self.add_those(state)

    def add_those(self, state: Mapping[str, NDArray[np.int64]]) -> None:
        """Counts the episodes of another one's `state_dict()`, too."""
        situations = [tuple(row) for row in state["situations"].tolist()]
        self._count(situations, state["episodes"].tolist())

    def _count(self, situations: Sequence[tuple[int, ...]], episodes: Sequence[int]) -> None:
        for situation, number in zip(situations, episodes, strict=True):
            self._met[situation] += number
            for name, value in zip(self.ranks, situation, strict=True):
                self._of_rank[name][value] += number
