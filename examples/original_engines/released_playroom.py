"""The released Playroom, a Unity environment in a Docker image, for those who have it.

The family `released_playroom` has the playroom's levels and its splits, as `released_playroom_lift`
and so on. It registers itself on import.
"""

import hashlib
import os
import re
from collections.abc import Sequence
from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import playroom_rpc as rpc
from gymnasium import spaces
from gymnasium.vector import AutoresetMode
from numpy.typing import NDArray
from pydantic import Field

import zipf.envs
from zipf.envs import PAPER_KINDS, EngineError, Family, Split, SplitLevel
from zipf.envs.arguments import ImageSize, checked
from zipf.envs.gymnasium.replayed import Outcome, ReplayedVectorEnv
from zipf.envs.playroom import FAMILY as PLAYROOM
from zipf.envs.playroom import Steps, levels
from zipf.envs.playroom.actions import ACTIONS, CONTROL_TABLE, CONTROLS
from zipf.envs.vector import Observation
from zipf.options import Options

REPEAT = 4  # paper: frames that an action lasts
TEXT_LENGTH = 16  # ours: the longest of our instructions has 6 words
CODES = 4096  # ours: of 20 words that are not in our vocabulary, two share a code in 1 of 20 cases

_RELEASED = {
    "move": ("MOVE_BACK_FORWARD", 1),
    "strafe": ("STRAFE_LEFT_RIGHT", 1),
    "turn": ("LOOK_LEFT_RIGHT", 1),
    "look": ("LOOK_DOWN_UP", -1),
    "spin_right": ("HAND_ROTATE_AROUND_RIGHT", 1),
    "spin_up": ("HAND_ROTATE_AROUND_UP", 1),
    "spin_forward": ("HAND_ROTATE_AROUND_FORWARD", 1),
    "push": ("HAND_PUSH_PULL", -1),
    "grip": ("HAND_GRIP", 1),
}
"""Our controls as the release's, with their signs: those of the keys of its `human_agent.py`, where
the up arrow is LOOK_DOWN_UP=-1. It has no keys for the hand: there the signs are those of a public
list of the 46 actions, which pulls by +1."""

COMMANDS = tuple(
    {
        _RELEASED[control][0]: _RELEASED[control][1] * value
        for control, value in zip(CONTROLS, row, strict=True)
    }
    for row in CONTROL_TABLE.tolist()
)
"""The release's controls of each of the 46 actions: all of them, since they keep their values."""


class ReleasedPlayroomOptions(Options):
    """Constructor options: those of the playroom that the released one has, too."""

    image_size: ImageSize = Field(default=[72, 96])
    max_steps: Steps = 900


class DockerVectorEnv(ReplayedVectorEnv):
    """`N` envs of a level of the released Playroom, with the interface of `PlayroomVectorEnv`.

    Written from the released loader and the documentation of dm_env_rpc, and tested against a
    server of ours with the documented names, never on the released environment.

    - **Levels** have the release's names, which are ours. `max_steps` becomes the release's limit
      in seconds, at 7.5 actions a second.
    - **Actions** are our 46, as the release's controls; see `COMMANDS`. An action lasts four
      frames.
    - **Instructions** are codes of words in lower case. Words of our vocabulary have our codes.
      Which toys the release has is not published, so others are likely: they have codes from a
      hash, the same on every machine, of which two words may share one. The space is therefore
      larger than that of our engine, int64 [16] with codes below 4096, and an agent that was
      trained with one engine cannot play in the other.
    - **Situations.** The release does not tell which toys it has drawn: there are no ranks. An
      episode is a success if its return is positive.
    - **Engines.** One container for each env, which is started when the env's first episode
      begins, or a connection for each env to the server at `address`, which has to be on this
      machine. Envs are stepped one after another.
    - **Episodes.** Each is an env of its own, created with the episode's seed, and states are
      replayed, see `ReplayedVectorEnv`. Whether the release is deterministic is not documented.

    Args:
        num_envs: number of envs N.
        level: a level of the family, without its name.
        address: `host:port` of a running server; None: that of the environment variable
            `ZIPF_PLAYROOM_ADDRESS`, and containers where there is none.
        autoreset_mode, copy: see `ZipfVectorEnv`.
        render_mode: "rgb_array", the image four times as large, or None.
        options: of `ReleasedPlayroomOptions`, see `PlayroomEnv`.

    Raises:
        ValueError: for an unknown level, options out of range, or without dm_env_rpc or docker.
        EngineError: in `reset` and `step`, where the engine cannot be started or goes wrong.
    """

    metadata = {"render_modes": ["rgb_array"], "render_fps": 7.5}  # noqa: RUF012

    def __init__(
        self,
        num_envs: int = 1,
        level: str = "lift/lift_shape_zipf3",
        *,
        address: str | None = None,
        autoreset_mode: AutoresetMode | str = AutoresetMode.SAME_STEP,
        copy: bool = True,
        render_mode: str | None = None,
        **options: Any,
    ) -> None:
        self.level = levels.by_name(level)
        chosen = checked(ReleasedPlayroomOptions, options)
        height, width = chosen.image_size
        self.max_steps = chosen.max_steps
        self.address = address or os.environ.get(rpc.ADDRESS) or None
        rpc.check(self.address)
        self.replayed_name = f"the released Playroom's {self.level.name}"
        super().__init__(
            num_envs,
            single_observation_space=spaces.Dict(
                {
                    "image": spaces.Box(0, 255, (height, width, 3), dtype=np.uint8),
                    "instruction": spaces.Box(0, CODES - 1, (TEXT_LENGTH,), dtype=np.int64),
                }
            ),
            single_action_space=spaces.Discrete(len(ACTIONS)),
            autoreset_mode=autoreset_mode,
            copy=copy,
            render_mode=render_mode,
        )
        self._settings = {
            "width": width,
            "height": height,
            "EpisodeLengthSeconds": self.max_steps * REPEAT / rpc.FRAMES_PER_SECOND,
            "ShowReachabilityHUD": False,
        }
        self._envs: list[rpc.World | None] = [None] * num_envs
        self._texts = np.full(num_envs, "", "<U200")

    def render(self) -> tuple[NDArray[np.uint8], ...] | None:
        """One frame of each env, uint8 [4 height, 4 width, 3], with `render_mode="rgb_array"`."""
        if self.render_mode is None:
            return None
        return tuple(image.repeat(4, axis=0).repeat(4, axis=1) for image in self._current["image"])

    def close_extras(self, **kwargs: Any) -> None:
        for i in range(self.num_envs):
            self._close_world(i)

    def _open(self, i: int, seed: int) -> Observation:
        try:
            env = self._envs[i]
            if env is None:
                env = rpc.World(self.address, self.level.name, self._settings)
                self._envs[i] = env
            return self._read(i, env.begin(seed))
        except Exception as error:
            raise self._failed(i, "cannot begin an episode", error) from error

    def _act(self, i: int, action: int) -> Outcome:
        env = self._envs[i]
        assert env is not None
        reward = 0.0
        try:
            for _ in range(REPEAT):
                shown = env.step(COMMANDS[action])
                reward += shown.reward
                if shown.last:
                    break
            observation = self._read(i, shown)
        except Exception as error:
            raise self._failed(i, "cannot go on", error) from error
        in_time = len(self._actions[i]) < self.max_steps
        # The release may end a task at its time limit, too: then nothing has been done.
        terminated = shown.last and shown.discount == 0 and (in_time or reward != 0)
        truncated = not terminated and (shown.last or not in_time)
        return Outcome(observation, reward, terminated, truncated)

    def _read(self, i: int, shown: rpc.Shown) -> Observation:
        space = self.single_observation_space["image"]
        image = np.asarray(shown.image)
        if image.shape != space.shape or image.dtype != space.dtype:
            raise ValueError(
                f"it shows {image.dtype} {image.shape}, not {space.dtype} {space.shape}"
            )
        instruction = encode(shown.text)
        self._texts[i] = shown.text
        return {"image": image, "instruction": instruction}

    def _describe(self) -> dict[str, NDArray[Any]]:
        return {"instruction": self._texts.copy()}

    def _failed(self, i: int, what: str, error: Exception) -> EngineError:
        self._close_world(i)
        where = f"the server at {self.address}" if self.address else f"the Docker image {rpc.IMAGE}"
        return EngineError(
            f"{self.replayed_name} {what} (needed: {where}; {rpc.ADDRESS}=host:port names a "
            f"running server): {type(error).__name__}: {error}"
        )

    def _close_world(self, i: int) -> None:
        env, self._envs[i] = self._envs[i], None
        if env is not None:
            env.close()

    def __getstate__(self) -> dict[str, Any]:
        return {**super().__getstate__(), "_envs": [None] * self.num_envs}


@cache
def encode(text: str) -> NDArray[np.int64]:
    """The codes of a text's words, int64 [TEXT_LENGTH], 0 after the last one.

    Raises:
        ValueError: more words than that.
    """
    words = re.findall(r"\w+", text.lower())
    if len(words) > TEXT_LENGTH:
        raise ValueError(f"{text!r} has {len(words)} words: at most {TEXT_LENGTH} are encoded")
    codes = np.zeros(TEXT_LENGTH, np.int64)
    codes[: len(words)] = [_code(word) for word in words]
    codes.flags.writeable = False  # it is given out again
    return codes


def _code(word: str) -> int:
    known = levels.VOCABULARY
    if word in known.words:
        return known.words.index(word) + 1
    digest = hashlib.blake2b(word.encode(), digest_size=8).digest()
    return known.size + int.from_bytes(digest, "little") % (CODES - known.size)


def _released(split: Split) -> Split:
    """A split of the playroom with its levels in the released one."""

    def moved(given: Sequence[SplitLevel]) -> tuple[SplitLevel, ...]:
        return tuple(replace(one, level=f"released_{one.name}") for one in given)

    return replace(
        split,
        name=f"released_{split.name}",
        paper=None,  # until somebody has shown that this plays as the engine does
        validation=(),  # ours
        **{kind: moved(split.levels(kind)) for kind in PAPER_KINDS},
    )


zipf.envs.register(
    Family(
        name="released_playroom",
        summary="lift, put or find a toy, in the released Unity environment",
        levels=tuple(name for name in levels.LEVELS if not name.endswith("_validation")),
        options=ReleasedPlayroomOptions,
        make_vec=DockerVectorEnv,
        splits=tuple(map(_released, PLAYROOM.splits)),
        keys="zipf.envs.playroom.keys:KEYS",
        goal="zipf.envs.goals:Instruction",
    )
)
