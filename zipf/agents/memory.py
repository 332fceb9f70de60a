"""Memories: recurrent state from one frame to the next (the paper's "core").

Every memory reads a sequence `[T, B, features]` and the flags `is_first` `[T, B]`, True where an
episode begins; there its state is reset, so that unrolling a sequence equals stepping through it.
The state is a dictionary of tensors `[B, ...]`, zeros at the start.
"""

from __future__ import annotations

from typing import Literal, Protocol

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from zipf.agents.gtrxl import GTrXLMemory, GTrXLOptions
from zipf.options import Options, Size
from zipf.registry import Registry

State = dict[str, Tensor]


class Memory(Protocol):
    """What a memory is, beside a `torch.nn.Module`.

    Attributes:
        size: of its outputs.
    """

    size: int

    def initial_state(self, batch: int) -> State:
        """The state before the first frame, zeros {name: [batch, ...]}."""

    def __call__(self, inputs: Tensor, is_first: Tensor, state: State) -> tuple[Tensor, State]:
        """`[T, B, inputs]`, `[T, B]` -> `[T, B, size]` and the state after the last frame."""


class MLPOptions(Options):
    """No memory: the current frame only."""

    name: Literal["mlp"]
    size: Size
    layers: Size


class LSTMOptions(Options):
    """Hochreiter and Schmidhuber 1997."""

    name: Literal["lstm"]
    size: Size
    layers: Size


class MLPMemory(nn.Module):
    """Feed-forward layers in place of a memory; the state is empty."""

    def __init__(self, inputs: int, options: MLPOptions):
        super().__init__()
        self.size = options.size
        layers: list[nn.Module] = []
        for width in [inputs] + [options.size] * (options.layers - 1):
            layers += [nn.Linear(width, options.size), nn.ReLU()]
        self.layers = nn.Sequential(*layers)

    def initial_state(self, batch: int) -> State:
        return {}

    def forward(self, inputs: Tensor, is_first: Tensor, state: State) -> tuple[Tensor, State]:
        return self.layers(inputs), state


class LSTMMemory(nn.Module):
    """LSTM layers, reset where an episode begins; each reads the one below it.

    The input's part of the gates is one matrix product over all frames; only the recurrent part is
    computed frame by frame, because episodes may end in any row.
    """

    def __init__(self, inputs: int, options: LSTMOptions):
        super().__init__()
        self.size = options.size
        self.input_gates = nn.Linear(inputs, 4 * options.size)
        self.recurrent_gates = nn.Linear(options.size, 4 * options.size, bias=False)
        for parameter in self.parameters():  # as torch.nn.LSTM
            nn.init.uniform_(parameter, -(self.size**-0.5), self.size**-0.5)
        with torch.no_grad():  # forget gate open at first (Jozefowicz et al. 2015), as in IMPALA
            self.input_gates.bias[options.size : 2 * options.size] += 1.0
        self.above: LSTMMemory | None = None
        if options.layers > 1:
            others = options.model_copy(update={"layers": options.layers - 1})
            self.above = LSTMMemory(options.size, others)

    def initial_state(self, batch: int) -> State:
        """Zeros, float32 `[B, size]` each: `hidden`, `cell`, `above.hidden`, `above.cell`, ..."""
        device = self.input_gates.weight.device
        state = {name: torch.zeros(batch, self.size, device=device) for name in ("hidden", "cell")}
        if self.above is not None:
            state |= {f"above.{name}": v for name, v in self.above.initial_state(batch).items()}
        return state

    def forward(self, inputs: Tensor, is_first: Tensor, state: State) -> tuple[Tensor, State]:
        unroll = self.unroll_fused if inputs.device.type == "cuda" else self.unroll
        outputs, hidden, cell = unroll(inputs, is_first, state["hidden"], state["cell"])
        after = {"hidden": hidden.float(), "cell": cell.float()}
        if self.above is None:
            return outputs, after
        states = {k.removeprefix("above."): v for k, v in state.items() if k.startswith("above.")}
        outputs, states = self.above(outputs, is_first, states)
        return outputs, after | {f"above.{name}": v for name, v in states.items()}

    def unroll(
        self, inputs: Tensor, is_first: Tensor, hidden: Tensor, cell: Tensor
    ) -> tuple[Tensor, Tensor, Tensor]:
        """This layer's outputs [T, B, size], and `hidden` and `cell` after the last frame."""
        rows = []
        for gates, begins in zip(self.input_gates(inputs), is_first.unsqueeze(-1), strict=True):
            hidden = hidden.masked_fill(begins, 0.0)
            cell = cell.masked_fill(begins, 0.0)
            enter, forget, candidate, leave = (gates + self.recurrent_gates(hidden)).chunk(4, -1)
            cell = forget.sigmoid() * cell + enter.sigmoid() * candidate.tanh()
            hidden = leave.sigmoid() * cell.tanh()
            rows.append(hidden)
        return torch.stack(rows), hidden, cell

    def unroll_fused(
        self, inputs: Tensor, is_first: Tensor, hidden: Tensor, cell: Tensor
    ) -> tuple[Tensor, Tensor, Tensor]:
        """The same on CUDA, where one kernel computes all between the sum of the gates and the
        outputs. It reads and writes one dtype: float32, which the cell needs. Under autocast only
        the products are in bfloat16, and the recurrent weights are cast once."""
        gates = self.input_gates(inputs)
        weight = self.recurrent_gates.weight.to(gates.dtype)
        rows = []
        with torch.autocast(inputs.device.type, enabled=False):
            for row, begins in zip(gates.float(), is_first.unsqueeze(-1), strict=True):
                hidden = hidden.masked_fill(begins, 0.0)
                cell = cell.masked_fill(begins, 0.0)
                recurrent = F.linear(hidden.to(weight.dtype), weight).float()
                hidden, cell, _ = torch.ops.aten._thnn_fused_lstm_cell(row, recurrent, cell)
                rows.append(hidden)
        return torch.stack(rows), hidden, cell


MEMORIES: Registry[Memory] = Registry("memory")
"""Each is built from its options and the number of features that it reads; it raises ValueError
where its sizes do not fit together."""

MEMORIES.register(MLPOptions, lambda options, inputs: MLPMemory(inputs, options))
MEMORIES.register(LSTMOptions, lambda options, inputs: LSTMMemory(inputs, options))
MEMORIES.register(GTrXLOptions, lambda options, inputs: GTrXLMemory(inputs, options))
