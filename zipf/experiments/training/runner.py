"""Training: the loop of collecting, learning, logging, evaluating and saving."""

from __future__ import annotations

import os
import shlex
import signal
import sys
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from zipf import envs
from zipf.agents.capture import CaptureFailed
from zipf.agents.encoders import Encoder
from zipf.agents.learner import Learner
from zipf.agents.unroll import Unroll
from zipf.envs.tensor import TensorEnv
from zipf.envs.vector import ZipfVectorEnv
from zipf.errors import UserError
from zipf.experiments.building import checkpoint, run_folder
from zipf.experiments.building.device_envs import (
    captures,
    compiles,
    not_captured,
    on_device,
    only_on_the_host,
)
from zipf.experiments.building.factory import build_agent
from zipf.experiments.building.out_of_ram import enough_ram
from zipf.experiments.building.seeds import derive_seed
from zipf.experiments.evaluation.trained import evaluate_agent
from zipf.experiments.hooks.visits import Visits
from zipf.experiments.loggers import End, Start
from zipf.experiments.options.schema import Config, has_bfloat16
from zipf.experiments.records.result_table import check_tables
from zipf.experiments.training import pretrained
from zipf.experiments.training.allocator import keep_freed_ram
from zipf.experiments.training.clock import Clock, DeviceClock
from zipf.experiments.training.outputs import Outputs
from zipf.experiments.training.rollouts import SynchronousRollouts, TensorRollouts
from zipf.experiments.training.runtime import LearnerLost, OnlyLearner, Runtime
from zipf.experiments.training.signals import Stopped, StopSignals, sweep_has_ended


def train(
    config: Config, runtime: Runtime | None = None, words: Sequence[str] | None = None
) -> int:
    """Trains until `config.updates`, a signal or a logger that asks to stop, or the first update
    after `schedule.stop_after` seconds; the same command resumes.

    A run that is finished is left as it is. `schedule.stop_after` gives up no evaluation, and each
    call makes at least one update, so that repeated calls finish.

    Args:
        runtime: the processes of the run (`zipf.experiments.cluster.runtime_of`); None: this one.
        words: the arguments of the command, which describe the run in its folder; None: those of
            this process.

    Returns the number of the signal that stopped it, 0 for none.

    Raises:
        UserError: the run cannot begin, go on or be written; the last checkpoint is kept.
    """
    if sweep_has_ended():
        return signal.SIGTERM
    began = time.monotonic()
    keep_freed_ram()
    runtime = runtime or Runtime(config)
    schedule = config.schedule
    with ExitStack() as stack:
        stack.enter_context(_as_user_errors(config))
        before = torch.are_deterministic_algorithms_enabled()
        stack.callback(torch.use_deterministic_algorithms, before)
        _choose_kernels(config)
        if config.torch_device.startswith("cuda"):  # for calls that name no device
            stack.enter_context(torch.cuda.device(config.torch_device))
        learner = stack.enter_context(runtime.learner())
        if learner.is_first:
            run_folder.check_resumed(config)  # before a folder is made
            stack.enter_context(run_folder.lock(config.folder))
        run = Run(config, runtime, learner, sys.argv[1:] if words is None else words)
        if run.is_finished:
            run.close()
            run.outputs.say(f"{run.name}: is finished at update {run.update}, in {run.folder}")
            return 0
        stop = run.stop
        try:
            with stop, run:  # the end of a run is not cut short, either
                if run.evaluation_is_due:
                    run.evaluate()
                if run.is_new or run.has_moved:  # a replay's files are of the envs before
                    run.save()
                over = int(bool(run.outputs.reason))
                while run.update < config.updates and not run.may_stop(stop.requested or over):
                    try:
                        unroll, metrics = run.step()
                    except Stopped:  # while it waited for actors
                        break
                    run.outputs.display.advance(run.update)
                    if run.update % schedule.log_every == 0:
                        run.log(unroll, metrics)
                    if run.evaluation_is_due:
                        run.evaluate()
                    if run.update % schedule.checkpoint_every == 0:
                        run.save()
                    late = schedule.stop_after is not None and (
                        time.monotonic() - began >= schedule.stop_after
                    )
                    over = int(late or bool(run.outputs.reason))
                run.save()
                if run.closing_evaluation_is_due:
                    run.evaluate()
            return 0 if run.is_finished else learner.agree(stop.requested)
        except LearnerLost:
            if stop.requested:  # torchrun ends all
                return stop.requested
            raise


@contextmanager
def _as_user_errors(config: Config) -> Iterator[None]:
    collector = config.collector
    smaller = (
        f"smaller collector.num_envs={collector.num_envs} or "
        f"collector.unroll_length={collector.unroll_length} need less"
    )
    with enough_ram(smaller):
        try:
            yield
        except CaptureFailed as error:
            raise UserError(str(error)) from None
        except RuntimeError as error:
            first = next(iter(str(error).strip().splitlines()), "")
            if compiles(config) and isinstance(error, torch._dynamo.exc.TorchDynamoException):
                option = f"compile={str(config.compile).lower()}"
                raise UserError(f"{option}: {first}; choose compile=false") from None
            if config.deterministic and "not have a deterministic implementation" in first:
                raise UserError(f"deterministic=true: {first}; choose false") from None
            raise


def _choose_kernels(config: Config) -> None:
    """On CUDA: with `deterministic=true` kernels that give the same bits every time."""
    if not config.torch_device.startswith("cuda"):
        return
    if config.deterministic:
        name, values = "CUBLAS_WORKSPACE_CONFIG", (":4096:8", ":16:8")  # PyTorch's documentation
        if not torch.cuda.is_initialized():  # cuBLAS reads it when it starts
            os.environ.setdefault(name, values[0])
        if os.environ.get(name) not in values:
            raise UserError(
                f"deterministic=true: the environment variable {name} is {os.environ.get(name)}; "
                f"should be {' or '.join(values)} before CUDA starts"
            )
        torch.backends.cudnn.benchmark = False
    torch.use_deterministic_algorithms(config.deterministic)


class Run:
    """One training run: its parts, and how many updates were made.

    Making it reads its folder and writes nothing. As a context manager it writes what describes the
    run, shows the display, and closes everything in the end. Of several learners the first alone
    reads, writes, shows and evaluates; all of them call the same methods in the same order.

    Attributes:
        update: updates made.
        evaluated: the update of the last evaluation; -1 for none.
        stop: says whether the run is to stop.
        is_new: whether it was started rather than resumed from a checkpoint.
        has_moved: whether its envs were stepped on the host before and now on a device, or the
            other way round.

    Raises (here and in the methods):
        UserError: the run cannot begin, go on or be written.
    """

    def __init__(
        self,
        config: Config,
        runtime: Runtime | None = None,
        learner: OnlyLearner | None = None,
        words: Sequence[str] = (),
    ):
        self.config = config
        self._words = words
        self.learner = learner or OnlyLearner()
        runtime = runtime or Runtime(config)
        self.folder = config.folder
        self.device = config.torch_device
        self.env: ZipfVectorEnv | TensorEnv
        if on_device(config):
            self.env = envs.make_tensor(
                config.split, config.num_envs, config.torch_device, **config.level_options
            )
        else:
            self.env = envs.make_train(
                config.split,
                config.num_envs,
                threads=config.env_threads,
                processes=config.processes,
                **config.level_options,
            )
        self.agent = build_agent(config, self.env)
        try:
            self._notes = self.agent.begin_learning(config.folder, config.schedule.checkpoint_every)
        except ValueError as error:
            raise UserError(str(error)) from None
        saved = self.learner.receive(
            run_folder.find_checkpoint(config) if self.learner.is_first else None
        )
        self.is_new = saved is None
        self.has_moved = False
        self._pretrained = None
        if self.is_new:
            self._pretrained = pretrained.begin(config, self.agent, self.learner)
        self.rollouts = runtime.rollouts(self.env, self.agent, self.learner.stream)
        if captures(config):
            assert isinstance(self.agent, Learner)
            self.agent.capture()
            if isinstance(self.rollouts, TensorRollouts):
                self.rollouts.collector.capture()
        self.frames_per_update = config.frames_per_update
        self.clock = Clock()
        self.update = 0
        self.evaluated = -1
        self._saved: int | None = None  # the update of the checkpoint, where this process wrote it
        self._lengths: dict[str, int] | None = None
        torch.manual_seed(self.learner.seed(config.seed))
        if saved:
            self._load(saved)
        if self.is_finished and self.learner.is_first:
            assert self._lengths is not None
            run_folder.check_description(config, self._ranks())
            check_tables(self.folder, self.update, self._lengths)
        self.name = config.run_name
        self.outputs = Outputs(
            config,
            self.update,
            is_first=self.learner.is_first,
            takes_turns=type(self.rollouts) in (SynchronousRollouts, TensorRollouts),
        )
        self.stop = StopSignals(self.outputs.display.warn)

    def __enter__(self) -> Run:
        try:
            self._begin()
        except BaseException:
            self.close()
            raise
        return self

    def _begin(self) -> None:
        tell = self.outputs.tell
        if self.learner.is_first:
            self._begin_files()
        self._logged = self.clock.training, self.update
        state = "a new run" if self.is_new else f"resumes at update {self.update}"
        precision = self.config.precision
        where = f"on {self.device} in {precision}"
        self.outputs.say(f"{self.name}: {state}, {where}, in {self.folder}")
        self.outputs.write(f"{self.name}: {state}, {where}")
        encoder = getattr(getattr(self.agent, "network", None), "encoder", None)
        if isinstance(encoder, Encoder):
            tell(encoder.describe(self.env.single_observation_space))
        if self.device.startswith("cuda"):
            tell(self._on_cuda())
        if precision == "bfloat16" and not has_bfloat16(self.device):
            self.outputs.warn(
                "precision=bfloat16: this device has no instructions for it and takes several "
                "times as long as with precision=float32"
            )
        if self.learner.is_first and (line := run_folder.other_images(self.folder)):
            self.outputs.warn(line)
        if self._pretrained:
            tell(pretrained.message(self._pretrained))
        for note in self._notes:
            tell(note)
        self.rollouts.open(tell, lambda: bool(self.stop.requested))
        self.outputs.start(
            Start(
                self.folder,
                self.name,
                self.is_new,
                self.update,
                self.update * self.frames_per_update,
                self.config.model_dump(),
                tuple(self.config.split.kinds),
            )
        )

    def _on_cuda(self) -> str:
        """Where envs are stepped, whether functions are captured, and why not."""
        host, eager = list(only_on_the_host(self.config)), list(not_captured(self.config))
        where = "on the device"
        if isinstance(self.env, ZipfVectorEnv):
            where = f"on the host ({', '.join(host) or 'collector.envs=host'})"
        how = f"not captured ({', '.join(eager) or 'capture=false'})"
        if captures(self.config):
            how = "captured as CUDA graphs"
        compiled = "; image encoder compiled" if compiles(self.config) else ""
        return f"envs: stepped {where}; {how}{compiled}"

    def _begin_files(self) -> None:
        ranks = self._ranks()
        if not self.is_new:
            run_folder.check_description(self.config, ranks)
        self.outputs.open(self.update, self._lengths)
        resumed_at = None if self.is_new else self.update
        run_folder.write_description(
            self.config,
            ranks,
            self._words,
            resumed_at=resumed_at,
            pretrained=self._pretrained,
        )

    def _ranks(self) -> dict[str, int]:
        return envs.ranks_of(self.config.split, **self.config.level_options)

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        self.outputs.display.stop()
        if kind is None:
            report = ["python", "-m", "zipf.report", str(self.folder.parent.parent)]
            if self.update < self.config.schedule.window[0]:
                report.append("window=last")
            why = f" ({self.outputs.reason})" if self.outputs.reason else ""
            stopped = f"stopped at update {self.update}{why}; the same command resumes"
            self.outputs.say(f"finished; {shlex.join(report)}" if self.is_finished else stopped)
            self.outputs.write(f"finished at update {self.update}" if self.is_finished else stopped)
        self.outputs.end(End(self.update, kind is None and self.is_finished, self._film))
        self.close()

    def _film(self) -> Path | None:
        from zipf.experiments.playing.videos import film  # here: it imports what draws

        return film(self.folder, self.config.plugins)

    @property
    def is_finished(self) -> bool:
        """Whether there is nothing left to do."""
        return self.evaluated == self.update == self.config.updates

    def close(self) -> None:
        """Ends the other threads and processes, if there are any, and closes the envs."""
        self.rollouts.close()
        if isinstance(self.env, ZipfVectorEnv):
            self.env.close()

    @property
    def _device_clock(self) -> DeviceClock | None:
        return self.rollouts.clock if isinstance(self.rollouts, TensorRollouts) else None

    def may_stop(self, requested: int) -> int:
        """The number of the signal that asks a learner to stop; 0 while there is none, or updates
        of an unroll are left."""
        return self.learner.agree(requested) if self.rollouts.is_between_unrolls else 0

    def step(self) -> tuple[Unroll, Mapping[str, float | Tensor]]:
        """Collects an unroll and makes one update with it; returns both the unroll and metrics.

        The unroll is overwritten by the next step.
        """
        with self.clock.train():
            unroll, metrics = self.rollouts.step(self._learn)
            self.update += 1
            if self._device_clock and self.update % self.config.schedule.log_every == 0:
                self.clock.move(self._device_clock.read())
        return unroll, metrics

    def _learn(self, unroll: Unroll) -> Mapping[str, float | Tensor]:
        clock = self._device_clock or self.clock
        with self._errors_of_learning(f"at update {self.update + 1}"), clock.part("learning"):
            if self.config.learning_rate_decay:
                assert isinstance(self.agent, Learner)
                self.agent.scale_learning_rates(self.config.learning_rate_factor(self.update))
            metrics = self.agent.update(unroll)
            if self.device.startswith("cuda") and not self._device_clock:
                # To measure the time, and because the unroll is overwritten by the next. A wait for
                # the whole device would fail where another thread records a graph.
                torch.cuda.current_stream(self.device).synchronize()
            return metrics

    def _check_finite(self) -> None:
        """Ends the run where captured updates have diverged, which alone do not end it at once."""
        if isinstance(self.agent, Learner):
            with self._errors_of_learning(f"by update {self.update}"):
                self.agent.check_finite()

    @contextmanager
    def _errors_of_learning(self, when: str) -> Iterator[None]:
        try:
            yield
        except FloatingPointError as error:
            raise UserError(
                f"{self.folder}: learning diverged {when} ({error}); the checkpoint before it is "
                "kept; a smaller agent.learning_rate may help, in a run of another name"
            ) from None
        except ConnectionError as error:
            raise LearnerLost(str(error)) from None
        except OSError as error:  # no space for files that the agent keeps
            raise UserError(str(error)) from None

    def log(self, unroll: Unroll, metrics: Mapping[str, float | Tensor]) -> None:
        """Writes rows of metrics."""
        self._check_finite()
        self.clock.move(self.rollouts.seconds)
        then, update = self._logged
        self._logged = self.clock.training, self.update
        frames = (self.update - update) * self.frames_per_update
        found = {
            "frames_per_second": frames / (self.clock.training - then),
            **{f"time_{part}": seconds for part, seconds in self.clock.parts.items()},
            **self._learning_rate_factor(),
            **self._staleness(),
            **self.learner.mean(
                {
                    **self.rollouts.metrics(),
                    "exploration_bonus": float(unroll.steps["bonus"][:-1].mean()),
                    **{name: float(metric) for name, metric in metrics.items()},
                }
            ),
        }
        self.outputs.metrics(self._when(), found)

    def _when(self) -> dict[str, float]:
        """What rows of tables begin with."""
        frames = self.update * self.frames_per_update
        return {"update": self.update, "frames": frames, "seconds": self.clock.total}

    def _learning_rate_factor(self) -> dict[str, float]:
        if self.config.learning_rate_decay is None:
            return {}
        return {"learning_rate_factor": self.config.learning_rate_factor(self.update - 1)}

    def _staleness(self) -> dict[str, float]:
        """How many updates older than the newest the weights are, in the mean over an unroll's
        updates, that played it; where updates learn from parts of it."""
        parts = self.config.updates_per_unroll
        return {} if parts == 1 else {"staleness": self.config.lag * parts + (parts - 1) / 2}

    @property
    def evaluation_is_due(self) -> bool:
        """Whether the agent is to be scored after this update and has not been."""
        return self.evaluated < self.update and self.update % self.config.evaluation.every == 0

    @property
    def closing_evaluation_is_due(self) -> bool:
        """Whether the agent is to be scored because the run ends here. That comes after the last
        checkpoint: a run that goes on with more updates drops the rows, and equals one that had
        that many from the start."""
        return self.evaluated < self.update == self.config.updates

    def evaluate(self) -> None:
        """Scores the agent and writes the rows; training's random draws stay the same.

        Where the run is to stop the evaluation is given up. It is due again when the run resumes.
        """
        visits = self.learner.total(self.rollouts.visits)
        given_up = False
        if self.learner.is_first:
            try:
                self._evaluate(visits)
            except Stopped:
                given_up = True
        if not self.learner.agree(given_up):
            self.evaluated = self.update

    def _watch_evaluation(self, ended: int, episodes: int) -> None:
        self.outputs.display.show_evaluation(ended, episodes)
        if self.stop.requested:
            raise Stopped

    def _evaluate(self, visits: Visits) -> None:
        with self.clock.part("evaluation"):
            results = evaluate_agent(
                self.config,
                self.agent,
                episodes=self.config.evaluation.episodes,
                num_envs=self.config.evaluation.num_envs,
                seed=derive_seed(self.config.seed, "evaluation", self.update),
                watch=self._watch_evaluation,
            )
        self.outputs.evaluation(self._when(), results, visits)

    def save(self) -> None:
        """Writes the checkpoint, unless it is there."""
        if self._saved == self.update:
            return
        self._check_finite()
        self.clock.move(self.rollouts.seconds)
        agent = self.agent.state_dict()
        self.learner.check_same("the agent", agent)
        own = self.learner.gather(
            {"source": self.rollouts.state_dict(), "torch_rng": torch.get_rng_state()}
        )
        if self.learner.is_first:
            self._save({"agent": agent, **own})
        self.learner.wait()  # the end of one learner would be that of the first, which still writes
        self._saved = self.update

    def _save(self, learned: dict[str, Any]) -> None:
        state = {
            "options": self.config.what_is_learned,
            "update": self.update,
            "evaluated": self.evaluated,
            "tables": self.outputs.lengths(),
            "clock": self.clock.state_dict(),
            **learned,
        }
        if self.update == self.config.updates and isinstance(self.agent, Learner):
            learned_last = {"update": self.update, "weights": self.agent.weights()}
            checkpoint.save(self.folder / "weights.pt", learned_last)
        checkpoint.save(self.folder / "checkpoint.pt", state)

    def _load(self, saved: dict[str, Any]) -> None:
        with run_folder.fits(self.folder / "checkpoint.pt"):
            self.update = saved["update"]
            self.evaluated = saved["evaluated"]
            self._lengths = saved["tables"]
            self.clock.load_state_dict(saved["clock"])
            was_on_device = "tensor_envs" in saved["source"]
            has_moved = self.has_moved = was_on_device == isinstance(self.env, ZipfVectorEnv)
            if has_moved and "replay" in saved["agent"]:  # codes there, images here
                saved["agent"] |= {"replay": {}, "prefix": {}}
                saved["without_replay"] = True
            try:
                self.agent.load_state_dict(saved["agent"])
            except OSError as error:  # files that the checkpoint refers to
                raise UserError(str(error)) from None
            if saved.get("without_replay"):  # scripts/pack_runs.py
                self._notes.append(
                    "the replay was left behind: a new one is filled before learning goes on, "
                    "which is not bit for bit as it would have been"
                )
            if has_moved and isinstance(self.rollouts, SynchronousRollouts):
                seed = derive_seed(self.config.seed, "training", self.update, *self.learner.stream)
                self.rollouts.collector.begin_episodes(seed)
            self.rollouts.load_state_dict(saved["source"])
            if has_moved:
                where, before = ("host", "device") if was_on_device else ("device", "host")
                self._notes.append(
                    f"envs are stepped on the {where} now, and were on the {before}: new episodes "
                    "begin; weights, optimiser and counts are kept"
                )
            torch.set_rng_state(saved["torch_rng"])
