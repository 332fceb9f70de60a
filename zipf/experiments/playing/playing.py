"""Playing and watching: episodes played by a person, a script or a trained agent."""

from __future__ import annotations

import secrets
from collections.abc import Callable
from contextlib import ExitStack
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from gymnasium.vector import AutoresetMode
from numpy.typing import NDArray
from pydantic import Field

from zipf import envs
from zipf.envs.keyboard import Keys
from zipf.envs.vector import ZipfVectorEnv
from zipf.errors import UserError
from zipf.experiments.building.seeds import derive_seed
from zipf.experiments.evaluation.agent_policy import AgentPolicy
from zipf.experiments.evaluation.evaluator import Policy
from zipf.experiments.evaluation.scripted import ScriptedPolicy
from zipf.experiments.evaluation.trained import TrainedAgent, load_agent
from zipf.experiments.options import composing
from zipf.experiments.options.schema import PositiveInt, Seed, module_names
from zipf.experiments.playing.recording import Recording, check_recording, usual_fps
from zipf.experiments.playing.screens import open_screen
from zipf.experiments.playing.sessions import PlayedLevel, Session, Shows, has_image
from zipf.options import Options


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


def play(options: PlayOptions, say: Callable[[str], None]) -> None:
    """Plays, shows and records episodes as the options say; `say` prints a line about each episode
    and file, while no screen is open. Raises UserError: options that contradict each other, or that
    this machine cannot fulfil."""
    policy = _who_plays(options)
    if options.record:  # making the envs may take a minute
        check_recording(Path(options.record), options.fps or 0)
    seed = secrets.randbelow(2**31) if options.seed is None else options.seed
    levels = _played_levels(options, policy, seed)
    say(f"{', '.join(one.level for one in levels)}, seed {seed}")
    for one in levels:
        # The first reset may compile for a minute: do so before a screen is open.
        one.env.reset(seed=seed)
        one.env.render()
    fps = options.fps or usual_fps(levels[0].env)
    with ExitStack() as stack:
        for one in levels:
            stack.callback(one.env.close)
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
        shows = Shows(levels[0].env, screen, recording, options.view, options.scale)
        episodes = options.episodes or (1 if screen is None else None)
        Session(levels, shows, fps, seed, say_episode).play(episodes)


def _who_plays(options: PlayOptions) -> str:
    """The policy, with a default where it is not set.
    Raises UserError with a line for each option that is missing or contradicts another."""
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


def _played_levels(options: PlayOptions, policy: str, seed: int) -> list[PlayedLevel]:
    """An env of each level; they are played in turn."""
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
    levels = []
    for level in _levels(options, trained):
        env = _make(level, level_options)
        if trained and policy == "agent":
            _check_spaces(level, env, trained)
        if options.view == "agent" and not has_image(env):
            raise UserError("view=agent: these observations have no image; use view=world")
        keys = envs.keys(level)
        if policy == "keyboard" and keys is None:
            raise UserError(f"policy=keyboard: there are no keys for {level}")
        chosen: Policy | None = None
        if policy == "agent":
            chosen = agent
        elif policy == "random":
            chosen = _Random(env, derive_seed(seed, "actions"))
        elif policy in envs.SCRIPTED:
            chosen = ScriptedPolicy(policy)
            try:
                chosen.enter(level, env)
            except ValueError as error:
                raise UserError(f"{error}; policy=random plays all levels") from None
        levels.append(PlayedLevel(level, env, keys or Keys(()), chosen))
    return levels


def _levels(options: PlayOptions, trained: TrainedAgent | None) -> list[str]:
    if trained is None or options.level not in (None, *envs.KINDS):
        return [str(options.level)]
    split = envs.split(trained.config.environment.split)
    return [level.name for level in split.levels(options.level or "train")]


def _make(level: str, level_options: dict[str, Any]) -> ZipfVectorEnv:
    try:
        known = envs.find_level(level)[0].options_class.model_fields
        if not level_options.keys() <= known.keys():
            raise UserError(f"level={level}: belongs to another family than the run's levels")
        drawn: dict[str, Any] = {
            "autoreset_mode": AutoresetMode.DISABLED,
            "render_mode": "rgb_array",
        }
        return envs.make_vec(level, 1, **drawn, **level_options)
    except ValueError as error:
        raise UserError(str(error)) from None


def _check_spaces(level: str, env: ZipfVectorEnv, trained: TrainedAgent) -> None:
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
    def __init__(self, env: ZipfVectorEnv, seed: int) -> None:
        self.actions = int(env.single_action_space.n)
        self.rng = np.random.default_rng(seed)

    def start(self, num_envs: int) -> None: ...

    def __call__(
        self, observation: dict[str, NDArray], reward: NDArray, is_first: NDArray
    ) -> NDArray:
        return self.rng.integers(self.actions, size=len(is_first))


def _say_all(lines: list[str], say: Callable[[str], None]) -> None:
    for line in lines:
        say(line)


def _say_written(recording: Recording, say: Callable[[str], None]) -> None:
    width, height = recording.size
    if recording.written:
        say(f"written: {recording.path} ({recording.frames} frames, {width} x {height})")
