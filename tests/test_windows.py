"""What is to run on Windows runs without the modules that Windows lacks; the rest says so.

Nothing here runs on Windows itself.
"""

import subprocess
import sys

import pytest

pytestmark = pytest.mark.slow

AS_ON_WINDOWS = """
import ctypes, os, select, signal, sys
import hydra, matplotlib, numba, pymunk, rich.console, tensordict, torch  # know where they are
for module in ("fcntl", "pwd", "resource", "termios", "tty"):
    sys.modules[module] = None
for name in ("SIGHUP", "SIGKILL", "SIGUSR1", "SIGUSR2", "SIGXCPU"):
    delattr(signal, name)
del os.sched_getaffinity
sys.platform = "win32"
"""


def run(program: str, *arguments: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-c", AS_ON_WINDOWS + program, *arguments], capture_output=True, text=True
    )


@pytest.mark.parametrize("split", ["gridworld", "labyrinth_forward"])
def test_policies_are_scored(split: str) -> None:
    program = (
        "from zipf.envs import make_vec, split\n"
        "from zipf.evaluate import score\n"
        f"level = split({split!r}).levels('rare')[0].name\n"
        "make_vec(level, 2).reset(seed=0)\n"
        "print(len(score('generalist', 'gridworld', episodes=2)))"
    )
    done = run(program)
    assert done.returncode == 0, done.stderr
    assert int(done.stdout) >= 3


def test_the_playroom_says_what_it_needs() -> None:
    done = run("import zipf.envs; zipf.envs.make_vec('playroom/lift/lift_shape_zipf3', 2)")
    assert done.stderr.splitlines()[-1].endswith(
        "the playroom needs Linux or macOS: on Windows, run it in WSL"
    )


@pytest.mark.parametrize("mode", [[], ["-m", "seed=0,1"]])
def test_training_says_what_it_needs(mode: list[str]) -> None:
    done = run("from zipf.train import main; main()", "experiment=demo", *mode)
    assert done.returncode == 2
    assert done.stderr == "error: training needs Linux or macOS: on Windows, run it in WSL\n"


@pytest.mark.parametrize("command", ["evaluate", "play", "report"])
def test_the_other_commands_begin(command: str) -> None:
    done = run(f"from zipf.{command} import main; main()", "--help")
    assert done.returncode == 0, done.stderr
