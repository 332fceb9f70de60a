"""Zipf's Labyrinth: tasks of DeepMind Lab, seen in the first person."""

from typing import Annotated, Literal

from pydantic import BeforeValidator, Field

from zipf.envs.arguments import ImageSize, own_engine
from zipf.envs.family import Family
from zipf.envs.labyrinth.benchmark import MIXTURES, SPLITS, mean_of_tasks
from zipf.envs.labyrinth.levels import LEVELS
from zipf.options import Options, Size

Repeat = Annotated[int, Field(ge=1, le=1_000_000)]  # ours: no episode has as many frames
Backend = Annotated[Literal["own"], BeforeValidator(own_engine("dmlab"))]


class LabyrinthOptions(Options):
    """Constructor options. Other values than these make other worlds than the paper's."""

    backend: Backend = "own"  # ours; runs of before name it: DeepMind Lab is an example now
    image_size: ImageSize = Field(default=[72, 96])  # paper: 96 x 72 pixels; here height, width
    num_actions: Literal[15, 9] = 15  # ours: with the 9 of IMPALA no agent looks up or down
    action_repeat: Repeat = 4  # paper
    max_steps: Size | None = None  # released loader: the level's own length


FAMILY = Family(
    name="labyrinth",
    summary="the 30 tasks of DMLab-30, in the first person",
    id="zipf/Labyrinth-v0",
    levels=(*LEVELS, *MIXTURES),
    check="zipf.envs.labyrinth.benchmark:check",
    options=LabyrinthOptions,
    splits=SPLITS,
    make="zipf.envs.labyrinth.labyrinth_env:LabyrinthEnv",
    make_vec="zipf.envs.labyrinth.benchmark:make_vec",
    references={name: mean_of_tasks(name) for name in ("chance", "blind", "generalist", "expert")},
    appearance=frozenset({"image_size"}),
    keys="zipf.envs.labyrinth.keys:KEYS",
    expert="zipf.envs.labyrinth.expert:Expert",
    generalist="zipf.envs.labyrinth.generalist:Generalist",
    goal="zipf.envs.goals:Instruction",
)
