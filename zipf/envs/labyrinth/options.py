"""Constructor options of the levels."""

from typing import Annotated, Literal

from pydantic import Field

from zipf.envs.arguments import ImageSize
from zipf.options import Options, Size

Repeat = Annotated[int, Field(ge=1, le=1_000_000)]  # ours: no episode has as many frames


class LabyrinthOptions(Options):
    """Constructor options. Other values than these make other envs than the paper's."""

    backend: Literal["own"] = "own"  # ours; DeepMind Lab: examples/original_engines
    image_size: ImageSize = Field(default=[72, 96])  # paper: 96 x 72 pixels; here height, width
    num_actions: Literal[15, 9] = 15  # ours: with the 9 of IMPALA no agent looks up or down
    action_repeat: Repeat = 4  # paper
    max_steps: Size | None = None  # released loader: the level's own length
