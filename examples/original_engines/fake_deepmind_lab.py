"""A stand-in for DeepMind Lab's Python module, which cannot be installed from a package index.

It has the interface of `docs/users/python_api.md` and `python/dmlab_module.c` of
github.com/google-deepmind/lab and refuses whatever these refuse, with their exceptions; and it
refuses what they leave undefined: actions out of bounds, and calls of a closed instance.
"""

from typing import Any, ClassVar

import numpy as np

from zipf.envs.labyrinth.levels import LEVELS

_SIZES = {"width": 320, "height": 240, "fps": 60}
_OBSERVATIONS = ("RGB_INTERLEAVED", "RGBD_INTERLEAVED", "RGB", "INSTR", "DEBUG.POS.TRANS")
_BOUNDS = {
    "LOOK_LEFT_RIGHT_PIXELS_PER_FRAME": (-512, 512),
    "LOOK_DOWN_UP_PIXELS_PER_FRAME": (-512, 512),
    "STRAFE_LEFT_RIGHT": (-1, 1),
    "MOVE_BACK_FORWARD": (-1, 1),
    "FIRE": (0, 1),
    "JUMP": (0, 1),
    "CROUCH": (0, 1),
}
_INSTRUCTIONS = ("red ball", "Every blue object", "Is any hat magenta?")


class Lab:
    """An engine. A point moves on a ring of `RING` places, by the actions; it shows where it is."""

    RING = 61
    lost: ClassVar[frozenset[str]] = frozenset()  # levels whose data set is not there
    words: ClassVar[tuple[str, ...]] = _INSTRUCTIONS
    sound: ClassVar[bool] = True  # False: the seed does not determine an episode
    opened: ClassVar[list["Lab"]] = []
    """All instances that were made, closed ones included."""

    def __init__(
        self,
        level: str,
        observations: list[str],
        config: dict[str, str] | None = None,
        renderer: str = "software",
        level_cache: Any = None,
    ) -> None:
        if not isinstance(observations, list):
            raise TypeError(f"argument 2 must be list, not {type(observations).__name__}")
        config = {} if config is None else config
        if not isinstance(config, dict):
            raise TypeError(f"argument 3 must be dict, not {type(config).__name__}")
        if any(not isinstance(part, str) for pair in config.items() for part in pair):
            raise TypeError("bad argument type for built-in operation")
        if renderer not in ("software", "hardware"):
            raise RuntimeError(
                f'Failed to set renderer must be "hardware" or "software" {renderer}'
            )
        self.name = level.removeprefix("contributed/dmlab30/")
        if self.name == level or self.name not in LEVELS:
            raise RuntimeError(f"Invalid levelName flag '{level}' - \"no such script\"")
        for name in observations:
            if name not in _OBSERVATIONS:
                raise ValueError(f"Unknown observation '{name}'.")
        sizes = {key: int(config.get(key, str(value))) for key, value in _SIZES.items()}
        self.height, self.width = sizes["height"], sizes["width"]
        self.limit = LEVELS[self.name].seconds * sizes["fps"]
        self.wanted = observations
        self.status = "uninitialised"
        self.calls: list[tuple[list[int], int]] = []
        Lab.opened.append(self)

    def reset(self, episode: int = -1, seed: int | None = None) -> bool:
        self._open()
        if seed is not None and type(seed) is not int:
            raise ValueError(f"'seed' must be int or None, was '{type(seed).__name__}'.")
        if seed is not None and not -(2**31) <= seed < 2**31:
            raise OverflowError("Python int too large to convert to C int")
        if self.name in Lab.lost:
            raise RuntimeError(f'Failed to start environment - "no data set of {self.name}"')
        self.generator = np.random.default_rng(seed if Lab.sound else None)
        self.place, away = self.generator.integers([0, 1], self.RING).tolist()
        self.goal = (self.place + away) % self.RING
        self.frames = 0
        self.status = "running"
        return True

    def num_steps(self) -> int:
        return self.frames

    def is_running(self) -> bool:
        return self.status == "running"

    def step(self, action: np.ndarray, num_steps: int = 1) -> float:
        self._open()
        if not isinstance(action, np.ndarray):
            raise TypeError(f"argument 1 must be numpy.ndarray, not {type(action).__name__}")
        if self.status != "running":
            raise RuntimeError("Environment in wrong status to advance.")
        if action.shape != (len(_BOUNDS),):
            raise ValueError(f"action must have shape ({len(_BOUNDS)})")
        if action.dtype != np.intc:
            raise ValueError("action must have dtype np.intc")
        for value, (name, (low, high)) in zip(action.tolist(), _BOUNDS.items(), strict=True):
            assert low <= value <= high, f"{name}={value} is out of bounds: undefined"
        self.calls.append((action.tolist(), num_steps))
        reward = 0.0
        for _ in range(num_steps):
            self.frames += 1
            look, _, strafe, move, *_ = action.tolist()
            self.place = (self.place + look + strafe + 3 * move) % self.RING
            if self.place == self.goal:
                reward += 1.0
                self.status = "terminated"
            if self.frames >= self.limit:
                self.status = "terminated"
            if self.status == "terminated":
                break
        return reward

    def observations(self) -> dict[str, Any]:
        self._open()
        if self.status != "running":
            raise RuntimeError("Environment in wrong status for call to observations()")
        told: dict[str, Any] = {}
        if "RGB_INTERLEAVED" in self.wanted:
            image = np.full((self.height, self.width, 3), self.place, np.uint8)
            image[0, 0] = self.goal, self.frames // 256 % 256, self.frames % 256
            told["RGB_INTERLEAVED"] = image
        if "INSTR" in self.wanted:
            speaks = self.name.startswith("language_")
            told["INSTR"] = Lab.words[self.goal % len(Lab.words)] if speaks else ""
        return told

    def action_spec(self) -> list[dict[str, Any]]:
        return [{"name": name, "min": low, "max": high} for name, (low, high) in _BOUNDS.items()]

    def close(self) -> bool:
        was_open = self.status != "closed"
        self.status = "closed"
        return was_open

    def _open(self) -> None:
        assert self.status != "closed", "only is_running() may be called of a closed instance"
