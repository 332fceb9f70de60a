"""Episodes on envs in turn, shown on a screen and recorded."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from math import ceil
from typing import Literal

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from zipf.envs.keyboard import LEAVE, NEXT, Keys
from zipf.envs.vector import ZipfVectorEnv
from zipf.experiments.evaluation.evaluator import Policy
from zipf.experiments.playing.recording import Recording
from zipf.experiments.playing.screens import Screen, Text, enlarge

_PAUSE = 1.0  # seconds on the last frame of an episode
_LOW = 288  # pixels; pictures of a smaller height are enlarged


@dataclass(frozen=True)
class PlayedLevel:
    """One env of a level, and who plays it."""

    level: str
    env: ZipfVectorEnv
    keys: Keys
    policy: Policy | None  # None: a person at the keyboard


class Shows:
    """Draws the picture and passes it to the screen and the recording, if there are any. `env` is
    one that will be shown. With `view` None both show the env, or in a terminal what the agent
    sees; with `scale` None, the factor of the picture's sides, it is chosen by its height."""

    def __init__(
        self,
        env: ZipfVectorEnv,
        screen: Screen | None,
        recording: Recording | None,
        view: Literal["world", "agent"] | None,
        scale: int | None,
    ) -> None:
        self.screen = screen
        self.recording = recording
        self.scale = scale
        # A terminal has too few characters for a picture of the whole env.
        coarse = screen is not None and screen.in_characters
        self.on_screen = view or ("agent" if coarse and has_image(env) else "world")
        self.recorded = view or "world"

    def step(self, env: ZipfVectorEnv, observation: dict[str, NDArray], text: Text) -> None:
        """Shows and records the current state of the env."""
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
    toggled: int = 0

    def play(self, episodes: int | None) -> None:
        """Plays this number of episodes; None: until the person leaves."""
        several = len(self.levels) > 1
        for one in self.levels:
            if one.policy:
                one.policy.start(1)
        number = 0
        try:
            while episodes is None or number < episodes:
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
        self.name = f"episode {number}" + (f", {one.level}" if names_level else "")
        self.steps = 0
        self.total = 0.0
        self.outcome = ""

    def play(self, seed: int | None) -> None:
        """Plays the episode to its end, or until the person skips to the next one.
        Raises _Leave: the person leaves."""
        self.observation, self.info = self.env.reset(seed=seed)
        self.reward, self.is_first = np.zeros(1, np.float32), np.ones(1, np.bool_)
        self.due = time.monotonic()
        self.shows.step(self.env, self.observation, self._text())
        try:
            while not self.outcome:
                action = self._keyboard() if self.one.policy is None else self._scripted()
                if action is None:
                    return
                self._step(action)
        finally:
            about = ", ".join(filter(None, [*self._words(), self._situation()]))
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

    def _situation(self) -> str:
        return ", ".join(f"{name} {self.info[name][0]}" for name in self.env.situation)

    def _words(self) -> list[str]:
        """The instruction, in levels that give one."""
        text = str(self.info["instruction"][0]) if "instruction" in self.info else ""
        return [text] if text else []

    def _goal(self) -> list[str]:
        """What a person is to do, in families that say it."""
        goal = self.one.keys.goal
        return [goal] if goal and self.one.policy is None else []

    def _text(self) -> Text:
        keys = self.one.keys
        progress = f"{self.name}   step {self.steps}   return {self.total:g}"
        help = []
        if self.one.policy is None:
            for i, toggle in enumerate(keys.toggles):
                state = "on" if self.session.toggled >> i & 1 else "off"
                progress += f"   {toggle.label} {state}"
            for binding in keys.bindings:
                help.append(f"{_shown(binding.keys)}: {binding.label}")
            help += [f"{_shown((toggle.key,))}: {toggle.label}" for toggle in keys.toggles]
        help += [f"{NEXT}: next episode", f"{LEAVE}: leave"]
        ranks = self._situation()
        situation = self.one.level + (f"   ranks: {ranks}" if ranks else "")
        return Text((*self._words(), *self._goal(), situation, progress, self.outcome), tuple(help))


def _steps(number: int) -> str:
    return f"{number} step{'' if number == 1 else 's'}"


_ARROWS = {"up": "↑", "down": "↓", "left": "←", "right": "→"}


def _shown(keys: tuple[str, ...]) -> str:
    return "/".join(_ARROWS.get(key, key) for key in keys)
