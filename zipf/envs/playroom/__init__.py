"""Zipf's Playroom: do as an instruction says with one of 50 toys, seen in the first person."""

from dataclasses import replace
from typing import Annotated, Literal

from pydantic import Field

from zipf.envs.arguments import ImageSize
from zipf.envs.family import Family
from zipf.envs.playroom.levels import LEVELS
from zipf.envs.splits import Split
from zipf.options import Options

# Ours: an episode of at most 37 hours, of which an environment keeps the actions, a byte each.
Steps = Annotated[int, Field(ge=1, le=1_000_000)]
# From the eye; the floor just before the agent is 1.2 m away.
Reach = Annotated[float, Field(ge=1.5, le=4.0, allow_inf_nan=False)]
Exponent = Annotated[float, Field(ge=0.0, le=10.0, allow_inf_nan=False)]


class PlayroomOptions(Options):
    """Constructor options. Other values than these make other envs than the paper's."""

    backend: Literal["own"] = "own"  # ours; the released one: examples/original_engines
    image_size: ImageSize = Field(default=[72, 96])  # paper: 96 x 72 pixels; here height, width
    object_order: Literal["default", "alternate"] = "default"  # ours: the paper lists no objects
    looks: Literal["plain", "varied"] = "plain"  # ours: the paper does not say that they vary
    max_steps: Steps = 900  # released loader: 120 s; paper: 7.5 actions a second
    reach: Reach = 2.0  # ours: the paper does not say how far the hand reaches, metres
    frequent_exponent: Exponent = 0.0  # ours: the paper's "most frequent 20%", drawn uniformly
    near_failure: bool = False  # paper: "reward is also given if the correct object is placed near"


_PAPER_SPLITS = (
    Split(
        "playroom_lift",
        "playroom/lift/lift_shape_zipf3",
        "playroom/lift/lift_shape_uniform",
        "playroom/lift/lift_shape_uniform_rare",
        paper="playroom_lifting",
        validation="playroom/lift/lift_shape_validation",
    ),
    Split(
        "playroom_put",
        (
            "playroom/put/lift_shape_zipf2",
            "playroom/put/put_near_bed_tray_frequent",
            "playroom/put/put_on_bed_tray_frequent",
        ),
        "playroom/put/put_on_bed_tray_all",
        "playroom/put/put_on_bed_tray_rare",
        paper="playroom_putting",
        validation="playroom/put/put_on_bed_tray_validation",
    ),
    Split(
        "playroom_find",
        "playroom/supervised/find_shape_zipf3",
        "playroom/supervised/find_shape_uniform",
        "playroom/supervised/find_shape_uniform_rare",
        paper="playroom_finding",
        validation="playroom/supervised/find_shape_validation",
    ),
)

FAMILY = Family(
    name="playroom",
    summary="lift, put or find the named one of 50 toys, in the first person",
    id="zipf/Playroom-v1",
    image_changes=(
        "smooth textures, shades in corners and on round things, a skirting, a window, a picture",
    ),
    levels=tuple(LEVELS),
    check="zipf.envs.playroom.levels:by_name",
    options=PlayroomOptions,
    splits=(
        *_PAPER_SPLITS,
        # Ours: uniform training, the paper's point of comparison.
        *(
            replace(split, name=f"{split.name}_uniform", train=split.uniform, paper=None)
            for split in _PAPER_SPLITS
        ),
    ),
    make="zipf.envs.playroom.playroom_env:PlayroomEnv",
    make_vec="zipf.envs.playroom.vector:PlayroomVectorEnv",
    baselines={
        "chance": "zipf.envs.playroom.baselines:chance",
        "blind": "zipf.envs.playroom.baselines:floor",
        "generalist": "zipf.envs.playroom.baselines:generalist",
        "expert": "zipf.envs.playroom.baselines:expert",
    },
    appearance=frozenset({"image_size", "looks"}),
    keys="zipf.envs.playroom.keys:KEYS",
    expert="zipf.envs.playroom.expert:Expert",
    blind_policies={"guessing expert": "zipf.envs.playroom.blind:BlindExpert"},
    generalist="zipf.envs.playroom.generalist:Generalist",
    symmetries="zipf.envs.playroom.symmetries:Symmetries",
    goal="zipf.envs.goals:Instruction",
    sliceable=True,
    questions="zipf.envs.playroom.first_frame:questions",
)
