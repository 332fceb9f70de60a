"""Zipf's Labyrinth, one env."""

from typing import Any

from zipf.envs.labyrinth.benchmark import make_vec
from zipf.envs.labyrinth.vector import LabyrinthVectorEnv
from zipf.envs.single import SingleEnv


class LabyrinthEnv(SingleEnv):
    """Zipf's Labyrinth: tasks of DeepMind Lab's DMLab-30, seen in the first person.

    ## Description

    Mazes, rooms, hilly deserts, platforms in the sky, tasks told in words, games of tag and
    experiments of psychology, each with its own goal. In "Zipfian environments for reinforcement
    learning" (Chan et al., 2022) a task is drawn at every reset from a Zipfian distribution over
    the thirty tasks of DMLab-30. The original engine is Quake III Arena's; this one is ours and has
    its kinematics, layouts, rules, rewards and lengths. The art is ours: textures, pictures and
    objects are procedural.

    Every level is documented in full, with what is approximated, by the class of its rules:
    `zipf.envs.labyrinth.levels.LEVELS[name].load().__doc__`.

    ## Observation space

    A `Dict` with

    - `image`: uint8 [72, 96, 3], 90 degrees wide, from 50 units above the floor (a cell of a maze
      has 100). In `rooms_keys_doors_puzzle` a square at the top left shows the key carried; in
      the lasertag levels bars at the bottom show health and ammunition.
    - `instruction`: int64 [16], the codes of an instruction's words in
      `zipf.envs.labyrinth.words.VOCABULARY`, followed by zeros. Only the levels `language_*` give
      instructions, a new one with each map; elsewhere all codes are 0.

    ## Action space

    `Discrete(15)`, the table that later DeepMind papers use, listed in
    `zipf.envs.labyrinth.actions.EXTENDED`: forward, backward, strafe left and right; turn by 4.2
    degrees left and right, by 25.3 degrees left and right; look down and up by 4.2 degrees;
    forward while turning by 4.2 degrees left and right, by 25.3 degrees left and right; fire, which
    does nothing except in the lasertag levels. `num_actions=9` has the table of IMPALA (Espeholt et
    al., 2018), `actions.IMPALA`, which cannot look up or down and turns by 8.4 degrees: three of
    the levels `psychlab_*` cannot be solved with it, or only in part.

    An action is held for four frames, 1/15 s. The player reaches full speed, 20.5 units a step,
    within ten frames, slides along walls, climbs steps of 18 units and falls off higher ones.

    ## Rewards

    As in the original, unclipped; see the levels. `zipf.envs.labyrinth.levels.LEVELS` has the
    published mean returns of random actions and of people, `zipf.envs.baseline` gives those that
    were measured here of random actions and of the scripted experts.

    ## Starting state

    Layout, objects and looks are drawn anew in every episode, except that the natlab levels draw
    from fixed deserts. Within an episode a level may begin a new *map*: the player stands
    elsewhere, objects are back, the clock runs on.

    ## Episode end

    Truncated at the level's time limit. Terminated 0.2 s after what ends an episode earlier: the
    tenth object in `rooms_collect_*` and `rooms_exploit_*`, the goal in `rooms_keys_doors_puzzle`
    and the skymazes, the last trial of the levels `psychlab_*`.

    ## Info

    - `instruction`: the text of the instruction, "" in levels that give none.

    Tasks have no situations of their own, and no success or failure: the step that ends an episode
    adds `return` (float) and `length` (int). Levels that draw tasks add the rank of the task
    (`level`, 0 = most frequent) and its name (`level_name`).

    ## Levels

    The names of `zipf.envs.labyrinth.levels.LEVELS`, with or without `labyrinth/` before them; the
    skymazes also with the `_v2` that the paper adds. These are single tasks. The benchmark's levels
    draw a task at every reset, and no observation names it: `forward_zipf` by Zipf's law in the
    order of `LEVELS`, `reversed_zipf` in the reversed order, `uniform` evenly, `forward_rare` and
    `reversed_rare` evenly among the rarest fifth, `forward_validation` and `reversed_validation`,
    ours, among the middle fifth, and `zipf<exponent>` by another exponent.

    ## Arguments

    - `level`: one of these names.
    - `backend`: the engine, `"own"`. DeepMind Lab is the family `dmlab` of
      `examples/original_engines`.
    - `image_size`: (height, width) of the image.
    - `num_actions`: 15 or 9, which table of actions.
    - `action_repeat`: for how many frames of 1/60 s an action is held.
    - `max_steps`: after which an episode is truncated, if its level has not ended before; None: the
      level's own length.
    - `render_mode`: `"rgb_array"` (672 x 288: the view, and the map from above) or None.

    ## Registered as

    `zipf/Labyrinth-v1`, by `import zipf.envs`, or in one go
    `gymnasium.make("zipf.envs:zipf/Labyrinth-v1", level="rooms_watermaze")`. With
    `gymnasium.make_vec` the same id gives `LabyrinthVectorEnv`, which steps many envs at once, or a
    `Mixture` of them for a level that draws tasks.
    """

    metadata = LabyrinthVectorEnv.metadata

    def __init__(self, level: str = "explore_goal_locations_small", **options: Any) -> None:
        """Raises ValueError for an unknown level, engine or number of actions, or sizes below 1."""
        super().__init__(make_vec, level=level, **options)
