"""Zipf's Playroom, one env."""

from typing import Any

from zipf.envs.playroom.vector import PlayroomVectorEnv
from zipf.envs.single import SingleEnv


class PlayroomEnv(SingleEnv):
    """Zipf's Playroom: do what you are told with toys of which most are rarely met.

    ## Description

    A room of 4 x 4 m, seen in the first person, holds three toys out of 50, and in some levels a
    bed and a tray. An instruction says which toy to lift, or where to put it. Which toys are there
    is drawn from a Zipfian distribution in training, and from others in the tests; where
    everything is, how it is turned and what colour it has is random in every episode. After
    "Zipfian environments for reinforcement learning" (Chan et al., 2022), whose Unity environment
    this replaces: actions, episode length, levels and distributions are the paper's, while the
    room's looks, its physics and the choice and order of the toys, which are not published, are
    ours. The paper's text speaks of a red and a blue box; its figure and its level names have a
    bed and a tray, and so have we.

    ## Observation space

    A `Dict` with

    - `image`: uint8 [72, 96, 3], 75 degrees wide, from 1.0 m above the floor.
    - `instruction`: int64 [6], the words' codes in `zipf.envs.playroom.levels.VOCABULARY`, 0 behind
      the last one; `info["instruction"]` is the text, whose article is always "a".

    ## Action space

    `Discrete(46)`, see `zipf.envs.playroom.actions`: the room runs at 30 frames per second and
    an action lasts four. The agent has momentum; it collides with walls, furniture and toys, and
    pushes what is loose.

    | Action | Does                                    | Full          | Finer                     |
    |--------|-----------------------------------------|---------------|---------------------------|
    | 0      | nothing                                 |               |                           |
    | 1, 2   | moves forward, backward                 | 2.7 m/s       |                           |
    | 3, 4   | moves right, left                       | 2.7 m/s       | 9, 10: 0.05 of it         |
    | 5, 6   | turns right, left                       | 16 degrees    | 13, 14: 0.2; 15, 16: 0.05 |
    | 7, 8   | looks down, up                          | 12 degrees    | 11, 12: 0.03 of it        |
    | 17     | grips                                   |               |                           |
    | 18-33  | grips and does 1-16                     |               |                           |
    | 34, 35 | grips and spins right, left             | 24 degrees    |                           |
    | 36, 37 | grips and spins up, down                | 24 degrees    |                           |
    | 38, 39 | grips and spins forward, backward       | 24 degrees    |                           |
    | 40, 41 | grips and pulls closer, pushes away     | 0.13 m        | 42, 43: half              |
    | 44, 45 | pulls, pushes with an empty hand: nothing |             |                           |

    Gripping takes the toy at the middle of the view, within `reach`, and holds it there as long as
    gripping actions follow; the first that does not grip lets go. What is held follows the view:
    looking up raises it. At a wall it comes closer and then keeps the agent away, and a turn for
    which there is no room is not made. What is let go falls. The agent walks over the tray, but not
    over the bed or through toys.

    ## Rewards

    1 for doing as told, 0 otherwise.

    - Lift: the right toy is 0.15 m above where it lay.
    - Put on: the right toy, once lifted, rests on the right one of bed and tray for 0.27 s.
    - Put near: the same, or it rests on the floor within 0.5 m of the right one. Bed and tray are
      so far apart that no place is near both.
    - Find: the agent's middle comes within 0.7 m of the right toy's.

    ## Starting state

    The toys' frequency ranks are drawn first, from the level's distribution without replacement
    (with it in `supervised/` levels), the target uniformly among them. Poses do not overlap. The
    agent faces the middle of the toys, give or take 30 degrees; in `supervised/` levels two toys
    are in view, one on the left and one on the right.
    `reset(options={"target": 3, "other_1": 17})` forces ranks; forced ones are drawn all the same
    and then replaced, so that the episodes that follow do not depend on it.

    ## Episode end

    Terminated when the task is done, or done to the wrong toy or in the wrong place; truncated
    after `max_steps` actions, 120 s. In `put/put_near_*` levels the wrong toy on either support, or
    the right one on the wrong support, ends the episode, but nothing that only lies near one: in
    the paper "reward is also given if the correct object is placed near the target box". With
    `near_failure=True` these end it, too.

    ## Info

    The situation's ranks (0 = most frequent): `target`, `other_1`, `other_2` (`other` in
    `supervised/` levels; five others where there are many); in `put/` levels also `task`, an
    index of `zipf.envs.playroom.levels.TASKS`. `instruction`, the text, and in `supervised/`
    levels `side`, 0 where the target is on the left at the start and 1 on the right. The step
    that ends an episode adds `success` (bool), `return` (float) and `length` (int).

    ## Levels

    - `lift/lift_shape_*`: no furniture; `zipf2`, `zipf3`, `zipf4`, `uniform`, `uniform_rare`
      and, ours, `validation`: the middle fifth.
    - `put/lift_shape_*`: the same with furniture; `zipf2`, `uniform`, `uniform_rare`, and with six
      toys (ours: how many is not published) `many_zipf1`, `many_zipf4`.
    - `put/put_near_bed_tray_frequent`, `put/put_on_bed_tray_frequent`: the 10 most frequent toys,
      all alike, or by Zipf's law with `frequent_exponent`. The paper says of putting that "we only
      trained on the most frequent 20%", and elsewhere that its exponent in training is 2.
    - `put/put_on_bed_tray_all`, `put/put_on_bed_tray_rare`, `put/put_on_bed_tray_validation`: all
      alike; the 10 rarest; ours, the middle fifth.
    - `supervised/find_shape_*`: `zipf2`, `zipf3`, `uniform`, `uniform_rare`, `validation`.

    ## Arguments

    - `level`: one of these names, with or without `playroom/` before it.
    - `backend`: the engine, `"own"`. The released Playroom is the family `released_playroom` of
      `examples/original_engines`.
    - `image_size`: (height, width) of the image.
    - `object_order`: which toys are how frequent: `"default"`, or `"alternate"` to check that a
      result does not hang on which shapes are rare.
    - `looks`: `"plain"`, or `"varied"`: every episode has its own light (direction, brightness,
      warmth), textures of walls and floor, and sizes that toys are drawn at, 0.85 to 1 times
      theirs. Nothing else changes: the same actions lead to the same rewards.
    - `max_steps`: after how many actions an episode is truncated.
    - `reach`: of the hand from the eye, 1.5 to 4 m. The paper does not give it.
    - `frequent_exponent`: of Zipf's law over the 10 most frequent toys, 0 to 10, in the levels
      named `frequent`; 0 draws all alike. All other levels accept and ignore it.
    - `near_failure`: see above. Levels with other tasks have it, too, and do not use it.
    - `render_mode`: `"rgb_array"` (384 x 288, with the instruction) or None.

    ## Registered as

    `zipf/Playroom-v1`, by `import zipf.envs`, or in one go
    `gymnasium.make("zipf.envs:zipf/Playroom-v1", level="lift/lift_shape_zipf3")`. With
    `gymnasium.make_vec` the same id gives `PlayroomVectorEnv`, which steps many envs at once.
    """

    metadata = PlayroomVectorEnv.metadata

    def __init__(self, level: str = "lift/lift_shape_zipf3", **options: Any) -> None:
        """Raises ValueError for an option of the wrong type or out of range."""
        super().__init__(PlayroomVectorEnv, level=level, **options)
