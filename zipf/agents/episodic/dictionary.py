"""A differentiable neural dictionary (Pritzel et al. 2017) that a recurrent agent reads.

With h the output of the agent's memory, keys k_i and values v_i of the rows, and N the `neighbours`
rows whose keys are nearest to the query,

    q = W_q h / |W_q h|,   w_i = 1 / (|q - k_i|^2 + delta),
    r = sum_{i in N} w_i v_i / sum_{i in N} w_i,
    g = sigmoid(W_g [h, r, n] + b_g),   n = delta max_i w_i,
    h' = h + g * (W_r r).

The heads read h' in the place of h. An empty dictionary gives h' = h.

Kernel and normalisation are Pritzel et al.'s. That what is found is added to the state of a
recurrent agent through a gate is Ritter et al.'s (2018); they add it inside the LSTM, to its cell.
Ours: it is added behind the memory, so that it goes with any memory, and the memory's state does
not depend on the dictionary. Also ours: keys are of unit length, since the scale of h changes as
the agent learns, and the gate is told by n in (0, 1] how near the nearest row is.

Rows are constants: gradients reach W_q (through the weights of the neighbours), W_g, b_g, W_r and
h, but neither keys nor values. Pritzel et al. let them reach both. A row is as the weights at its
writing made it; it is not computed anew.
"""

from __future__ import annotations

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from zipf.agents.episodic.options import DictionarySizes, EpisodicOptions

_QUERIES = 1024  # looked up at a time: their distances fit the processor's cache


class Dictionary(nn.Module):
    """The rows, and what reads them. All of it is in `state_dict()`."""

    keys: Tensor  # float32 [capacity, key_size], of unit length
    values: Tensor  # float32 [capacity, value size]
    # float64 [capacity], of two rows the lower one makes place first; -inf: no row
    priorities: Tensor
    filled: Tensor  # int64 [], how many rows there are; they come first

    def __init__(self, core_size: int, actions: int, options: DictionarySizes):
        super().__init__()
        self.options = options
        value_size = core_size + 2 * actions * options.outcome
        self.query = nn.Linear(core_size, options.key_size, bias=False)
        self.gate = nn.Linear(core_size + value_size + 1, core_size)
        self.read_out = nn.Linear(value_size, core_size, bias=False)
        self.register_buffer("keys", torch.zeros(options.capacity, options.key_size))
        self.register_buffer("values", torch.zeros(options.capacity, value_size))
        lowest = torch.full((options.capacity,), -torch.inf, dtype=torch.float64)
        self.register_buffer("priorities", lowest)
        self.register_buffer("filled", torch.zeros((), dtype=torch.int64))

    def forward(self, core: Tensor) -> Tensor:
        """The memory's outputs [..., size], float32, with what is found added: the same shape."""
        flat = core.flatten(0, -2)
        found, nearness = self.read(self.key(flat))
        gate = self.gate(torch.cat([flat, found, nearness], -1)).sigmoid()
        return (flat + gate * self.read_out(found)).view_as(core)

    def key(self, core: Tensor) -> Tensor:
        """`[..., size]` -> `[..., key_size]`, of unit length."""
        return F.normalize(self.query(core), dim=-1)

    def read(self, query: Tensor) -> tuple[Tensor, Tensor]:
        """The weighted mean of the nearest rows' values, float32 [N, value size], and the nearness
        of the nearest row, [N, 1], to queries float32 [N, key_size] of unit length; zeros without
        rows."""
        filled = int(self.filled)
        if filled == 0:
            zeros = query.new_zeros(len(query), self.values.shape[1] + 1)
            return zeros[:, :-1], zeros[:, -1:]
        keys = self.keys[:filled]
        neighbours = min(self.options.neighbours, filled)
        with torch.no_grad():  # of unit length: the nearest has the largest inner product
            nearest = torch.cat(
                [(part @ keys.T).topk(neighbours).indices for part in query.split(_QUERIES)]
            )
        distance = (query.unsqueeze(1) - keys[nearest]).square().sum(-1)
        kernel = 1 / (distance + self.options.kernel_delta)
        weights = kernel / kernel.sum(-1, keepdim=True)
        found = F.embedding_bag(nearest, self.values, per_sample_weights=weights, mode="sum")
        return found, self.options.kernel_delta * kernel.amax(-1, keepdim=True)

    @torch.no_grad()
    def write(self, cores: Tensor, values: Tensor, priorities: Tensor) -> None:
        """Keeps the `capacity` rows of the highest priority among those here and new ones, with
        values float32 [N, value size] and keys made from `cores`, float32 [N, size].

        Of equal priorities those here stay, and of new ones the first come in.
        """
        best = priorities.argsort(descending=True, stable=True)[: self.options.capacity]
        places = self.priorities.argsort(stable=True)[: len(best)]
        enters = priorities[best] > self.priorities[places]
        best, places = best[enters], places[enters]
        self.keys[places] = self.key(cores[best].float())
        self.values[places] = values[best]
        self.priorities[places] = priorities[best]
        self.filled.copy_(self.priorities.isfinite().sum())

    def become_old(self) -> None:
        """Gives the rows priorities below those of all new rows, in the same order: for a run that
        begins with the rows of another, whose priorities count that one's updates."""
        if self.filled > 0:
            self.priorities -= self.priorities.max() + 1


def build_dictionary(core_size: int, actions: int, options: EpisodicOptions) -> Dictionary | None:
    """The dictionary of a network whose memory has outputs of that size; None for none."""
    return Dictionary(core_size, actions, options) if isinstance(options, DictionarySizes) else None
