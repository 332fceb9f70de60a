"""Processes that step envs: how they fail, and that none of them is left behind."""

import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest
from gymnasium.error import ResetNeeded
from test_slices import LIFT, SMALL

from zipf import envs
from zipf.envs import family
from zipf.envs.processes import Processes
from zipf.envs.testing.steps import are_equal

pytestmark = pytest.mark.slow

# Interrupts are ignored by what a script starts in the background, and by all that this starts.
SCRIPT = f"""
import signal
from zipf import envs
signal.signal(signal.SIGINT, signal.default_int_handler)
env = envs.make_vec({LIFT!r}, 4, processes=2, image_size=(12, 16))
env.reset(seed=0)
print(*(one.pid for one in env._processes), flush=True)
"""


@pytest.fixture
def env() -> Iterator[Processes]:
    made = envs.make_vec(LIFT, 4, processes=2, **SMALL[LIFT])
    assert isinstance(made, Processes)
    made.reset(seed=0)
    yield made
    made.close()
    assert not living(pids(made))


def pids(env: Processes) -> list[int]:
    return [one.pid for one in env._processes]


def living(processes: list[int], patience: float = 0.0) -> list[int]:
    """Those of these that have not ended within so many seconds."""
    end = time.monotonic() + patience
    while True:
        left = [pid for pid in processes if os.path.exists(f"/proc/{pid}/exe")]
        if not left or time.monotonic() > end:
            return left
        time.sleep(0.05)


def actions(env: Processes) -> np.ndarray[Any, Any]:
    return np.arange(env.num_envs)


def test_a_process_that_is_killed_is_one_clear_error(env: Processes) -> None:
    os.kill(pids(env)[1], signal.SIGKILL)
    message = "processes=2: the process of envs 2 to 3 was ended by SIGKILL"
    with pytest.raises(envs.EngineError, match=message):
        env.step(actions(env))
    assert not living(pids(env))
    with pytest.raises(envs.EngineError, match="processes=2: they have ended"):
        env.reset()


def test_an_error_in_a_process_is_raised_here(env: Processes) -> None:
    everywhere, out = np.ones(4, np.bool_), env.allocate()
    with pytest.raises(ValueError, match=r"actions must be in 0 \.\. 45, got 2 \.\. 99") as found:
        env._step_checked(np.array([0, 1, 2, 99]), everywhere, out, None)
    assert "in a process of the envs:\nTraceback" in found.value.__notes__[0]
    with pytest.raises(ResetNeeded):
        env.step(actions(env))
    whole = envs.make_vec(LIFT, 4, **SMALL[LIFT])
    assert are_equal(env.reset(seed=1), whole.reset(seed=1))
    assert are_equal(env.step(actions(env)), whole.step(actions(env)))


def test_envs_that_cannot_be_made_leave_no_process() -> None:
    before = children()
    for options, message in (
        ({"max_steps": 0}, "max_steps must be at least 1"),
        ({"no_such": 1}, "no_such"),
    ):
        with pytest.raises(ValueError, match=message):
            envs.make_vec(LIFT, 4, processes=2, **options)
    with pytest.raises(ValueError, match="processes=2: a GridworldVectorEnv is stepped by one"):
        envs.make_vec("gridworld/zipf_2", 4, processes=2)
    assert children() == before


def make_lift(num_envs: int, level: str, **options: Any) -> envs.ZipfVectorEnv:
    return envs.make_vec(LIFT, num_envs, **SMALL[LIFT], **options)


def test_families_of_others_are_known_to_processes(monkeypatch: Any) -> None:
    monkeypatch.setattr(family, "_FAMILIES", {**family._FAMILIES})
    make, options = "test_processes:make_lift", {"summary": "", "levels": ("lift",)}
    envs.register(envs.Family(name="of_a_script", make_vec=make, sliceable=True, **options))
    made = envs.make_vec("of_a_script/lift", 4, processes=2)
    whole = envs.make_vec(LIFT, 4, **SMALL[LIFT])
    assert are_equal(made.reset(seed=0), whole.reset(seed=0))
    made.close()


def test_functions_that_another_process_has_not_are_refused(monkeypatch: Any) -> None:
    monkeypatch.setattr(make_lift, "__module__", "__main__")
    monkeypatch.setattr(sys.modules["__main__"], "make_lift", make_lift, raising=False)
    with pytest.raises(ValueError, match=r"not to be had in another process: .*make_lift"):
        envs.make_vec(make_lift, 4, processes=2)


def children() -> list[str]:
    with open(f"/proc/self/task/{os.getpid()}/children") as file:
        return file.read().split()


def test_a_batch_that_nobody_has_any_more_leaves_no_process(env: Processes) -> None:
    other = envs.make_vec(LIFT, 4, processes=2, **SMALL[LIFT])
    assert isinstance(other, Processes)
    processes = pids(other)
    assert living(processes) == processes
    del other
    assert not living(processes)


@pytest.mark.parametrize("how", ["exit", "error", "kill", "interrupt"])
def test_processes_end_with_the_one_that_has_the_batch(how: str) -> None:
    last = {"exit": "", "error": "raise RuntimeError('stop here')"}
    program = SCRIPT + last.get(how, "while True: env.step(env.action_space.sample())")
    with subprocess.Popen(
        [sys.executable, "-c", program],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    ) as parent:
        assert parent.stdout is not None
        processes = [int(pid) for pid in parent.stdout.readline().split()]
        assert len(processes) == 2
        if how == "kill":
            parent.kill()
        elif how == "interrupt":
            os.killpg(parent.pid, signal.SIGINT)
        try:
            code = parent.wait(10)
        finally:
            parent.kill()
        expected = {"exit": 0, "error": 1, "kill": -signal.SIGKILL, "interrupt": -signal.SIGINT}
        assert code == expected[how], parent.stderr
        assert not living(processes, 10)
