"""The labyrinth's tasks in the original engine, DeepMind Lab, for those who have installed it.

The family `dmlab` has the labyrinth's tasks and its splits, as `dmlab_forward` and so on. It
registers itself on import.
"""

import importlib
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any, Literal

import numpy as np
from gymnasium import spaces
from gymnasium.vector import AutoresetMode
from numpy.typing import NDArray
from pydantic import Field

import zipf.envs
from zipf.envs import EngineError, Family, Split, SplitLevel, ZipfVectorEnv
from zipf.envs.arguments import ImageSize, checked
from zipf.envs.gymnasium.replayed import Outcome, ReplayedVectorEnv
from zipf.envs.labyrinth.actions import TABLES, Action
from zipf.envs.labyrinth.benchmark import SPLITS
from zipf.envs.labyrinth.levels import LEVELS, by_name
from zipf.envs.labyrinth.options import Repeat
from zipf.envs.labyrinth.state import FRAMES_PER_SECOND
from zipf.envs.labyrinth.words import VOCABULARY
from zipf.envs.vector import Observation
from zipf.options import Options, Size

FOLDER = "contributed/dmlab30"
"""Folder of the levels' scripts in DeepMind Lab."""

_PICTURES = ("psychlab_arbitrary_visuomotor_mapping", "psychlab_continuous_recognition")
_CONTROLS = {
    "LOOK_LEFT_RIGHT_PIXELS_PER_FRAME": "look_right",
    "LOOK_DOWN_UP_PIXELS_PER_FRAME": "look_down",
    "STRAFE_LEFT_RIGHT": "strafe",
    "MOVE_BACK_FORWARD": "forward",
    "FIRE": "fire",
}
"""Controls of the engine, and the fields of `Action` that they have; those left out are 0."""


class Labs:
    """The instances of DeepMind Lab of a batch's envs: at most one for each env.

    The levels of a mixture share them: an env that begins an episode of another level closes its
    instance. An instance has an engine of its own, and thirty levels times many envs of them
    would take more RAM than most machines have.
    """

    def __init__(self, num_envs: int) -> None:
        self._open: list[tuple[str, Any] | None] = [None] * num_envs

    def of(self, env: int, level: str, make: Callable[[], Any]) -> Any:
        """The env's instance of a level, made if it has none."""
        found = self._open[env]
        if found is None or found[0] != level:
            self.close(env)
            found = self._open[env] = level, make()
        return found[1]

    def close(self, env: int) -> None:
        """Closes an env's instance, if it has one."""
        found, self._open[env] = self._open[env], None
        if found is not None:
            found[1].close()

    def close_all(self) -> None:
        """Closes the instances of all envs."""
        for env in range(len(self._open)):
            self.close(env)

    def __getstate__(self) -> dict[str, Any]:
        return {"_open": [None] * len(self._open)}


class DmlabOptions(Options):
    """Constructor options: those of the labyrinth, with its values."""

    image_size: ImageSize = Field(default=[72, 96])
    num_actions: Literal[15, 9] = 15
    action_repeat: Repeat = 4
    max_steps: Size | None = None


class DmlabVectorEnv(ReplayedVectorEnv):
    """`N` envs of a task in DeepMind Lab, with the interface of `LabyrinthVectorEnv`.

    Written from DeepMind Lab's documentation (`docs/users/python_api.md` and the sources of its
    Python module) and tested against a stand-in that follows it, never on the engine itself.

    - **Observations, actions, rewards** are ours: the engine's `RGB_INTERLEAVED` as `image`, its
      `INSTR` in our vocabulary as `instruction`, the same tables of actions, `action_repeat` frames
      of the engine for an action, rewards unclipped.
    - **Ends.** The engine does not say why an episode has ended. One that ends at the level's time
      limit is truncated, an earlier one terminated. The engine shows nothing once an episode has
      ended: the last observation of an episode is the one before its last action.
    - **Instructions.** All instructions of the thirty levels are made of the words of our
      vocabulary. A word that is not there is an error rather than a code for unknown words: it
      shows that the levels are other ones.
    - **Engines.** One instance of DeepMind Lab for each env, stepped one after another, with the
      software renderer, the only one that may be called from any thread. An instance is made when
      its env begins an episode of another level than before.
    - **States** are replayed, see `ReplayedVectorEnv`. The engine documents that it is
      deterministic on one platform only.

    Args:
        num_envs: number of envs N.
        level: a name of `zipf.envs.labyrinth.levels.LEVELS`.
        autoreset_mode, copy: see `ZipfVectorEnv`.
        render_mode: "rgb_array", the image four times as large, or None.
        options: of `DmlabOptions`, see `LabyrinthEnv`.

    Raises:
        ValueError: for an unknown level, options out of range, or without `deepmind_lab`.
        EngineError: in `reset` and `step`, where the engine cannot be started or goes wrong.
    """

    metadata = {"render_modes": ["rgb_array"], "render_fps": 15}  # noqa: RUF012
    reports_success = False

    def __init__(
        self,
        num_envs: int = 1,
        level: str = "explore_goal_locations_small",
        *,
        autoreset_mode: AutoresetMode | str = AutoresetMode.SAME_STEP,
        copy: bool = True,
        render_mode: str | None = None,
        **options: Any,
    ) -> None:
        self.level = by_name(level)
        chosen = checked(DmlabOptions, options)
        self._height, self._width = chosen.image_size
        table = TABLES[chosen.num_actions]
        self.action_repeat = chosen.action_repeat
        self.metadata = {**self.metadata, "render_fps": FRAMES_PER_SECOND / self.action_repeat}
        self.max_steps = chosen.max_steps
        self.replayed_name = f"DeepMind Lab's {self.level.name}"
        _deepmind_lab()
        super().__init__(
            num_envs,
            single_observation_space=spaces.Dict(
                {
                    "image": spaces.Box(0, 255, (self._height, self._width, 3), dtype=np.uint8),
                    "instruction": VOCABULARY.space(),
                }
            ),
            single_action_space=spaces.Discrete(len(table)),
            autoreset_mode=autoreset_mode,
            copy=copy,
            render_mode=render_mode,
        )
        self._actions_taken = table
        self._labs = Labs(num_envs)
        self._vectors: NDArray[np.intc] | None = None  # of the actions, once an engine has told

    def render(self) -> tuple[NDArray[np.uint8], ...] | None:
        """One frame of each env, uint8 [4 height, 4 width, 3], with `render_mode="rgb_array"`."""
        if self.render_mode is None:
            return None
        return tuple(image.repeat(4, axis=0).repeat(4, axis=1) for image in self._current["image"])

    def _use_processes(self, other: ZipfVectorEnv) -> None:
        if isinstance(other, DmlabVectorEnv):
            self._labs = other._labs

    def close_extras(self, **kwargs: Any) -> None:
        self._labs.close_all()

    def _open(self, i: int, seed: int) -> Observation:
        lab = self._labs.of(i, self.level.name, self._make)
        try:
            lab.reset(seed=seed)
        except Exception as error:
            self._labs.close(i)
            raise self._failed("cannot begin an episode", error) from error
        return self._read(lab)

    def _act(self, i: int, action: int) -> Outcome:
        lab = self._labs.of(i, self.level.name, self._make)
        assert self._vectors is not None
        try:
            reward = lab.step(self._vectors[action], num_steps=self.action_repeat)
            running = lab.is_running()
        except Exception as error:
            self._labs.close(i)
            raise self._failed("cannot go on", error) from error
        steps = len(self._actions[i])
        in_time = steps * self.action_repeat < self.level.frames
        observation = (
            self._read(lab)
            if running
            else {name: array[i].copy() for name, array in self._current.items()}
        )
        terminated = not running and in_time
        cut = self.max_steps is not None and steps >= self.max_steps
        truncated = not terminated and (cut or not running)
        return Outcome(observation, float(reward), terminated, truncated)

    def _make(self) -> Any:
        """An instance of DeepMind Lab. Raises EngineError if there cannot be one."""
        try:
            lab = _deepmind_lab().Lab(
                f"{FOLDER}/{self.level.name}",
                ["RGB_INTERLEAVED", "INSTR"],
                config={"width": str(self._width), "height": str(self._height), "fps": "60"},
                renderer="software",
            )
        except Exception as error:
            raise self._failed("cannot be loaded", error) from error
        names = [one["name"] for one in lab.action_spec()]
        if missing := [name for name in _CONTROLS if name not in names]:
            lab.close()
            raise EngineError(f"{self.replayed_name} has no control {missing}, only {names}")
        self._vectors = np.array(
            [[_control(action, name) for name in names] for action in self._actions_taken], np.intc
        )
        return lab

    def _read(self, lab: Any) -> Observation:
        """What a running env shows."""
        told = lab.observations()
        image, space = told["RGB_INTERLEAVED"], self.single_observation_space["image"]
        if image.shape != space.shape or image.dtype != space.dtype:
            raise EngineError(
                f"{self.replayed_name} shows {image.dtype} {image.shape}, not "
                f"{space.dtype} {space.shape}"
            )
        try:
            instruction = VOCABULARY.encode(told["INSTR"])
        except ValueError as error:
            raise EngineError(
                f"{self.replayed_name} gives an instruction that our levels do not have: {error}; "
                "the words are those of zipf.envs.labyrinth.words.VOCABULARY"
            ) from error
        return {"image": image, "instruction": instruction}

    def _describe(self) -> dict[str, NDArray[Any]]:
        return {"instruction": np.array([*map(VOCABULARY.decode, self._current["instruction"])])}

    def _failed(self, what: str, error: Exception) -> EngineError:
        needed = f"a DeepMind Lab with game_scripts/levels/{FOLDER}/{self.level.name}.lua"
        if self.level.name in _PICTURES:
            needed += (
                ", and the pictures that its data/brady_konkle_oliva2008/README.md says how to get"
            )
        return EngineError(
            f"{self.replayed_name} {what} (needed: {needed}): {type(error).__name__}: {error}"
        )


def _control(action: Action, name: str) -> int:
    field = _CONTROLS.get(name)
    return 0 if field is None else int(getattr(action, field))


def _deepmind_lab() -> Any:
    """The module of DeepMind Lab. Raises ValueError if it cannot be imported."""
    try:
        return importlib.import_module("deepmind_lab")
    except ImportError as error:
        raise ValueError(
            "the family dmlab needs the Python package deepmind_lab, which cannot be imported "
            f"({error}): build it as github.com/google-deepmind/lab says in "
            "python/pip_package/README.md, or use the family labyrinth"
        ) from error


def _of_dmlab(split: Split) -> Split:
    """A split of the labyrinth with its levels in DeepMind Lab."""

    def moved(levels: Sequence[SplitLevel]) -> tuple[SplitLevel, ...]:
        return tuple(replace(one, level=_renamed(one.name)) for one in levels)

    return replace(
        split,
        name=_renamed(split.name),
        paper=None,  # until somebody has shown that this plays as the engine does
        **{kind: moved(split.levels(kind)) for kind in split.kinds},
    )


def _renamed(name: str) -> str:
    return name.replace("labyrinth", "dmlab", 1)


zipf.envs.register(
    Family(
        name="dmlab",
        summary="the 30 tasks of DMLab-30 in DeepMind Lab",
        levels=tuple(LEVELS),
        check=by_name,
        options=DmlabOptions,
        make_vec=DmlabVectorEnv,
        splits=tuple(map(_of_dmlab, SPLITS)),
        keys="zipf.envs.labyrinth.keys:KEYS",
        goal="zipf.envs.goals:Instruction",
    )
)
