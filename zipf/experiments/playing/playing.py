"""Playing and watching: episodes played by a person, a script or a trained agent."""

from __future__ import annotations

import os
import re
import secrets
from collections.abc import Callable, Iterator
from contextlib import ExitStack, closing, contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import numpy as np
from gymnasium.vector import AutoresetMode
from numpy.typing import NDArray
from pydantic import AfterValidator, BeforeValidator, Field

from zipf import envs
from zipf.envs.keyboard import Keys
from zipf.envs.vector import ZipfVectorEnv
from zipf.errors import UserError
from zipf.experiments.building.seeds import derive_seed
from zipf.experiments.evaluation.scripted import ScriptedPolicy
from zipf.experiments.options import composing
from zipf.experiments.options.schema import PositiveInt, Seed, module_names
from zipf.experiments.playing.recording import STILL, Recording, check_recording
from zipf.experiments.playing.screens import Text, open_screen
from zipf.experiments.playing.sessions import (
    PlayedLevel,
    Session,
    Shows,
    has_image,
    situation_of,
)
from zipf.options import Options
from zipf.output import console, is_quiet

if TYPE_CHECKING:
    from zipf.experiments.evaluation.evaluator import Policy
    from zipf.experiments.evaluation.trained import TrainedAgent


def _size(value: object) -> tuple[int, int]:
    found = re.fullmatch(r"(\d{1,5})x(\d{1,5})", str(value))
    size = (int(found[1]), int(found[2])) if found else (0, 0)
    if not all(64 <= side <= 4096 for side in size):
        raise ValueError("should be <width>x<height> such as 1280x960, each 64 to 4096 pixels")
    return size


class PlayOptions(Options):
    """The options of `python -m zipf.play`."""

    level: Annotated[str, Field(min_length=1)] | None = None
    run: Annotated[str, Field(min_length=1)] | None = None
    policy: Literal["keyboard", "random", envs.Scripted, "agent"] | None = None
    record: Annotated[str, Field(min_length=1), AfterValidator(os.path.expanduser)] | None = None
    episodes: PositiveInt | None = None
    plugins: str = ""
    seed: Seed | None = None
    fps: Annotated[int, Field(ge=1, le=120)] | None = None
    size: Annotated[tuple[int, int], BeforeValidator(_size)] = (640, 480)
    view: Literal["world", "agent"] | None = None
    screen: Literal["auto", "window", "terminal"] = "auto"

    @property
    def still(self) -> bool:
        """Whether one picture is recorded, in which nobody acts."""
        return self.record is not None and Path(self.record).suffix.lower() == STILL


def play(options: PlayOptions, say: Callable[[str], None]) -> None:
    """Plays, shows and records episodes as the options say; `say` prints a line about each episode
    and file, while no screen is open. Raises UserError: options that contradict each other, or that
    this machine cannot fulfil."""
    policy = _who_plays(options)
    # Making the envs may take a minute: what can be refused before is.
    if options.record:
        check_recording(Path(options.record))
    names = module_names(options.plugins)
    composing.load_plugins(names)
    trained = _load(options.run, names) if options.run else None
    keys = _keys(options, trained, policy)
    screen = None
    if policy == "keyboard" or not options.record:
        screen = open_screen(options.screen)
    seed = secrets.randbelow(2**31) if options.seed is None else options.seed
    levels = _played_levels(options, trained, policy, keys, seed)
    say(f"{', '.join(one.level for one in levels)}, seed {seed}")
    if options.still:
        with closing(levels[0].env):
            _draw_still(options, levels[0], seed, say)
        return
    for one in levels:
        # The first reset may compile for a minute: do so before a screen is open.
        one.env.reset(seed=seed)
        one.env.pictures(*options.size)
    fps = options.fps or levels[0].env.metadata["render_fps"]
    with ExitStack() as stack:
        for one in levels:
            stack.callback(one.env.close)
        lines: list[str] = []
        recording, watch = None, None
        say_episode = say
        if screen:
            stack.callback(_say_all, lines, say)
            say_episode = lines.append
        if options.record:
            recording = Recording(Path(options.record), fps)
            stack.callback(_say_written, recording, say_episode)
            stack.enter_context(recording)
        if screen:
            stack.enter_context(screen)
        episodes = options.episodes or (1 if screen is None else None)
        if screen is None and recording:
            watch = stack.enter_context(_progress(recording, levels, episodes or 1))
        shows = Shows(levels[0].env, screen, recording, options.view, options.size)
        Session(levels, shows, fps, seed, say_episode, watch, episodes).play()


def _who_plays(options: PlayOptions) -> str:
    """The policy, with a default where it is not set.
    Raises UserError with a line for each option that is missing or contradicts another."""
    problems = []
    if not options.level and not options.run:
        problems.append("level is not set: choose level=<a level's name> or run=<a run's folder>")
    if options.still:
        problems += [
            f"{name}={getattr(options, name)}: does not go with record={options.record}, "
            "the first frame of an episode; a .gif or .mp4 is a film"
            for name in ("policy", "episodes", "fps")
            if name in options.model_fields_set
        ]
    policy = options.policy
    if policy is None:
        policy = "agent" if options.run else "random" if options.still else "keyboard"
        if options.record and not options.run and not options.still:
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


def _keys(options: PlayOptions, trained: TrainedAgent | None, policy: str) -> dict[str, Keys]:
    """The levels, which are played in turn, and what the keys of each do.
    Raises UserError: there is no such level, or nobody can play it so."""
    levels = [str(options.level)]
    if trained is not None and options.level in (None, *envs.KINDS):
        split = envs.split(trained.config.environment.split)
        levels = [level.name for level in split.levels(options.level or "train")]
        if not levels:
            kinds = ", ".join(split.kinds)
            raise UserError(f"level={options.level}: the run has no such level; expected {kinds}")
    if trained and policy == "agent" and trained.agent.answers_questions:
        raise UserError(f"run={options.run}: a classifier answers questions and does not act")
    found = {}
    for level in levels:
        try:
            keys = envs.keys(level)
        except ValueError as error:
            raise UserError(str(error)) from None
        if policy == "keyboard" and keys is None:
            raise UserError(f"policy=keyboard: there are no keys for {level}")
        found[level] = keys or Keys(())
    return found


def _played_levels(
    options: PlayOptions,
    trained: TrainedAgent | None,
    policy: str,
    keys: dict[str, Keys],
    seed: int,
) -> list[PlayedLevel]:
    """An env of each level."""
    level_options = trained.config.level_options if trained else {}
    own = {one.name: one.options for one in trained.config.split.all_levels} if trained else {}
    agent = None
    who = f"policy {policy}"
    if trained and policy == "agent":
        from zipf.experiments.evaluation.agent_policy import AgentPolicy

        actions = derive_seed(seed, "actions")
        agent = AgentPolicy(trained.agent, seed=actions)
        who = f"agent {trained.config.row.title}, seed {trained.config.seed}"
    levels = []
    for level in keys:
        env = _make(level, {**level_options, **own.get(level, {})})
        if trained and policy == "agent":
            _check_spaces(level, env, trained)
        if options.view == "agent" and not has_image(env):
            raise UserError("view=agent: these observations have no image; use view=world")
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
        title = level if options.still else f"{level}   {who}"
        levels.append(PlayedLevel(level, title, env, keys[level], chosen))
    return levels


def _draw_still(
    options: PlayOptions, one: PlayedLevel, seed: int, say: Callable[[str], None]
) -> None:
    observation, info = one.env.reset(seed=seed)
    recording = Recording(Path(str(options.record)), 1)
    shows = Shows(one.env, None, recording, options.view, options.size)
    with recording:
        text = Text((one.title, situation_of(one.env, info)), ())
        shows.step(one.env, observation, text, due=True)
    _say_written(recording, say)


@contextmanager
def _progress(
    recording: Recording, levels: list[PlayedLevel], episodes: int
) -> Iterator[Callable[[int, int], None]]:
    """A bar on a terminal, of the steps that there are at most."""
    from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

    limits = [one.env.time_limit for one in levels]
    longest = None if None in limits else max(limit or 0 for limit in limits)
    shown = console().is_terminal and not is_quiet()
    columns = TextColumn("{task.description}"), BarColumn(), TimeElapsedColumn()
    with Progress(*columns, transient=True, disable=not shown) as bar:
        task = bar.add_task("recording", total=longest and longest * episodes)

        def watch(episode: int, step: int) -> None:
            said = f"episode {episode} of {episodes}, step {step}, {recording.bytes / 1e6:.1f} MB"
            done = None if longest is None else longest * (episode - 1) + step
            bar.update(task, completed=done, description=said)

        yield watch


def _load(folder: str, plugins: list[str]) -> TrainedAgent:
    from zipf.experiments.evaluation.trained import load_agent  # takes seconds to import

    return load_agent(Path(folder), "cpu", plugins)


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
    spaces = env.single_observation_space, env.single_action_space
    if spaces != (trained.observation_space, trained.action_space):
        raise UserError(f"level={level}: has other observations or actions than the run's levels")


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
        frames = f"{recording.frames} frame{'' if recording.frames == 1 else 's'}"
        size = recording.path.stat().st_size / 1e6
        say(f"written: {recording.path} ({frames}, {width} x {height}, {size:.2g} MB)")
