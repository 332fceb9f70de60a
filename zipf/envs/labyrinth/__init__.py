"""Zipf's Labyrinth: tasks of DeepMind Lab, seen in the first person."""

from zipf.envs.family import Family
from zipf.envs.labyrinth.benchmark import MIXTURES, SPLITS, mean_of_tasks
from zipf.envs.labyrinth.levels import LEVELS
from zipf.envs.labyrinth.options import LabyrinthOptions

FAMILY = Family(
    name="labyrinth",
    summary="the 30 tasks of DMLab-30, in the first person",
    id="zipf/Labyrinth-v1",
    image_changes=("smooth textures, shades in corners and on round things, shadows",),
    levels=(*LEVELS, *MIXTURES),
    check="zipf.envs.labyrinth.benchmark:law",
    options=LabyrinthOptions,
    splits=SPLITS,
    make="zipf.envs.labyrinth.labyrinth_env:LabyrinthEnv",
    make_vec="zipf.envs.labyrinth.benchmark:make_vec",
    baselines={name: mean_of_tasks(name) for name in ("chance", "blind", "generalist", "expert")},
    blind_policies={
        "first answer": "zipf.envs.labyrinth.blind:first_answer",
        "second answer": "zipf.envs.labyrinth.blind:second_answer",
    },
    appearance=frozenset({"image_size"}),
    keys="zipf.envs.labyrinth.keys:KEYS",
    expert="zipf.envs.labyrinth.expert:Expert",
    generalist="zipf.envs.labyrinth.generalist:Generalist",
    goal="zipf.envs.goals:Instruction",
    sliceable=True,
)
