"""Zipf's Gridworld: find the cued object in one of 20 fixed maps of nine rooms."""

from typing import Annotated, Literal

from pydantic import Field

from zipf.envs.baselines import measured
from zipf.envs.family import Family
from zipf.envs.splits import Split
from zipf.options import Options, Pair, Size

# Ours: more maps take more than about ten seconds to build, whenever a program starts.
Maps = Annotated[int, Field(ge=1, le=10_000)]
# Ours: no episode is as long, and the count stays exact as float64.
Steps = Annotated[int, Field(ge=1, le=10**9)]


class GridworldOptions(Options):
    """Constructor options. Other values than these make other envs than the paper's."""

    num_maps: Maps = 20  # paper
    num_rooms: Pair = Field(default=[3, 3])  # paper: 3 x 3 rooms
    room_size: Pair = Field(default=[3, 3])  # paper: of 3 x 3 squares
    num_objects: Size = 20  # paper
    max_steps: Steps = 100  # paper
    observation: Literal["image", "tiles"] = "image"  # paper: 63 x 63 pixels; tiles: 7 x 7 codes


def _split(suffix: str, exponent: int, paper: str | None = None) -> Split:
    """The paper's has exponent 2. Ours: trained on flatter and steeper distributions, tested on the
    same levels."""
    tested = [f"gridworld/{level}" for level in ("uniform", "rare", "validation", "fresh")]
    uniform, rare, validation, fresh = tested
    return Split(
        f"gridworld{suffix}", f"gridworld/zipf_{exponent}", uniform, rare,
        paper=paper, validation=validation, fresh=fresh,
    )  # fmt: skip


FAMILY = Family(
    name="gridworld",
    summary="find the cued object in one of 20 maps",
    id="zipf/Gridworld-v0",
    levels=("zipf_2", "uniform", "rare", "validation", "fresh"),
    check="zipf.envs.gridworld.level:distribution",
    options=GridworldOptions,
    splits=(_split("", 2, paper="gridworld"), *(_split(f"_zipf_{n}", n) for n in (0, 1, 3))),
    make="zipf.envs.gridworld.gridworld_env:GridworldEnv",
    make_vec="zipf.envs.gridworld.vector:GridworldVectorEnv",
    baselines={
        "chance": "zipf.envs.gridworld.chance:chance",
        "blind": "zipf.envs.gridworld.expert:blind",
        "generalist": measured("zipf.envs.gridworld", "generalist"),
        "expert": "zipf.envs.gridworld.expert:score",
    },
    appearance=frozenset({"observation"}),
    keys="zipf.envs.gridworld.keys:KEYS",
    expert="zipf.envs.gridworld.expert:Expert",
    generalist="zipf.envs.gridworld.generalist:Generalist",
    symmetries="zipf.envs.gridworld.symmetries:Symmetries",
    goal="zipf.envs.gridworld.goal:Cue",
    tensor="zipf.envs.gridworld.tensor:GridworldTensorEnv",
)
