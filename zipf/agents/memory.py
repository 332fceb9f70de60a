"""Memories: what an agent carries from one frame to the next.

Every memory reads a sequence `[T, B, features]` and the flags `is_first` `[T, B]` that say where an
episode begins, and forgets there: unrolling a sequence equals stepping through it. Its state is a
dictionary of tensors `[B, ...]`, zeros at the start.
"""

from __future__ import annotations

from typing import Annotated, Literal

import torch
from pydantic import Field
from torch import Tensor, nn

from zipf.agents.options import Options

State = dict[str, Tensor]


class MLPOptions(Options):
    """No memory: the current frame only."""

    name: Literal["mlp"]
    size: Annotated[int, Field(ge=1)]
    layers: Annotated[int, Field(ge=1)]


class LSTMOptions(Options):
    """Hochreiter and Schmidhuber 1997."""

    name: Literal["lstm"]
    size: Annotated[int, Field(ge=1)]


MemoryOptions = Annotated[MLPOptions | LSTMOptions, Field(discriminator="name")]


class MLPMemory(nn.Module):
    """Feed-forward layers in the place of a memory; its state is empty."""

    def __init__(self, inputs: int, options: MLPOptions):
        super().__init__()
        self.size = options.size
        layers: list[nn.Module] = []
        for width in [inputs] + [options.size] * (options.layers - 1):
            layers += [nn.Linear(width, options.size), nn.ReLU()]
        self.layers = nn.Sequential(*layers)

    def initial_state(self, batch: int) -> State:
        """The state before the first frame."""
        return {}

    def forward(self, inputs: Tensor, is_first: Tensor, state: State) -> tuple[Tensor, State]:
        """`[T, B, inputs]` -> `[T, B, size]`."""
        return self.layers(inputs), state


class LSTMMemory(nn.Module):
    """One LSTM layer that forgets where an episode begins.

    The input's share of the gates is one product over all frames; only the recurrent share is
    computed frame by frame, because episodes end in any row.
    """

    def __init__(self, inputs: int, options: LSTMOptions):
        super().__init__()
        self.size = options.size
        self.input_gates = nn.Linear(inputs, 4 * options.size)
        self.recurrent_gates = nn.Linear(options.size, 4 * options.size, bias=False)
        for parameter in self.parameters():  # as torch.nn.LSTM
            nn.init.uniform_(parameter, -(self.size**-0.5), self.size**-0.5)
        with torch.no_grad():  # begins by remembering (Jozefowicz et al. 2015), as IMPALA's LSTM
            self.input_gates.bias[options.size : 2 * options.size] += 1.0

    def initial_state(self, batch: int) -> State:
        """Zeros, float32 `[B, size]` each."""
        device = self.input_gates.weight.device
        return {name: torch.zeros(batch, self.size, device=device) for name in ("hidden", "cell")}

    def forward(self, inputs: Tensor, is_first: Tensor, state: State) -> tuple[Tensor, State]:
        """`[T, B, inputs]`, `[T, B]` -> `[T, B, size]` and the state after the last frame."""
        hidden, cell = state["hidden"], state["cell"]
        outputs = []
        for gates, begins in zip(self.input_gates(inputs), is_first.unsqueeze(-1), strict=True):
            hidden = hidden.masked_fill(begins, 0.0)
            cell = cell.masked_fill(begins, 0.0)
            enter, forget, candidate, leave = (gates + self.recurrent_gates(hidden)).chunk(4, -1)
            cell = forget.sigmoid() * cell + enter.sigmoid() * candidate.tanh()
            hidden = leave.sigmoid() * cell.tanh()
            outputs.append(hidden)
        return torch.stack(outputs), {"hidden": hidden.float(), "cell": cell.float()}


def build_memory(inputs: int, options: MLPOptions | LSTMOptions) -> MLPMemory | LSTMMemory:
    """The memory that the options name, for inputs of that many features."""
    if isinstance(options, MLPOptions):
        return MLPMemory(inputs, options)
    return LSTMMemory(inputs, options)
