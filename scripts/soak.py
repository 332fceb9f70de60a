"""Kills, damages and malformed command lines by the thousand: is anything lost, or taken silently?

    python scripts/soak.py kills --count 1000
    python scripts/soak.py ray_kills --count 100
    python scripts/soak.py damages --count 1000
    python scripts/soak.py lines --count 1000

`kills` trains every shipped condition, with `collector.lag` 0 and 1, on a few small envs, kills
it by SIGKILL at random times, lets the same command resume until it has finished, and compares
tables and checkpoint with those of a run that was left alone. `ray_kills` does so with
`runtime=ray` on a cluster of this machine, kills learners and actors, and compares the numbers of
updates, frames and evaluations alone: what is learned depends on timing. `damages` changes a random
file of a run's folder at random, then resumes the run, reports on it or evaluates it; a command may
refuse, with lines that begin with "error:", or do exactly what it does with the undamaged folder.
`lines` gives `zipf.train` options with wrong names, choices and values; they may be refused, or be
taken for what they say.

Everything else is printed as it is found and counted: tracebacks, ends by a signal, differences. A
summary comes at the end; the exit code is 1 if anything was found. A trial is a forked process, in
which PyTorch is imported already; `--seed` draws the same trials again, though not the same moments
of kills.
"""

from __future__ import annotations

import argparse
import contextlib
import os
import random
import runpy
import shutil
import signal
import string
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

os.environ["OMP_NUM_THREADS"] = "1"  # a forked process has no other threads

import pandas as pd
import torch
import yaml

from zipf.errors import UserError
from zipf.experiments.building import checkpoint, loading
from zipf.experiments.options import command_line, config_files
from zipf.experiments.records.learned_options import flatten

SMALL = [
    "device=cpu",
    "updates=8",
    "schedule.window=[4,8]",
    "schedule.log_every=1",
    "schedule.checkpoint_every=2",
    "evaluation.every=4",
    "evaluation.episodes=4",
    "evaluation.num_envs=4",
    "collector.num_envs=6",
    "collector.unroll_length=5",
    "environment.max_steps=9",
]
EXPERIMENTS = ("demo", "playroom_lift_compact", "playroom_find_compact")
TIMED = r"^(?:seconds|frames_per_second|time_.*)$"


@dataclass(frozen=True)
class Outcome:
    """How a command ended: its exit code, -9 after SIGKILL, and what it printed."""

    code: int
    output: str

    @property
    def refused(self) -> bool:
        return self.code == 2 and "error:" in self.output and not self.broken

    @property
    def broken(self) -> bool:
        return self.code not in (0, 2) or "Traceback" in self.output


def start(module: str, arguments: list[str], output: Path) -> int:
    """Begins `python -m module arguments` in a forked process; returns its number."""
    sys.stdout.flush()
    sys.stderr.flush()
    child = os.fork()
    if child:
        return child
    code = 1
    try:
        os.setsid()
        with open(output, "wb", buffering=0) as file:
            os.dup2(file.fileno(), 1)
            os.dup2(file.fileno(), 2)
        sys.argv = [module, *arguments]
        try:
            runpy.run_module(module, run_name="__main__", alter_sys=True)
            code = 0
        except SystemExit as end:
            code = end.code if isinstance(end.code, int) else 0 if end.code is None else 1
        except BaseException:
            sys.excepthook(*sys.exc_info())  # type: ignore[arg-type]
        sys.stdout.flush()
        sys.stderr.flush()
    finally:
        os._exit(code)


def finish(child: int, output: Path) -> Outcome:
    _, status = os.waitpid(child, 0)
    return Outcome(os.waitstatus_to_exitcode(status), output.read_text(errors="replace"))


def run(module: str, arguments: list[str], output: Path) -> Outcome:
    return finish(start(module, arguments, output), output)


def found(kind: str, what: str, outcome: Outcome | None = None) -> None:
    """Prints what should not have happened."""
    print(f"{kind}: {what}")
    for line in outcome.output.splitlines()[-15:] if outcome else ():
        print(f"    {line}")
    sys.stdout.flush()


def small_runs(variants: Sequence[list[str]]) -> Iterator[list[str]]:
    """The arguments of a small run of every condition, on the first envs that it can learn, with
    each of the variants that its agent can do with."""
    for condition in command_line.choices("condition"):
        problems = ""
        for experiment in EXPERIMENTS:
            chosen = [f"experiment={experiment}", f"condition={condition}"]
            try:
                loading.load([*chosen, *SMALL])
            except UserError as error:
                problems += f"\n{error}"
                continue
            for variant in variants:
                arguments = [*chosen, *SMALL, *variant]
                try:
                    loading.load(arguments)
                except UserError:
                    continue  # the agent is on-policy
                yield arguments
            break
        else:
            print(f"no small envs for condition={condition}:{problems}")


def state_of(root: Path, arguments: list[str]) -> dict[str, Any]:
    """What a run has learned and measured, without the times it took."""
    folder = loading.load([*arguments, f"run_root={root}"]).folder
    saved = checkpoint.load(folder / "checkpoint.pt")
    del saved["clock"], saved["tables"]
    for path in sorted(folder.glob("*.csv")):
        table = pd.read_csv(path)
        saved[path.name] = table.loc[:, ~table.columns.str.contains(TIMED)].to_csv()
    return saved


def difference(one: Any, other: Any, where: str = "") -> str | None:
    """Where two states differ, or None."""
    if isinstance(one, dict) and isinstance(other, dict):
        if one.keys() != other.keys():
            return f"{where}: other names"
        pairs = [(f"{where}.{name}", one[name], other[name]) for name in one]
    elif isinstance(one, list | tuple) and isinstance(other, list | tuple):
        if len(one) != len(other):
            return f"{where}: other length"
        pairs = [(f"{where}[{i}]", *pair) for i, pair in enumerate(zip(one, other, strict=True))]
    elif isinstance(one, torch.Tensor) and isinstance(other, torch.Tensor):
        same = torch.equal(torch.nan_to_num(one), torch.nan_to_num(other))
        return None if same else f"{where}: other numbers"
    else:
        return None if one == other else f"{where}: {one} and {other}"
    return next((d for name, *pair in pairs if (d := difference(*pair, name))), None)


def shown(arguments: list[str]) -> str:
    """What tells a small run from the others."""
    return " ".join(a for a in arguments if a.startswith(("experiment", "cond", "collector.lag")))


def soak_kills(count: int, draw: random.Random, folder: Path) -> Counter[str]:
    """Kills every small run in turn until there were `count` kills."""
    tally: Counter[str] = Counter()
    output = folder / "output"
    runs = list(small_runs([["collector.lag=0"], ["collector.lag=1"]]))
    for number, arguments in enumerate(runs):
        share = count * (number + 1) // len(runs)
        name = shown(arguments)
        for _ in range(2):  # the first may compile
            shutil.rmtree(folder / "alone", ignore_errors=True)
            begun = time.perf_counter()
            alone = run("zipf.train", [*arguments, f"run_root={folder / 'alone'}"], output)
            took = time.perf_counter() - begun
        if alone.code != 0:
            found("did not train", name, alone)
            tally["did not train"] += 1
            continue
        expected = state_of(folder / "alone", arguments)
        while tally["kills"] < share:
            root = folder / "killed"
            shutil.rmtree(root, ignore_errors=True)
            code = -9
            while code == -9:
                child = start("zipf.train", [*arguments, f"run_root={root}"], output)
                time.sleep(draw.uniform(0, 1.2 * took))
                with contextlib.suppress(ProcessLookupError):  # before setsid, or after its end
                    os.killpg(child, signal.SIGKILL)
                outcome = finish(child, output)
                code = outcome.code
                tally["kills"] += code == -9
            if code != 0:
                found("could not go on", name, outcome)
                tally["could not go on"] += 1
                continue
            tally["runs compared"] += 1
            differs = difference(expected, state_of(root, arguments))
            if differs:
                found("differs", f"{name}: {differs}")
                tally["differs"] += 1
        shutil.rmtree(folder / "alone")
        print(f"{tally['kills']} kills, {tally['runs compared']} runs compared: {name}", flush=True)
    return tally


@contextlib.contextmanager
def cluster(cores: int) -> Iterator[str]:
    """A Ray cluster on this machine; gives its address."""
    program = (
        "import sys; from ray.cluster_utils import Cluster\n"
        f"cluster = Cluster(initialize_head=True, head_node_args={{'num_cpus': {cores}}})\n"
        "print(cluster.address, flush=True); sys.stdin.read(); cluster.shutdown()"
    )
    process = subprocess.Popen(
        [sys.executable, "-c", program],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        text=True,
        env={**os.environ, "RAY_USAGE_STATS_ENABLED": "0"},
    )
    with process:
        assert process.stdout is not None
        yield process.stdout.readline().strip()


def actors() -> list[int]:
    """The numbers of the processes that play."""
    found = []
    for path in Path("/proc").glob("[0-9]*/cmdline"):
        with contextlib.suppress(OSError):
            if path.read_bytes().startswith(b"ray::Collecting"):
                found.append(int(path.parent.name))
    return found


def miscounted(root: Path, arguments: list[str]) -> str | None:
    """What is wrong with the numbers of a finished run of 8 updates."""
    config = loading.load([*arguments, f"run_root={root}"])
    folder, each = config.folder, config.collector.num_envs * config.collector.unroll_length
    metrics = pd.read_csv(folder / "metrics.csv")
    evaluations = pd.read_csv(folder / "evaluations.csv")
    saved = checkpoint.load(folder / "checkpoint.pt")
    counted = {
        "updates of metrics": (metrics["update"].unique().tolist(), list(range(1, 9))),
        "frames of metrics": (metrics["frames"].unique().tolist(), [each * u for u in range(1, 9)]),
        "updates of evaluations": (sorted(set(evaluations["update"])), [0, 4, 8]),
        "frames of evaluations": (sorted(set(evaluations["frames"])), [0, 4 * each, 8 * each]),
        "updates of the checkpoint": ([saved["update"], saved["source"]["version"]], [8, 8]),
    }
    wrong = (f"{n}: {is_} not {should}" for n, (is_, should) in counted.items() if is_ != should)
    return next(wrong, None)


def soak_ray_kills(count: int, draw: random.Random, folder: Path) -> Counter[str]:
    """Kills learners and actors of every small run in turn until there were `count` kills."""
    tally: Counter[str] = Counter()
    output, root = folder / "output", folder / "runs"
    with cluster(cores=2) as address:
        runs = list(small_runs([["runtime=ray", "runtime.actors=2", f"runtime.address={address}"]]))
        for number, arguments in enumerate(runs):
            share = count * (number + 1) // len(runs)
            while tally["learners killed"] + tally["actors killed"] < share:
                shutil.rmtree(root, ignore_errors=True)
                code = -9
                while code == -9:
                    child = start("zipf.train", [*arguments, f"run_root={root}"], output)
                    time.sleep(draw.uniform(0, 20.0))  # ours: about as long as a run takes
                    if draw.random() < 0.5:
                        with contextlib.suppress(ProcessLookupError):
                            os.killpg(child, signal.SIGKILL)
                    elif playing := actors():
                        with contextlib.suppress(ProcessLookupError):
                            os.kill(draw.choice(playing), signal.SIGKILL)
                            tally["actors killed"] += 1
                    outcome = finish(child, output)
                    code = outcome.code
                    tally["learners killed"] += code == -9
                if code != 0:
                    found("could not go on", shown(arguments), outcome)
                    tally["could not go on"] += 1
                    continue
                tally["runs compared"] += 1
                if wrong := miscounted(root, arguments):
                    found("differs", f"{shown(arguments)}: {wrong}")
                    tally["differs"] += 1
            print(f"{dict(tally)}: {shown(arguments)}", flush=True)
    return tally


def damage(path: Path, draw: random.Random) -> str:
    """Damages a file; returns how."""
    content = path.read_bytes()
    at = draw.randrange(len(content) + 1)
    ways: dict[str, Callable[[], bytes | None]] = {
        "deleted": lambda: None,
        "emptied": lambda: b"",
        f"cut at byte {at}": lambda: content[:at],
        f"cut before byte {at}": lambda: content[at:],
        f"16 random bytes at {at}": lambda: content[:at] + draw.randbytes(16) + content[at + 16 :],
        f"one bit of byte {at}": lambda: (
            content[:at] + bytes(b ^ 1 << draw.randrange(8) for b in content[at : at + 1])
            + content[at + 1 :]
        ),
        "random bytes at the end": lambda: content + draw.randbytes(draw.randrange(1, 100)),
        "all twice": lambda: content * 2,
        "one line less": lambda: b"".join(
            draw.sample(lines := content.splitlines(True), max(len(lines) - 1, 0))
        ),
        "a digit changed": lambda: bytes(
            48 + (b - 47) % 10 if 48 <= b <= 57 and i == _digit(content, at) else b
            for i, b in enumerate(content)
        ),
    }  # fmt: skip
    how = draw.choice(sorted(ways))
    changed = ways[how]()
    if changed is None:
        path.unlink()
    else:
        path.write_bytes(changed)
    return how


def _digit(content: bytes, at: int) -> int:
    """The place of the next digit from there."""
    return next((i for i in range(at, len(content)) if 48 <= content[i] <= 57), -1)


def soak_damages(count: int, draw: random.Random, folder: Path) -> Counter[str]:
    """Damages copies of a stopped run's folder; resumes them, reports on them, evaluates them."""
    tally: Counter[str] = Counter()
    output, root = folder / "output", folder / "runs"
    arguments = ["experiment=demo", "condition=impala", *SMALL]
    for updates in (4, 8):
        whole = folder / f"whole{updates}"
        trained = run("zipf.train", [*arguments, f"updates={updates}", f"run_root={whole}"], output)
        assert trained.code == 0, trained.output

    def commands() -> dict[str, Callable[[], tuple[Outcome, Any]]]:
        of_run = loading.load([*arguments, f"run_root={root}"]).folder

        def train() -> tuple[Outcome, Any]:
            outcome = run("zipf.train", [*arguments, f"run_root={root}"], output)
            return outcome, state_of(root, arguments) if outcome.code == 0 else None

        def report() -> tuple[Outcome, Any]:
            outcome = run("zipf.report", [str(root), "window=last"], output)
            table = root / "report" / "report.csv"
            return outcome, table.read_text() if outcome.code == 0 else None

        def evaluate() -> tuple[Outcome, Any]:
            chosen = [f"run={of_run}", "episodes=4", "num_envs=4", "device=cpu"]
            outcome = run("zipf.evaluate", chosen, output)
            lines = outcome.output.splitlines()
            shown = [line for line in lines if not line.startswith("zipf: code is compiled")]
            return outcome, shown if outcome.code == 0 else None

        return {"train": train, "report": report, "evaluate": evaluate}

    def fresh() -> list[Path]:
        shutil.rmtree(root, ignore_errors=True)
        shutil.copytree(folder / "whole4", root)
        return sorted(path for path in root.rglob("*") if path.is_file())

    expected = {}
    for name, command in commands().items():
        fresh()
        outcome, expected[name] = command()
        assert outcome.code == 0, outcome.output
    for number in range(count):
        path = draw.choice(fresh())
        before = path.read_bytes()
        how = damage(path, draw)
        while path.exists() and path.read_bytes() == before:
            how = damage(path, draw)
        name = draw.choice(sorted(expected))
        what = f"{path.relative_to(root)}: {how}; then {name}"
        outcome, result = commands()[name]()
        if outcome.broken:
            found("traceback", what, outcome)
            tally["traceback"] += 1
        elif outcome.refused:
            tally["refused"] += 1
        elif difference(expected[name], result):
            found("taken silently", f"{what}: {difference(expected[name], result)}", outcome)
            tally["taken silently"] += 1
        else:
            tally["made no difference"] += 1
        if number % 100 == 99:
            print(f"{number + 1} damages: {dict(tally)}", flush=True)
    return tally


WRONG = (
    "abc", "-1", "0", "1.5", "-0.001", "1e400", "nan", "inf", "-inf", "null", "true", "''", "[]",
    "[1]", "[1,2,3]", "{a:1}", "'{a: 1}'", "${seed}", "${oc.env:HOME}", "$(id)", "`id`", "../..",
    "/etc/passwd", "a/b", "99999999999999999999999", "x" * 5000, "\u00e9\u4e2d", "\x00", "a,b",
    "1,2", "[", "]", "{", "'", '"', "\\", "=", "!!python/object:os.system", "0x10", "1_000",
    "--help", "~", "*",
)  # fmt: skip


def malformed(draw: random.Random, options: dict[str, Any], groups: list[str]) -> list[str]:
    """The overrides of a command line of which one is changed at random."""
    name = draw.choice(sorted(options))
    misspelt = list(name)
    at = draw.randrange(len(misspelt))
    misspelt[at : at + draw.randrange(2)] = draw.choice(string.ascii_lowercase)
    group = draw.choice(groups)
    shown = yaml.safe_dump(options[name], default_flow_style=True).splitlines()[0]
    changed = draw.choice(
        [
            f"{''.join(misspelt)}={shown}",
            f"{name}={draw.choice(WRONG)}",
            f"{name}={draw.choice(WRONG)}",
            f"{name}.{draw.choice(string.ascii_lowercase)}={shown}",
            f"{group}={draw.choice(WRONG)}",
            f"{group}.name={draw.choice(WRONG)}",
            f"~{name}",
            f"+{name}={draw.choice(WRONG)}",
            f"++{name}={draw.choice(WRONG)}",
            draw.choice(WRONG),
            f"={shown}",
            name,
        ]
    )
    return draw.sample(["experiment=demo", changed], 2)


def soak_lines(count: int, draw: random.Random, folder: Path) -> Counter[str]:
    """Gives `zipf.train --cfg job` malformed command lines."""
    tally: Counter[str] = Counter()
    options = flatten(command_line.composed("experiment=demo").values)
    groups = ["experiment", "condition", "environment", *config_files.parts()]
    for number in range(count):
        overrides = malformed(draw, options, groups)
        outcome = run("zipf.train", [*overrides, "--cfg", "job"], folder / "output")
        what = " ".join(word if len(word) < 100 else f"{word[:100]}..." for word in overrides)
        if outcome.broken:
            found("traceback", what, outcome)
            tally["traceback"] += 1
        elif outcome.refused:
            tally["refused"] += 1
        elif outcome.code == 0 and _says(overrides, outcome.output):
            tally["taken for what it says"] += 1
        else:
            found("taken silently", what, outcome)
            tally["taken silently"] += 1
        if number % 100 == 99:
            print(f"{number + 1} lines: {dict(tally)}", flush=True)
    return tally


def _says(overrides: list[str], printed: str) -> bool:
    """Whether the configuration that was printed has what these overrides say."""
    changed = next(word for word in overrides if word != "experiment=demo")
    name, equals, value = changed.lstrip("+").partition("=")
    if "--help" in changed:
        return True
    try:
        values = yaml.safe_load(printed)
    except yaml.YAMLError:
        return False
    try:
        told = yaml.safe_load(value)
    except yaml.YAMLError:  # text, such as a name of "*"
        told = value
    if name in values and isinstance(values[name], dict):  # a group: its choice
        return value in command_line.choices(name)
    taken = flatten(values).get(name, values.get(name))
    same = taken == told or str(taken) == value.strip("'\"")
    return bool(equals) and (same or _number(taken) == _number(value) is not None)


def _number(value: Any) -> float | None:
    try:
        return float(value)
    except (TypeError, ValueError):
        return None


SOAKS = {
    "kills": soak_kills,
    "ray_kills": soak_ray_kills,
    "damages": soak_damages,
    "lines": soak_lines,
}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("soak", choices=SOAKS)
    parser.add_argument("--count", type=int, default=1000)
    parser.add_argument("--seed", type=int, default=0)
    arguments = parser.parse_args()
    torch.set_num_threads(1)
    begun = time.perf_counter()
    with tempfile.TemporaryDirectory() as folder:
        tally = SOAKS[arguments.soak](arguments.count, random.Random(arguments.seed), Path(folder))
    minutes = (time.perf_counter() - begun) / 60
    print(f"{arguments.soak}, seed {arguments.seed}, {minutes:.0f} min: {dict(tally)}")
    bad = ("traceback", "taken silently", "differs", "could not go on", "did not train")
    sys.exit(any(tally[kind] for kind in bad))


if __name__ == "__main__":
    main()
