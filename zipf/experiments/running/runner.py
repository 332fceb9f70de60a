"""The runner: collect, update, log, evaluate, checkpoint, until the updates are made."""

from __future__ import annotations

import ctypes
import platform
import signal
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from types import FrameType
from typing import Any

import torch

from zipf import envs
from zipf.agents.agent import Agent, Setting, agents
from zipf.agents.exploration import build_exploration
from zipf.agents.unroll import Unroll
from zipf.envs.vector import ZipfVectorEnv
from zipf.experiments.config import Config, EvaluateOptions
from zipf.experiments.errors import UserError
from zipf.experiments.running import checkpoint, run_folder
from zipf.experiments.running.collector import Collector
from zipf.experiments.running.evaluator import AgentPolicy, Result, derive_seed, evaluate, scores
from zipf.experiments.running.logger import Display, Logger


def train(config: Config) -> int:
    """Trains until `config.updates`, or until told to stop; the run can go on later.

    Returns the number of the signal that stopped it, 0 where none did.

    Raises:
        UserError: the run cannot begin, go on or be written; what was saved before is kept.
    """
    keep_memory()
    with run_folder.lock(config.folder):
        try:
            return _train(Run(config))
        except RuntimeError as error:
            if not config.compile or not isinstance(error, torch._dynamo.exc.TorchDynamoException):
                raise
            first = str(error).strip().splitlines()[0]
            raise UserError(f"compile=true: {first}; choose compile=false") from None
        except MemoryError as error:
            raise UserError(
                f"not enough memory ({error}); collector.num_envs and collector.unroll_length say "
                "how much is held"
            ) from None


def _train(run: Run) -> int:
    config = run.config
    with run.display, StopSignals(run.display) as stop:
        if run.is_new:
            run.evaluate()
            run.save()
        while run.update < config.updates and not stop.requested:
            unroll = run.collector.collect()
            metrics = run.learn(unroll)
            run.update += 1
            if run.update % config.schedule.log_every == 0:
                run.log(unroll, metrics)
            if run.update % config.evaluation.every == 0 or run.update == config.updates:
                run.evaluate()
            if run.update % config.schedule.checkpoint_every == 0:
                run.save()
            run.display.advance(run.update)
        run.save()
    run.close()
    return stop.requested


class Run:
    """One training run: its parts, and where it stands."""

    def __init__(self, config: Config):
        self.config = config
        self.folder = config.folder
        env = envs.make_train(config.split, config.collector.num_envs, **config.level_options)
        self.agent = build_agent(config, env)
        try:
            notes = self.agent.begin_learning()
        except ValueError as error:
            raise UserError(str(error)) from None
        saved = run_folder.find_checkpoint(config)
        self.collector = Collector(
            env,
            self.agent,
            unroll_length=config.collector.unroll_length,
            seed=derive_seed(config.seed, "training"),
            device=config.torch_device,
            exploration=build_exploration(config.exploration),
        )
        self.frames_per_update = config.collector.num_envs * config.collector.unroll_length
        self.seconds = Seconds()
        self.update = 0
        self.is_new = saved is None
        torch.manual_seed(config.seed)
        if saved:
            self.load(saved)
        resumed_at = self.update if saved else None
        run_folder.write_description(config, env.situation, resumed_at)
        self.logger = Logger(self.folder, resume_at=self.update if saved else -1)
        self._logged = self.seconds.training, self.update
        name = f"{config.experiment} {config.condition} seed {config.seed}"
        where = "a new run"
        if saved:
            done = self.update >= config.updates
            where = f"{'is finished' if done else 'resumes'} at update {self.update}"
        self.display = Display(name, config.updates, self.update)
        self.display.say(f"{name}: {where}, on {config.torch_device}, in {self.folder}")
        self.logger.text(f"{name}: {where}, on {config.torch_device}")
        for note in notes:
            self.display.say(note)
            self.logger.text(note)

    def save(self) -> None:
        """Writes the checkpoint."""
        self.seconds.take(self.collector.seconds)
        state = {
            "options": self.config.what_is_learned,
            "update": self.update,
            "seconds": dict(self.seconds.spent),
            "agent": self.agent.state_dict(),
            "collector": self.collector.state_dict(),
            "torch_rng": torch.get_rng_state(),
        }
        checkpoint.save(self.folder / "checkpoint.pt", state)

    def load(self, saved: dict[str, Any]) -> None:
        """Stands where a checkpoint stood."""
        with run_folder.fits(self.folder / "checkpoint.pt"):
            self.update = saved["update"]
            self.seconds.spent = saved["seconds"]
            try:
                self.agent.load_state_dict(saved["agent"])
            except OSError as error:  # files that the checkpoint refers to
                raise UserError(str(error)) from None
            self.collector.load_state_dict(saved["collector"])
            torch.set_rng_state(saved["torch_rng"])

    def learn(self, unroll: Unroll) -> dict[str, float]:
        """One update.

        Raises:
            UserError: learning has diverged, or there is no room for what it needs.
        """
        try:
            with self.seconds("learning"):
                return self.agent.update(unroll)
        except FloatingPointError as error:
            raise UserError(
                f"{self.folder}: learning diverged at update {self.update + 1} ({error}); the "
                "checkpoint before it is kept; a smaller agent.learning_rate may help"
            ) from None
        except OSError as error:
            raise UserError(str(error)) from None

    def log(self, unroll: Unroll, metrics: dict[str, float]) -> None:
        """Writes a row of metrics."""
        self.seconds.take(self.collector.seconds)
        training = self.seconds.training
        then, update = self._logged
        self._logged = training, self.update
        row = {
            "frames": self.update * self.frames_per_update,
            "seconds": self.seconds.total,
            "frames_per_second": (self.update - update)
            * self.frames_per_update
            / (training - then),
            **{f"time_{part}": spent for part, spent in self.seconds.spent.items()},
            **dict.fromkeys(self.collector.metric_names, float("nan")),
            **self.collector.episode_metrics(),
            "exploration_bonus": float(unroll.steps["bonus"][:-1].mean()),
            **metrics,
        }
        self.logger.metrics(self.update, row)
        self.display.show_metrics(self.update, row)

    def evaluate(self) -> None:
        """Scores the agent and writes the rows; training's randomness is not touched."""
        with self.seconds("evaluation"):
            results = evaluate_agent(
                self.config,
                self.agent,
                episodes=self.config.evaluation.episodes,
                num_envs=self.config.evaluation.num_envs,
                seed=derive_seed(self.config.seed, "evaluation", self.update),
            )
        self.seconds.take(self.collector.seconds)
        when = {
            "update": self.update,
            "frames": self.update * self.frames_per_update,
            "seconds": self.seconds.total,
        }
        self.logger.evaluation(when, results)
        self.display.show_scores(self.update, results)
        shown = "  ".join(f"{kind} {score:.3f}" for kind, score in scores(results).items())
        self.logger.text(f"update {self.update}: {shown}")

    def close(self) -> None:
        """Says how to go on, and lets go of files and worlds."""
        if self.update < self.config.updates:
            self.display.say(
                f"stopped at update {self.update}; the same command goes on from there"
            )
        else:
            self.display.say(f"finished; python -m zipf.report {self.folder.parent.parent}")
        self.logger.text(f"stops at update {self.update}")
        self.logger.close()
        self.collector.env.close()


def build_agent(config: Config, env: ZipfVectorEnv) -> Agent:
    """The agent that the configuration names, for these worlds, with weights from its seed; its
    image encoders are compiled with `compile=true`.

    Raises:
        UserError: the network cannot read these observations, or they lack what the auxiliary loss
            is about.
    """
    setting = Setting(
        env.single_observation_space,
        env.single_action_space,
        config.network,
        config.memory,
        config.auxiliary,
        num_envs=config.collector.num_envs,
        unroll_length=config.collector.unroll_length,
        seed=derive_seed(config.seed, "weights"),
        device=config.torch_device,
        precision=config.precision,
        folder=config.folder,
        updates_between_checkpoints=config.schedule.checkpoint_every,
    )
    try:
        agent = agents()[config.agent.name](config.agent, setting)
    except ValueError as error:
        raise UserError(str(error)) from None
    if config.compile:
        agent.compile()
    return agent


def evaluate_agent(
    config: Config, agent: Agent, *, episodes: int, num_envs: int, seed: int
) -> list[Result]:
    """Scores an agent on its split's levels; every draw comes from `seed`."""
    return evaluate(
        AgentPolicy(agent, seed=derive_seed(seed, "actions"), device=config.torch_device),
        config.split,
        episodes=episodes,
        num_envs=num_envs,
        seed=seed,
        **config.level_options,
    )


def evaluate_run(options: EvaluateOptions) -> tuple[int, list[Result]]:
    """Scores the agent of a run's checkpoint; returns the update it stands at and its scores.

    Raises:
        UserError: no run, no checkpoint, or one that is damaged or of another configuration.
    """
    trained = load_agent(Path(options.run), options.device)
    results = evaluate_agent(
        trained.config,
        trained.agent,
        episodes=options.episodes,
        num_envs=options.num_envs,
        seed=options.seed,
    )
    return trained.update, results


@dataclass(frozen=True)
class Trained:
    """An agent as a run's checkpoint has it."""

    config: Config
    agent: Agent
    update: int


def load_agent(folder: Path, device: str) -> Trained:
    """The agent of a run's checkpoint.

    Raises:
        UserError: no run, no checkpoint, or one that is damaged or of another configuration.
    """
    config = run_folder.read_config(folder).model_copy(update={"device": device})
    saved = checkpoint.load(folder / "checkpoint.pt")
    run_folder.check_options(folder / "checkpoint.pt", saved, config)
    # Its spaces are the training levels', which may be several.
    env = envs.make_vec(config.split.uniform[0], 1, **config.level_options)
    agent = build_agent(config, env)
    env.close()
    with run_folder.fits(folder / "checkpoint.pt"):
        agent.load_state_dict(saved["agent"])
    return Trained(config, agent, saved["update"])


class Seconds:
    """Where the time goes."""

    def __init__(self) -> None:
        parts = ("environment", "inference", "learning", "evaluation")
        self.spent = dict.fromkeys(parts, 0.0)

    @property
    def total(self) -> float:
        return sum(self.spent.values())

    @property
    def training(self) -> float:
        return self.total - self.spent["evaluation"]

    def take(self, measured: dict[str, float]) -> None:
        """Moves what a collector measured over here."""
        for part, spent in measured.items():
            self.spent[part] += spent
            measured[part] = 0.0

    @contextmanager
    def __call__(self, part: str) -> Iterator[None]:
        start = time.perf_counter()
        yield
        self.spent[part] += time.perf_counter() - start


class StopSignals:
    """Ctrl-C and SIGTERM stop the loop after the update in progress; a second one at once."""

    def __init__(self, display: Display):
        self.display = display
        self.requested = 0

    def __enter__(self) -> StopSignals:
        self._before = {s: signal.signal(s, self._stop) for s in (signal.SIGINT, signal.SIGTERM)}
        return self

    def __exit__(self, *_: object) -> None:
        for number, handler in self._before.items():
            signal.signal(number, handler)

    def _stop(self, number: int, frame: FrameType | None) -> None:
        if self.requested:
            raise KeyboardInterrupt
        self.requested = number
        self.display.say(
            "stopping after this update, to leave a checkpoint; once more stops at once"
        )


def keep_memory() -> None:
    """Tells glibc to keep freed memory: returning activations to the kernel after every update
    costs a fifth to a third of a CPU's learning speed."""
    if platform.libc_ver()[0] == "glibc":
        trim_threshold, top_pad, mmap_max = -1, -2, -4
        libc = ctypes.CDLL(None)
        libc.mallopt(mmap_max, 0)
        libc.mallopt(trim_threshold, -1)  # never
        libc.mallopt(top_pad, 2**26)
