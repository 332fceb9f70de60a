"""Episodes on envs in turn, shown on a screen and recorded."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from zipf.envs.keyboard import LEAVE, NEXT, Keys
from zipf.envs.pictures import fit
from zipf.envs.vector import ZipfVectorEnv
from zipf.experiments.playing.captions import captioned
from zipf.experiments.playing.recording import Recording
from zipf.experiments.playing.screens import Screen, Text

if TYPE_CHECKING:
    from zipf.experiments.evaluation.evaluator import Policy

_PAUSE = 1.0  # seconds on the last frame of an episode


@dataclass(frozen=True)
class PlayedLevel:
    """One env of a level, and who plays it."""

    level: str
    title: str  # of the level and of who plays it
    env: ZipfVectorEnv
    keys: Keys
    policy: Policy | None  # None: a person at the keyboard


class Shows:
    """Draws pictures, as large as fits into `size` (width, height), and passes them to the screen
    and the recording, if there are any. `env` is one that will be shown. With `view` None both show
    the env, or in a terminal what the agent sees."""

    def __init__(
        self,
        env: ZipfVectorEnv,
        screen: Screen | None,
        recording: Recording | None,
        view: Literal["world", "agent"] | None,
        size: tuple[int, int],
    ) -> None:
        self.screen = screen
        self.recording = recording
        self.size = size
        # A terminal has too few characters for a picture of the whole env.
        coarse = screen is not None and screen.in_characters
        self.on_screen = view or ("agent" if coarse and has_image(env) else "world")
        self.recorded = view or "world"

    def step(
        self, env: ZipfVectorEnv, observation: dict[str, NDArray], text: Text, *, due: bool
    ) -> None:
        """Shows the current state of the env and records it, where the recording leaves out frames
        only if it is `due` in any case."""
        if self.recording:
            frame = None
            if due or self.recording.due:
                picture = self._picture(self.recorded, env, observation)
                frame = captioned(picture, text.lines, text.success)
            self.recording.add(frame)
        self.again(env, observation, text)

    def again(self, env: ZipfVectorEnv, observation: dict[str, NDArray], text: Text) -> None:
        """Shows the current state again, with another text."""
        if self.screen:
            if self.screen.in_characters and self.on_screen == "agent":
                picture = observation["image"][0]  # which the terminal scales
            else:
                picture = self._picture(self.on_screen, env, observation)
            self.screen.show(picture, text)

    def _picture(
        self, view: str, env: ZipfVectorEnv, observation: dict[str, NDArray]
    ) -> NDArray[np.uint8]:
        if view == "world":
            return env.pictures(*self.size)[0]
        return fit(observation["image"][0], *self.size)


def has_image(env: ZipfVectorEnv) -> bool:
    """Whether observations have an image."""
    space = env.single_observation_space.get("image")
    return isinstance(space, spaces.Box) and len(space.shape) == 3 and space.dtype == np.uint8


class _Leave(Exception):
    """Raised when the person leaves."""


@dataclass
class Session:
    """Plays episodes on the envs, in turn."""

    levels: list[PlayedLevel]
    shows: Shows
    fps: float
    seed: int
    say: Callable[[str], None]
    # is told of every step: the episode, from 1, and its step
    watch: Callable[[int, int], None] | None
    episodes: int | None  # how many to play; None: until the person leaves
    toggled: int = 0

    def play(self) -> None:
        """Plays the episodes."""
        several = len(self.levels) > 1
        for one in self.levels:
            if one.policy:
                one.policy.start(1)
        number = 0
        try:
            while self.episodes is None or number < self.episodes:
                turn, number = number, number + 1
                one = self.levels[turn % len(self.levels)]
                seed = self.seed if turn < len(self.levels) else None
                _Episode(self, one, number, several).play(seed)
        except _Leave:
            pass


class _Episode:
    def __init__(self, session: Session, one: PlayedLevel, number: int, names_level: bool) -> None:
        self.session = session
        self.one = one
        self.env = one.env
        self.shows = session.shows
        self.number = number
        self.name = f"episode {number}" + (f", {one.level}" if names_level else "")
        self.steps = 0
        self.total = 0.0
        self.outcome = ""
        self.success: bool | None = None

    def play(self, seed: int | None) -> None:
        """Plays the episode to its end, or until the person skips to the next one.
        Raises _Leave: the person leaves."""
        self.observation, self.info = self.env.reset(seed=seed)
        self.reward, self.is_first = np.zeros(1, np.float32), np.ones(1, np.bool_)
        self.due = time.monotonic()
        self._show(due=True)
        try:
            while not self.outcome:
                action = self._keyboard() if self.one.policy is None else self._scripted()
                if action is None:
                    return
                self._step(action)
        finally:
            about = situation_of(self.env, self.info, joint=", ")
            outcome = self.outcome or f"left after {_steps(self.steps)}"
            self.session.say(": ".join(filter(None, [self.name, about, outcome])))
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
            if self.env.reports_success:
                self.success = bool(self.info["success"][0])
                if self.success or not truncated[0]:
                    ending = "success" if self.success else "failure"
            self.outcome = f"{ending}, return {total:g}, {_steps(length)}"
        self._show(due=bool(self.outcome))

    def _show(self, *, due: bool) -> None:
        self.shows.step(self.env, self.observation, self._text(), due=due)
        if self.session.watch:
            self.session.watch(self.number, self.steps)

    def _keyboard(self) -> int | None:
        """The person's action; None for the next episode."""
        while True:
            key = self._key(None)
            if key == NEXT:
                return None
            before = self.session.toggled
            action, self.session.toggled = self.one.keys.press(str(key), before)
            if action is not None:
                return action
            if self.session.toggled != before:
                self.shows.again(self.env, self.observation, self._text())

    def _scripted(self) -> int | None:
        """The policy's action, at its time; None for the next episode."""
        assert self.one.policy
        self.env.check_lengths()
        action = int(self.one.policy(self.observation, self.reward, self.is_first)[0])
        if self.shows.screen:
            self.due = max(self.due + 1 / self.session.fps, time.monotonic())
            if self._watch():
                return None
        return action

    def _rest(self) -> None:
        if self.shows.recording:
            self.shows.recording.hold(_PAUSE)
        if self.one.policy is None:
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

    def _text(self) -> Text:
        keys = self.one.keys
        progress = f"{self.name}   step {self.steps}   return {self.total:g}"
        if self.outcome:
            progress = f"{self.name}: {self.outcome}"
        help = []
        by_hand = self.one.policy is None
        if by_hand:
            for i, toggle in enumerate(keys.toggles):
                state = "on" if self.session.toggled >> i & 1 else "off"
                progress += f"   {toggle.label} {state}"
            for binding in keys.bindings:
                help.append(f"{_shown(binding.keys)}: {binding.label}")
            help += [f"{_shown((toggle.key,))}: {toggle.label}" for toggle in keys.toggles]
        help += [f"{NEXT}: next episode", f"{LEAVE}: leave"]
        goal = [keys.goal] if keys.goal and by_hand else []  # what a person is to do
        about = situation_of(self.env, self.info)
        return Text((*goal, self.one.title, about, progress), tuple(help), self.success)


def situation_of(env: ZipfVectorEnv, info: dict[str, Any], joint: str = "   ") -> str:
    """What the episode of a single env is about: the instruction, the level, where one is drawn,
    and the ranks; each where there are any."""
    drawn = env.level_of_envs
    names = ["instruction", *([drawn] if isinstance(drawn, str) else [])]
    words = [str(info[name][0]) for name in names if name in info]
    ranks = ", ".join(f"{name} {info[name][0]}" for name in env.situation)
    ranks = f"ranks: {ranks}" if ranks else ""
    return joint.join(filter(None, [*words, ranks]))


def _steps(number: int) -> str:
    return f"{number} step{'' if number == 1 else 's'}"


_ARROWS = {"up": "↑", "down": "↓", "left": "←", "right": "→"}


def _shown(keys: tuple[str, ...]) -> str:
    return "/".join(_ARROWS.get(key, key) for key in keys)
