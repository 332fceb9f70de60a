"""The runner: collect, update, log, evaluate, checkpoint, until the updates are made."""

from __future__ import annotations

import ctypes
import json
import os
import platform
import shlex
import signal
import subprocess
import sys
import time
from pathlib import Path
from types import FrameType
from typing import Any

import torch
from omegaconf import OmegaConf

import zipf
from zipf.agents.exploration import build_exploration
from zipf.agents.impala import Impala
from zipf.envs import levels
from zipf.envs.vector import ZipfVectorEnv
from zipf.experiments import checkpoint
from zipf.experiments.collector import Agent, Collector
from zipf.experiments.config import Config
from zipf.experiments.errors import UserError
from zipf.experiments.evaluator import KINDS, AgentPolicy, Result, derive_seed, evaluate
from zipf.experiments.logger import Display, Logger


def train(config: Config) -> bool:
    """Trains until `config.updates`; True when it got there, False when told to stop before.

    Raises:
        UserError: the run cannot begin, go on or be written; what was saved before is kept.
    """
    keep_memory()
    device = config.torch_device
    folder = config.folder
    split = levels.split(config.environment.split)
    env = levels.make_vec(split.train, config.collector.num_envs, **config.level_options)
    agent = build_agent(config, env)
    collector = Collector(
        env,
        agent,
        unroll_length=config.collector.unroll_length,
        seed=derive_seed(config.seed, "training"),
        device=device,
        exploration=build_exploration(config.exploration),
    )
    saved = find_checkpoint(config)
    update, seconds = 0, Seconds()
    if saved:
        update = saved["update"]
        seconds.spent = saved["seconds"]
        agent.load_state_dict(saved["agent"])
        collector.load_state_dict(saved["collector"])
        torch.set_rng_state(saved["torch_rng"])
    else:
        torch.manual_seed(config.seed)
        write_description(config)
    frames_per_update = config.collector.num_envs * config.collector.unroll_length

    def save() -> None:
        state = {
            "options": config.what_is_learned,
            "update": update,
            "seconds": dict(seconds.spent),
            "agent": agent.state_dict(),
            "collector": collector.state_dict(),
            "torch_rng": torch.get_rng_state(),
        }
        checkpoint.save(folder / "checkpoint.pt", state)

    def score() -> None:
        with seconds("evaluation"):
            results = evaluate_agent(config, agent, update)
        when = {"update": update, "frames": update * frames_per_update, "seconds": seconds.total}
        logger.evaluation(when, results)
        display.show_scores(update, results)
        logger.text(f"update {update}: " + "  ".join(f"{r.kind} {r.score:.3f}" for r in results))

    logger = Logger(folder, resume_at=update if saved else -1)
    name = f"{config.experiment} {config.condition} seed {config.seed}"
    logger.text(f"{'resumes' if saved else 'starts'} {name} at update {update} on {device}")
    with Display(name, config.updates, update) as display, StopSignals(display) as stop:
        display.console.print(
            f"{name}: {'resumes at update ' + str(update) if saved else 'a new run'} on {device}, "
            f"in {folder}"
        )
        if not saved:
            score()
            save()
        since = time.perf_counter(), update
        while update < config.updates and not stop.requested:
            unroll = collector.collect()
            with seconds("learning"):
                metrics = agent.update(unroll)
            seconds.take(collector.seconds)
            update += 1
            display.advance(update)
            if update % config.schedule.log_every == 0:
                now = time.perf_counter()
                rate = (update - since[1]) * frames_per_update / (now - since[0])
                since = now, update
                row = {
                    "frames": update * frames_per_update,
                    "seconds": seconds.total,
                    "frames_per_second": rate,
                    **{f"time_{part}": spent for part, spent in seconds.spent.items()},
                    **{f"episode_{name}": float("nan") for name in ("return", "length", "success")},
                    **collector.episode_metrics(),
                    "exploration_bonus": float(unroll.steps["bonus"][:-1].mean()),
                    **metrics,
                }
                logger.metrics(update, row)
                display.show_metrics(update, row)
            if update % config.evaluation.every == 0 or update == config.updates:
                score()
            if update % config.schedule.checkpoint_every == 0:
                save()
        save()
    logger.text(f"stops at update {update}")
    logger.close()
    env.close()
    return update >= config.updates


def build_agent(config: Config, env: ZipfVectorEnv) -> Agent:
    """The agent that the configuration names, for these worlds, with weights from its seed.

    Raises:
        UserError: the network cannot read these observations.
    """
    try:
        return Impala(
            env.single_observation_space,
            env.single_action_space,
            config.agent,
            config.network,
            config.memory,
            seed=derive_seed(config.seed, "weights"),
            device=config.torch_device,
            precision=config.precision,
        )
    except ValueError as error:
        raise UserError(str(error)) from None


def evaluate_agent(config: Config, agent: Agent, update: int) -> list[Result]:
    """Scores the agent as the schedule asks; draws depend on the run's seed and the update only."""
    seed = derive_seed(config.seed, "evaluation", update)
    return evaluate(
        AgentPolicy(agent, seed=seed, device=config.torch_device),
        levels.split(config.environment.split),
        episodes=config.evaluation.episodes,
        num_envs=config.evaluation.num_envs,
        seed=seed,
        **config.level_options,
    )


def find_checkpoint(config: Config) -> dict[str, Any] | None:
    """The state to resume from, or None for a new run, as `config.resume` allows.

    Raises:
        UserError: there is none and `must`; there is one and `never`; it is damaged or was made
            with other options.
    """
    path = config.folder / "checkpoint.pt"
    if not path.exists():
        if config.resume == "must":
            raise UserError(f"resume=must: there is no checkpoint {path}")
        return None
    if config.resume == "never":
        raise UserError(
            f"resume=never: {config.folder} holds a run already; remove it, or choose another "
            "run_root or condition"
        )
    saved = checkpoint.load(path)
    there, here = saved["options"], config.what_is_learned
    differing = [
        f"{name}={there.get(name)} there, {here.get(name)} here"
        for name in sorted(there.keys() | here.keys())
        if there.get(name) != here.get(name)
    ]
    if differing:
        raise UserError(
            f"{path}: was made with other options ({'; '.join(differing)}); choose another "
            "run_root or condition, or the same options"
        )
    if saved["update"] > config.updates:
        raise UserError(f"{path}: is at update {saved['update']}, past updates={config.updates}")
    return saved


def write_description(config: Config) -> None:
    """Writes `config.yaml` and `run.json`: what is run, how and with what.

    Raises:
        UserError: the folder cannot be written.
    """
    split = levels.split(config.environment.split)
    chance = {kind: levels.chance(getattr(split, kind), **config.level_options) for kind in KINDS}
    description = {
        "experiment": config.experiment,
        "condition": config.condition,
        "seed": config.seed,
        "split": config.environment.split,
        "command": shlex.join(["python", "-m", "zipf.train", *sys.argv[1:]]),
        "commit": _commit(),
        "version": zipf.__version__,
        "torch": torch.__version__,
        "device": _device_name(config.torch_device),
        "precision": config.precision,
        "window": config.schedule.window,
        "num_updates": config.updates,
        "started": time.strftime("%Y-%m-%dT%H:%M:%S%z"),
        "chance": chance,
        "environment": config.level_options,
        "paper": config.environment.split if config.is_released_benchmark else None,
    }
    try:
        config.folder.mkdir(parents=True, exist_ok=True)
        (config.folder / "config.yaml").write_text(OmegaConf.to_yaml(config.model_dump()))
        (config.folder / "run.json").write_text(json.dumps(description, indent=2) + "\n")
    except OSError as error:
        raise UserError(f"{config.folder}: cannot be written: {error.strerror}") from None


class Seconds:
    """Where the time goes."""

    def __init__(self) -> None:
        parts = ("environment", "inference", "learning", "evaluation")
        self.spent = dict.fromkeys(parts, 0.0)

    @property
    def total(self) -> float:
        return sum(self.spent.values())

    def take(self, measured: dict[str, float]) -> None:
        """Moves what a collector measured over here."""
        for part, spent in measured.items():
            self.spent[part] += spent
            measured[part] = 0.0

    def __call__(self, part: str) -> Seconds:
        self._part = part
        return self

    def __enter__(self) -> None:
        self._start = time.perf_counter()

    def __exit__(self, *_: object) -> None:
        self.spent[self._part] += time.perf_counter() - self._start


class StopSignals:
    """Ctrl-C and SIGTERM stop the loop after the update in progress; a second one at once."""

    def __init__(self, display: Display):
        self.display = display
        self.requested: int = 0

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
        self.display.console.print("stopping after this update; the checkpoint is being kept")


def keep_memory() -> None:
    """Tells glibc to keep freed memory: returning activations to the kernel after every update
    costs a fifth to a third of a CPU's learning speed."""
    if platform.libc_ver()[0] == "glibc":
        trim_threshold, top_pad, mmap_threshold = -1, -2, -3
        libc = ctypes.CDLL(None)
        libc.mallopt(mmap_threshold, 2**30)
        libc.mallopt(trim_threshold, 2**31 - 1)
        libc.mallopt(top_pad, 2**26)


def _commit() -> str | None:
    """The commit of the checkout that runs, marked where it was changed; None for a wheel."""
    here = Path(zipf.__file__).parent
    git = ["git", "-C", str(here)]
    try:
        tracked = subprocess.run(
            [*git, "ls-files", "--error-unmatch", "train.py"], capture_output=True
        )
        if tracked.returncode:
            return None
        head = subprocess.run([*git, "rev-parse", "HEAD"], capture_output=True, text=True)
        changes = subprocess.run(
            [*git, "status", "--porcelain", "--", ".", "../configs"], capture_output=True, text=True
        )
    except OSError:
        return None
    return head.stdout.strip() + ("+changes" if changes.stdout.strip() else "")


def _device_name(device: str) -> str:
    if device.startswith("cuda"):
        return torch.cuda.get_device_name(device)
    return f"cpu, {torch.get_num_threads()} threads"
