"""`hydra/launcher=ray`: the jobs of a sweep as tasks of Ray, on this machine or on a cluster.

The published plugin, hydra-ray-launcher 1.2.2, needs cloudpickle below 3 and parts for AWS.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from importlib.util import find_spec
from typing import Any

from hydra.core.hydra_config import HydraConfig
from hydra.core.singleton import Singleton
from hydra.core.utils import JobReturn, JobStatus, run_job, setup_globals
from hydra.plugins.launcher import Launcher
from hydra.types import HydraContext, TaskFunction
from omegaconf import DictConfig, open_dict

from zipf.errors import UserError


class RayLauncher(Launcher):
    """A task of Ray for each job. A job whose worker was killed has failed; the others go on.

    Args:
        address: of the cluster, as `ray.init` takes it; `local` starts Ray on this machine.
        num_cpus: CPU cores that a job is given.
        num_gpus: GPUs that a job is given; it sees no others.
        init: further arguments of `ray.init`.

    Raises:
        UserError: Ray is not installed.
    """

    def __init__(self, address: str, num_cpus: float, num_gpus: float, init: Mapping[str, Any]):
        if find_spec("ray") is None:
            raise UserError(
                'hydra/launcher=ray: Ray is not installed: pip install ".[ray]" in a clone of zipf'
            )
        self.address = address
        self.num_cpus = num_cpus
        self.num_gpus = num_gpus
        self.init = init

    def setup(
        self, *, hydra_context: HydraContext, task_function: TaskFunction, config: DictConfig
    ) -> None:
        """Takes what every job needs."""
        self.hydra_context = hydra_context
        self.task_function = task_function
        self.config = config

    def launch(
        self, job_overrides: Sequence[Sequence[str]], initial_job_idx: int
    ) -> Sequence[JobReturn]:
        """Runs all jobs and waits for their ends.

        Raises:
            UserError: Ray cannot be started or joined.
        """
        import ray  # takes a second

        try:
            ray.init(address=self.address, **self.init)
        except (ConnectionError, ValueError, RuntimeError, TypeError) as error:
            raise UserError(f"hydra.launcher.address={self.address}: {error}") from None
        try:
            task = ray.remote(_run_job).options(
                num_cpus=self.num_cpus, num_gpus=self.num_gpus, max_retries=0
            )
            what = ray.put((self.hydra_context, self.config, self.task_function))
            state = ray.put(Singleton.get_state())
            waiting = [
                task.remote(initial_job_idx + i, list(overrides), what, state)
                for i, overrides in enumerate(job_overrides)
            ]
            return [_result(ray, one) for one in waiting]
        finally:
            ray.shutdown()


def _result(ray: Any, task: Any) -> JobReturn:
    try:
        return ray.get(task)
    except ray.exceptions.RayError as error:
        lines = str(error).strip().splitlines() or [type(error).__name__]
        why = lines[0]  # the process of a task has gone
        if isinstance(error, ray.exceptions.RayTaskError):  # a traceback, whose end says why
            cause = error.cause
            why = lines[-1] if cause is None else f"{type(cause).__name__}: {cause}"
        failed = JobReturn()
        failed.status = JobStatus.FAILED
        failed.return_value = UserError(why)
        return failed


def _run_job(index: int, overrides: list[str], what: Any, state: Any) -> JobReturn:
    hydra_context, config, task_function = what
    setup_globals()
    Singleton.set_state(state)
    job = hydra_context.config_loader.load_sweep_config(config, overrides)
    with open_dict(job):
        job.hydra.job.id = job.hydra.job.num = index
    HydraConfig.instance().set_config(job)
    return run_job(
        hydra_context=hydra_context,
        config=job,
        task_function=task_function,
        job_dir_key="hydra.sweep.dir",
        job_subdir_key="hydra.sweep.subdir",
    )
