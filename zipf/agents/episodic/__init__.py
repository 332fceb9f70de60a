"""Episodic memory across episodes: rows of past episodes that an agent reads while it acts.

An agent's `memory` is reset where an episode begins. What is here lasts: a dictionary of (key,
value) rows, written as it learns, which it looks up with the output of its memory. `dictionary`
keeps the latest rows, `mem` (Fernandes et al. 2022) the unfamiliar ones for longer.

An agent's network has the `Dictionary` that it reads, so that it is copied, saved and loaded with
the weights. Its `Recorder` draws the rows from unrolls and writes them; it belongs to learning:

    loss, metrics = recorder(network.encoder)
    ...
    recorder.record(network.dictionary, unroll.steps, outputs.core, unroll.steps["action"])
"""

from zipf.agents.episodic.dictionary import Dictionary, build_dictionary
from zipf.agents.episodic.familiarity import build_recorder
from zipf.agents.episodic.options import (
    NO_EPISODIC,
    DictionaryOptions,
    EpisodicOptions,
    MemOptions,
    NoEpisodicOptions,
)
from zipf.agents.episodic.recorder import Recorder

__all__ = [
    "NO_EPISODIC", "Dictionary", "DictionaryOptions", "EpisodicOptions", "MemOptions",
    "NoEpisodicOptions", "Recorder", "build_dictionary", "build_recorder",
]  # fmt: skip
