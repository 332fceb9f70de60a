"""What the tests share: commands as users type them, runs compared, unrolls drawn at random."""

import contextlib
import importlib
import io
import os
import shutil
import subprocess
import sys
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
import torch
from tensordict import TensorDict

from zipf.agents import image_networks
from zipf.agents.unroll import Unroll
from zipf.experiments.building import checkpoint, loading
from zipf.experiments.training import runner
from zipf.registry import registries

PACKAGE = Path(__file__).parent.parent


def slow_but(values: Iterable[Any], *quick: Any) -> list[Any]:
    """The parameters of a test: these stay in the quick tier, all others are marked `slow`."""
    values = list(values)
    assert all(one in values for one in quick), (quick, values)
    slow = pytest.mark.slow
    return [
        one
        if one in quick
        else pytest.param(*one, marks=slow)
        if isinstance(one, tuple)
        else pytest.param(one, marks=slow)
        for one in values
    ]


@contextlib.contextmanager
def naming(one: object) -> Iterator[None]:
    """What fails within tells which element of a list it is about."""
    try:
        yield
    except (Exception, pytest.fail.Exception) as error:
        error.add_note(f"this is about {one}")
        raise


ANNOUNCED = (
    "zipf: code is compiled where it is first used: up to a minute, and kept for the next time\n"
)


@pytest.fixture
def all_patches(monkeypatch: pytest.MonkeyPatch) -> None:
    """Networks embed every patch of an image, as they do on a device, for what is recorded here in
    the place of a graph."""
    monkeypatch.setattr(image_networks, "distinct_patches", lambda image, patch: None)


@pytest.fixture(autouse=True, scope="session")
def _one_thread() -> None:
    """Sums are rounded alike on every machine, and parallel tests do not wait for each other."""
    torch.set_num_threads(1)


TINY = [
    "experiment=demo",
    "device=cpu",
    "collector.num_envs=6",
    "collector.unroll_length=5",
    "evaluation.every=4",
    "evaluation.episodes=8",
    "schedule.log_every=1",
    "schedule.checkpoint_every=5",
    "network.size=16",
    "memory.size=16",
    "memory=lstm",
    "exploration=count",
    "environment.max_steps=9",
]


def command(*arguments: str) -> list[str]:
    return [sys.executable, "-m", "zipf.train", *arguments]


def run(
    *arguments: str, module: str = "zipf.train", folder: Path | None = None
) -> subprocess.CompletedProcess[str]:
    """A command of the package, in a folder of one's own."""
    return subprocess.run(
        [sys.executable, "-m", module, *arguments],
        cwd=folder,
        env={**os.environ, "PYTHONPATH": str(PACKAGE)},
        capture_output=True,
        text=True,
        timeout=300,
    )


@pytest.fixture
def own_registries(monkeypatch):
    """What code registers is forgotten after the test."""
    for registry in registries().values():
        for name in ("_options", "_builds"):
            monkeypatch.setattr(registry, name, dict(getattr(registry, name)))


def call(
    *arguments: str, module: str = "zipf.train", folder: Path | None = None
) -> subprocess.CompletedProcess[str]:
    """The same in this process, which takes a tenth of the time: it has imported everything."""
    out, err = io.StringIO(), io.StringIO()
    with (
        pytest.MonkeyPatch.context() as patch,
        contextlib.redirect_stdout(out),
        contextlib.redirect_stderr(err),
    ):
        patch.setattr(sys, "argv", [module, *arguments])
        patch.syspath_prepend(str(folder or "."))
        patch.chdir(folder or ".")
        try:
            code = importlib.import_module(module).main()
        except SystemExit as ended:
            code = ended.code
    return subprocess.CompletedProcess(arguments, code or 0, out.getvalue(), err.getvalue())


@pytest.fixture(scope="session")
def trained_once(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The root of a finished run of two updates, for tests that only read it."""
    root = tmp_path_factory.mktemp("trained")
    assert runner.train(loading.load([*TINY, "updates=2", f"run_root={root}"])) == 0
    return root


@pytest.fixture
def trained(trained_once: Path, tmp_path: Path) -> list[str]:
    """The options of a copy of that run, for tests that go on with it or change its files."""
    shutil.copytree(trained_once, tmp_path, dirs_exist_ok=True)
    return [*TINY, "updates=2", f"run_root={tmp_path}"]


def assert_equal(one, other, where=""):
    assert type(one) is type(other), where
    if isinstance(one, dict):
        assert one.keys() == other.keys(), where
        for key in one:
            assert_equal(one[key], other[key], f"{where}.{key}")
    elif isinstance(one, list | tuple):
        assert len(one) == len(other), where
        for i, (a, b) in enumerate(zip(one, other, strict=True)):
            assert_equal(a, b, f"{where}[{i}]")
    elif isinstance(one, torch.Tensor):
        assert torch.equal(one, other), where
    elif isinstance(one, np.ndarray):
        np.testing.assert_array_equal(one, other, where, strict=True)
    else:
        assert one == other, where


def contents(folder: Path) -> dict:
    """Of every file below a folder: what it holds, and when it was written."""
    files = [path for path in folder.rglob("*") if path.is_file()]
    return {path: (path.read_bytes(), path.stat().st_mtime_ns) for path in files}


def learned(folder: Path) -> dict:
    """A checkpoint without the times, which also change the lengths of tables."""
    state = checkpoint.load(folder / "checkpoint.pt")
    del state["clock"], state["tables"]
    return state


TIMED = ("time_", "seconds", "frames_per")


def untimed(path: Path) -> pd.DataFrame:
    """A table of results without the times in it."""
    table = pd.read_csv(path)
    if "metric" in table:
        table = table[~table["metric"].str.startswith(TIMED)].reset_index(drop=True)
    return table.drop(columns=[name for name in table.columns if name.startswith(TIMED)])


def metrics_of(folder: Path) -> pd.DataFrame:
    """The metrics of a run, a column each and a row for each update that was logged."""
    rows = pd.read_csv(folder / "metrics.csv")
    when = ["update", "frames", "seconds"]
    table = rows.pivot(index=when, columns="metric", values="value")
    return table[rows["metric"].unique()].reset_index()


def random_unroll(steps: int, batch: int, actions: int, seed: int = 0) -> Unroll:
    """Numbers drawn at random, with episodes that end in any row; memory of an LSTM of 16."""
    rng = np.random.default_rng(seed)
    shape = (steps + 1, batch)

    def floats(*tail):
        return torch.tensor(rng.normal(size=(*shape, *tail)), dtype=torch.float32)

    ended = torch.tensor(rng.random(shape) < 0.4)
    cut = torch.tensor(rng.random(shape) < 0.5)
    images = rng.integers(256, size=(*shape, 9, 9, 3))
    fields = TensorDict(
        {
            "previous_action": torch.tensor(rng.integers(actions, size=shape)),
            "previous_reward": floats(),
            "is_first": torch.cat([torch.zeros(1, batch, dtype=torch.bool), ended[:-1]]),
            "action": torch.tensor(rng.integers(actions, size=shape)),
            "reward": floats(),
            "bonus": floats().abs(),
            "terminated": ended & ~cut,
            "truncated": ended & cut,
            "truncation_value": floats(),
            "logits": floats(actions),
            "observation": TensorDict(
                {"image": torch.tensor(images, dtype=torch.uint8)}, batch_size=shape
            ),
        },
        batch_size=shape,
    )
    memory = {part: floats(4)[0].repeat(1, 4) for part in ("hidden", "cell")}
    return Unroll(fields, memory)
