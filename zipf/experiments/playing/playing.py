"""Playing and watching: episodes played by a person, a script or a trained agent."""

from __future__ import annotations

import secrets
import time
from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import dataclass
from math import ceil
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from gymnasium import spaces
from gymnasium.vector import AutoresetMode
from numpy.typing import NDArray
from pydantic import Field

from zipf import envs
from zipf.envs.keyboard import LEAVE, NEXT, Keys
from zipf.envs.vector import ZipfVectorEnv
from zipf.experiments import composing
from zipf.experiments.config import PositiveInt, Seed, module_names
from zipf.experiments.errors import UserError
from zipf.experiments.playing.recording import Recording
from zipf.experiments.playing.screens import Screen, Text, enlarge, open_screen
from zipf.experiments.running.agent_policy import AgentPolicy
from zipf.experiments.running.evaluator import Policy, derive_seed
from zipf.experiments.running.scripted import ScriptedPolicy
from zipf.experiments.running.trained import Trained, load_agent
from zipf.options import Options

_PAUSE = 1.0  # seconds on the last frame of an episode
_LOW = 288  # pixels; pictures of a smaller height are enlarged


class PlayOptions(Options):
    """The options of `python -m zipf.play`."""

    level: Annotated[str, Field(min_length=1)] | None = None
    run: Annotated[str, Field(min_length=1)] | None = None
    policy: Literal["keyboard", "random", envs.Scripted, "agent"] | None = None
    record: Annotated[str, Field(min_length=1)] | None = None
    episodes: PositiveInt | None = None
    plugins: str = ""
    seed: Seed | None = None
    fps: Annotated[int, Field(ge=1, le=120)] | None = None
    scale: Annotated[int, Field(ge=1, le=16)] | None = None
    view: Literal["world", "agent"] | None = None
    screen: Literal["auto", "window", "terminal"] = "auto"


@dataclass(frozen=True)
class World:
    """One world of a level, and who plays it."""

    level: str
    env: ZipfVectorEnv
    keys: Keys
    policy: Policy | None  # None: a person at the keyboard


def play(options: PlayOptions, say: Callable[[str], None]) -> None:
    """Plays, shows and records episodes as the options say.

    Args:
        options: what to play.
        say: prints a line about each episode and each file; is not called while a screen is open.

    Raises:
        UserError: options that contradict each other, or that this machine cannot fulfil.
    """
    policy = _who_plays(options)
    seed = secrets.randbelow(2**31) if options.seed is None else options.seed
    worlds = _worlds(options, policy, seed)
    say(f"{', '.join(world.level for world in worlds)}, seed {seed}")
    for world in worlds:
        # The first reset may compile for a minute: do so before a screen is open.
        world.env.reset(seed=seed)
        world.env.render()
    fps = options.fps or worlds[0].env.metadata["render_fps"]
    with ExitStack() as stack:
        lines: list[str] = []
        screen = recording = None
        if policy == "keyboard" or not options.record:
            stack.callback(_say_all, lines, say)
            screen = open_screen(options.screen)
            say_episode = lines.append
        else:
            say_episode = say
        if options.record:
            recording = Recording(Path(options.record), fps)
            stack.callback(_say_written, recording, say_episode)
            stack.enter_context(recording)
        if screen:
            stack.enter_context(screen)
        shows = _Shows(worlds[0].env, options, screen, recording)
        episodes = options.episodes or (1 if screen is None else None)
        _Session(worlds, shows, fps, seed, say_episode).play(episodes)


def _who_plays(options: PlayOptions) -> str:
    """The policy, with a default where it is not set.

    Raises:
        UserError: with a line for each option that is missing or contradicts another.
    """
    problems = []
    if not options.level and not options.run:
        problems.append("level is not set: choose level=<a level's name> or run=<a run's folder>")
    policy = options.policy
    if policy is None:
        policy = "agent" if options.run else "keyboard"
        if options.record and not options.run:
            problems.append(
                "policy is not set: for a recording choose policy=random, "
                f"{', '.join(envs.SCRIPTED)} or keyboard, or run=<a run's folder> for its agent"
            )
    if policy == "agent" and not options.run:
        problems.append("policy=agent: needs the agent of a run; add run=<a run's folder>")
    if options.level in envs.KINDS and not options.run:
        problems.append(
            f"level={options.level}: names a run's level; add run=<a run's folder>, or give "
            "a level's full name"
        )
    if problems:
        raise UserError("\n".join(problems))
    return policy


def _worlds(options: PlayOptions, policy: str, seed: int) -> list[World]:
    """A world of each level; they are played in turn."""
    names = module_names(options.plugins)
    composing.load_plugins(names)
    trained = load_agent(Path(options.run), "cpu", names) if options.run else None
    level_options = trained.config.level_options if trained else {}
    agent = None
    if trained and policy == "agent":
        if trained.agent.answers_questions:
            raise UserError(f"run={options.run}: a classifier answers questions and does not act")
        actions = derive_seed(seed, "actions")
        agent = AgentPolicy(trained.agent, seed=actions, device=trained.config.torch_device)
    worlds = []
    for level in _levels(options, trained):
        env = _make(level, level_options)
        if trained and policy == "agent":
            _check_spaces(level, env, trained)
        if options.view == "agent" and not _has_image(env):
            raise UserError(
                "view=agent: observations of these worlds have no image; use view=world"
            )
        keys = envs.keys(level)
        if policy == "keyboard" and keys is None:
            raise UserError(f"policy=keyboard: there are no keys for {level}")
        player: Policy | None = None
        if policy == "agent":
            player = agent
        elif policy == "random":
            player = _Random(env, derive_seed(seed, "actions"))
        elif policy in envs.SCRIPTED:
            player = ScriptedPolicy(policy)
            try:
                player.enter(level, env)
            except ValueError as error:
                raise UserError(f"{error}; policy=random plays all levels") from None
        worlds.append(World(level, env, keys or Keys(()), player))
    return worlds


def _levels(options: PlayOptions, trained: Trained | None) -> list[str]:
    if trained is None or options.level not in (None, *envs.KINDS):
        return [str(options.level)]
    split = envs.split(trained.config.environment.split)
    return [level.name for level in split.levels(options.level or "train")]


def _make(level: str, level_options: dict[str, Any]) -> ZipfVectorEnv:
    try:
        return envs.make_vec(
            level,
            1,
            autoreset_mode=AutoresetMode.DISABLED,
            render_mode="rgb_array",
            **level_options,
        )
    except ValueError as error:
        raise UserError(str(error)) from None
    except TypeError:
        raise UserError(f"level={level}: belongs to another family than the run's levels") from None


def _check_spaces(level: str, env: ZipfVectorEnv, trained: Trained) -> None:
    # All levels of a split have the same spaces.
    known = trained.config.split.uniform[0]
    learned = envs.make_vec(known, 1, **trained.config.level_options)
    for space in ("single_observation_space", "single_action_space"):
        if getattr(env, space) != getattr(learned, space):
            raise UserError(
                f"level={level}: has other observations or actions than the run's levels"
            )
    learned.close()


class _Random:
    """Uniformly random actions."""

    def __init__(self, env: ZipfVectorEnv, seed: int) -> None:
        self.actions = int(env.single_action_space.n)
        self.rng = np.random.default_rng(seed)

    def start(self, num_envs: int) -> None: ...

    def __call__(
        self, observation: dict[str, NDArray], reward: NDArray, is_first: NDArray
    ) -> NDArray:
        return self.rng.integers(self.actions, size=len(is_first))


class _Shows:
    """Draws the picture and passes it to the screen and the recording, if there are any."""

    def __init__(
        self,
        env: ZipfVectorEnv,
        options: PlayOptions,
        screen: Screen | None,
        recording: Recording | None,
    ) -> None:
        self.screen = screen
        self.recording = recording
        self.scale = options.scale
        # A terminal has too few characters for a picture of the whole world.
        coarse = screen is not None and screen.in_characters
        self.on_screen = options.view or ("agent" if coarse and _has_image(env) else "world")
        self.recorded = options.view or "world"

    def step(self, env: ZipfVectorEnv, observation: dict[str, NDArray], text: Text) -> None:
        """Shows and records the current state of the world."""
        if self.recording:
            self.recording.add(self._enlarged(self._picture(self.recorded, env, observation)))
        self.again(env, observation, text)

    def again(self, env: ZipfVectorEnv, observation: dict[str, NDArray], text: Text) -> None:
        """Shows the current state again, with another text."""
        if self.screen:
            picture = self._picture(self.on_screen, env, observation)
            if not self.screen.in_characters:  # a terminal scales the picture itself
                picture = self._enlarged(picture)
            self.screen.show(picture, text)

    def _picture(
        self, view: str, env: ZipfVectorEnv, observation: dict[str, NDArray]
    ) -> NDArray[np.uint8]:
        if view == "agent":
            picture = observation["image"][0]
        else:
            frames = env.render()
            assert frames is not None
            picture = frames[0]
        return picture

    def _enlarged(self, picture: NDArray[np.uint8]) -> NDArray[np.uint8]:
        return enlarge(picture, self.scale or ceil(_LOW / len(picture)))


def _has_image(env: ZipfVectorEnv) -> bool:
    space = env.single_observation_space.get("image")
    return isinstance(space, spaces.Box) and len(space.shape) == 3 and space.dtype == np.uint8


def _say_all(lines: list[str], say: Callable[[str], None]) -> None:
    for line in lines:
        say(line)


def _say_written(recording: Recording, say: Callable[[str], None]) -> None:
    width, height = recording.size
    if recording.written:
        say(f"written: {recording.path} ({recording.frames} frames, {width} x {height})")


class _Leave(Exception):
    """Raised when the person leaves."""


class _Session:
    """Plays episodes on the worlds, in turn."""

    def __init__(
        self,
        worlds: list[World],
        shows: _Shows,
        fps: float,
        seed: int,
        say: Callable[[str], None],
    ) -> None:
        self.worlds = worlds
        self.shows = shows
        self.fps = fps
        self.seed = seed
        self.say = say
        self.toggled = 0

    def play(self, episodes: int | None) -> None:
        """Plays this number of episodes; None: until the person leaves."""
        several = len(self.worlds) > 1
        for world in self.worlds:
            if world.policy:
                world.policy.start(1)
        number = 0
        try:
            while episodes is None or number < episodes:
                turn, number = number, number + 1
                world = self.worlds[turn % len(self.worlds)]
                seed = self.seed if turn < len(self.worlds) else None
                _Episode(self, world, number, several).play(seed)
        except _Leave:
            pass


class _Episode:
    """One episode, from reset to end."""

    def __init__(self, session: _Session, world: World, number: int, names_level: bool) -> None:
        self.session = session
        self.world = world
        self.env = world.env
        self.shows = session.shows
        self.name = f"episode {number}" + (f", {world.level}" if names_level else "")
        self.steps = 0
        self.total = 0.0
        self.outcome = ""

    def play(self, seed: int | None) -> None:
        """Plays the episode to its end, or until the person skips to the next one.

        Raises:
            _Leave: the person leaves.
        """
        self.observation, self.info = self.env.reset(seed=seed)
        self.reward, self.is_first = np.zeros(1, np.float32), np.ones(1, np.bool_)
        self.due = time.monotonic()
        self.shows.step(self.env, self.observation, self._text())
        try:
            while not self.outcome:
                action = self._keyboard() if self.world.policy is None else self._player()
                if action is None:
                    return
                self._step(action)
        finally:
            about = ", ".join(filter(None, [*self._words(), self._situation()]))
            told = self.outcome or f"left after {_steps(self.steps)}"
            self.session.say(": ".join(filter(None, [self.name, about, told])))
        self._rest()

    def _step(self, action: int) -> None:
        self.observation, reward, terminated, truncated, self.info = self.env.step(
            np.array([action])
        )
        self.reward, self.is_first = reward.astype(np.float32), np.zeros(1, np.bool_)
        self.steps += 1
        self.total += float(reward[0])
        if terminated[0] or truncated[0]:
            total, length = (self.info[name][0].item() for name in ("return", "length"))
            ending = "out of time" if truncated[0] else "over"
            if self.env.reports_success and self.info["success"][0]:
                ending = "success"
            elif self.env.reports_success and not truncated[0]:
                ending = "failure"
            self.outcome = f"{ending}, return {total:g}, {_steps(length)}"
        self.shows.step(self.env, self.observation, self._text())

    def _keyboard(self) -> int | None:
        """The person's action; None for the next episode."""
        while True:
            key = self._key(None)
            if key == NEXT:
                return None
            before = self.session.toggled
            action, self.session.toggled = self.world.keys.press(str(key), before)
            if action is not None:
                return action
            if self.session.toggled != before:
                self.shows.again(self.env, self.observation, self._text())

    def _player(self) -> int | None:
        """The policy's action, at its time; None for the next episode."""
        assert self.world.policy
        action = int(self.world.policy(self.observation, self.reward, self.is_first)[0])
        if self.shows.screen:
            self.due = max(self.due + 1 / self.session.fps, time.monotonic())
            if self._watch():
                return None
        return action

    def _rest(self) -> None:
        """Pauses on the last frame."""
        if self.shows.recording:
            self.shows.recording.hold(_PAUSE)
        if self.world.policy is None:
            while self._key(None) != NEXT:
                pass
        elif self.shows.screen:
            self.due += _PAUSE
            self._watch()

    def _watch(self) -> bool:
        """Waits until the next step is due; True for the next episode."""
        while True:
            key = self._key(max(self.due - time.monotonic(), 0))
            if key is None or key == NEXT:
                return key == NEXT

    def _key(self, timeout: float | None) -> str | None:
        assert self.shows.screen
        key = self.shows.screen.key(timeout)
        if key == LEAVE:
            raise _Leave
        return key

    def _situation(self) -> str:
        return ", ".join(f"{name} {self.info[name][0]}" for name in self.env.situation)

    def _words(self) -> list[str]:
        """The instruction, in levels that give one."""
        text = str(self.info["instruction"][0]) if "instruction" in self.info else ""
        return [text] if text else []

    def _goal(self) -> list[str]:
        """What a person is to do, in families that say it."""
        goal = self.world.keys.goal
        return [goal] if goal and self.world.policy is None else []

    def _text(self) -> Text:
        keys = self.world.keys
        progress = f"{self.name}   step {self.steps}   return {self.total:g}"
        help = []
        if self.world.policy is None:
            for i, toggle in enumerate(keys.toggles):
                state = "on" if self.session.toggled >> i & 1 else "off"
                progress += f"   {toggle.label} {state}"
            for binding in keys.bindings:
                help.append(f"{_shown(binding.keys)}: {binding.label}")
            help += [f"{_shown((toggle.key,))}: {toggle.label}" for toggle in keys.toggles]
        help += [f"{NEXT}: next episode", f"{LEAVE}: leave"]
        ranks = self._situation()
        situation = self.world.level + (f"   ranks: {ranks}" if ranks else "")
        return Text((*self._words(), *self._goal(), situation, progress, self.outcome), tuple(help))


def _steps(number: int) -> str:
    return f"{number} step{'' if number == 1 else 's'}"


_ARROWS = {"up": "↑", "down": "↓", "left": "←", "right": "→"}


def _shown(keys: tuple[str, ...]) -> str:
    return "/".join(_ARROWS.get(key, key) for key in keys)
