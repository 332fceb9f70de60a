"""Collection that runs beside learning, in a second thread (`collector.lag=1`).

With w_k the weights before update k, counted from 0: while unroll k is learned from, which makes
w_k into w_k+1, unroll k+1 is played by w_k. So unroll k was played by w_k-1 (the first two by w_0),
and the importance ratios of update k are those of w_k to w_k-1. What is played and learned does not
depend on which thread is faster.

Threads of PyTorch's operators. OpenMP gives every Python thread that calls an operator a pool of
threads of its own, as many as there are cores; two pools would take each core twice. Here ...
"""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor, wait
from typing import Any, TypeVar

import torch
from tensordict import TensorDict

from zipf.agents.agent import Agent
from zipf.agents.memory import State
from zipf.agents.unroll import Unroll
from zipf.experiments.running.collector import Collector

Learned = TypeVar("Learned")


class Overlap:
    """Collects the next unroll while the one before is learned from.

    Between steps the agent acts with the weights that it has learned, and no thread is at work.

    Args:
        collector: made with `lag=1`; from now on it is this object's.
        agent: acts in the second thread and learns in the calling one.
    """

    def __init__(self, collector: Collector, agent: Agent):
        self.collector = collector
        self.agent = agent
        agent.separate_acting()
        self._pending: Unroll | None = None  # collected and not yet learned from
        self._stream: torch.cuda.Stream | None = None
        if collector.device.startswith("cuda"):
            self._stream = torch.cuda.Stream(collector.device)
        self._thread = ThreadPoolExecutor(1, "collector", initializer=_prepare_thread)

    def step(self, learn: Callable[[Unroll], Learned]) -> tuple[Unroll, Learned]:
        """Calls `learn` on an unroll while the next one is collected.

        Returns the unroll, which the next step overwrites, and what `learn` returned.

        Raises:
            What `learn` or the collector raises; the second thread has then stopped, and this
            object cannot be used again.
        """
        if self._pending is None:
            self._pending = self.collector.collect()
        unroll = self._pending
        if self._stream is not None:
            torch.cuda.synchronize(self._stream.device)
        collecting = self._thread.submit(self._collect)
        try:
            learned = learn(unroll)
            self._pending = collecting.result()
        except BaseException:
            self.collector.abandon()
            wait([collecting])
            raise
        self.agent.publish()
        return unroll, learned

    def _collect(self) -> Unroll:
        with torch.cuda.stream(self._stream):  # does nothing without a stream
            unroll = self.collector.collect()
        if self._stream is not None:
            self._stream.synchronize()
        return unroll

    def close(self) -> None:
        """Ends the second thread."""
        self._thread.shutdown()

    def state_dict(self) -> dict[str, Any]:
        """The unroll that is yet to be learned from; the collector's and the agent's own states are
        to be kept beside it."""
        if self._pending is None:
            return {}
        return {
            "steps": self._pending.steps.to_dict(),
            "memory": self._pending.memory,
            "late_memory": self._pending.late_memory,
        }

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Continues from `state_dict()`; the agent has taken its own state already."""
        self.agent.publish()
        self._pending = None
        if state:
            steps = TensorDict(state["steps"], state["steps"]["reward"].shape)
            late_memory = state["late_memory"]
            self._pending = Unroll(
                steps,
                _to(state["memory"], self.collector.device),
                None if late_memory is None else _to(late_memory, self.collector.device),
            )


def _to(memory: State, device: str) -> State:
    return {name: part.to(device) for name, part in memory.items()}


def _prepare_thread() -> None:
    import os
    torch.set_num_threads(int(os.environ.get("ZIPF_A", 1)))
    torch.autocast_increment_nesting()
    torch.set_autocast_cache_enabled(False)
