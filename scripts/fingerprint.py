# ruff: noqa: E501
"""What a checkout computes, as digests: to compare two checkouts on one machine, bit for bit.

    PYTHONPATH=<checkout> python scripts/fingerprint.py --write before.json
    python scripts/fingerprint.py --compare before.json

Digests the weights, the optimiser and the result tables after 20 updates of every condition and of
the agents with the best rare scores (CPU, float32), and the states and observations of every level
after random steps. Floating-point results differ between CPUs: write and compare on one machine.
`--only` takes a regular expression of names.
"""

from __future__ import annotations

import argparse
import hashlib
import io
import json
import os
import re
import subprocess
import sys
import tempfile
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np
import torch

SHORT = "updates=20 evaluation.every=20 evaluation.episodes=20 schedule.window=[0,20] "
SHORT += "schedule.log_every=5 schedule.checkpoint_every=20 precision=float32 device=cpu"
TIMES = re.compile("seconds|frames_per_second|time_.*|hours")

CONDITIONS = """
imitation imitation_comparing_augmented imitation_hindsight_augmented impala impala_augmented impala_byol impala_comparing impala_comparing_augmented impala_comparing_hindsight impala_dictionary impala_first_visit impala_hindsight impala_hl_gauss impala_language impala_mem impala_mlp impala_quantile impala_reweighted impala_rnd impala_transformer impala_transformer_vision_language impala_vision impala_vision_language r2d2 r2d2_uniform_replay supervised supervised_hindsight_augmented supervised_matching vmpo
"""

# Those with the best rare scores in RESULTS.md, and parts that no condition has.
FURTHER = {
    "gridworld/comparing_hindsight": "experiment=gridworld_compact condition=impala_comparing_hindsight",
    "gridworld/comparing_augmented": "experiment=gridworld_compact condition=impala_comparing_augmented",
    "gridworld/hindsight_augmented": "experiment=gridworld_compact condition=impala_comparing_hindsight augmentation=random",
    "gridworld/imitation": "experiment=gridworld_compact condition=imitation_comparing_augmented",
    "gridworld/given": "experiment=gridworld_compact condition=impala_mlp network=comparing network.comparison=given",
    "gridworld/decay": "experiment=demo learning_rate_decay=[10,20] agent=vmpo",
    "gridworld/r2d2_lag": "experiment=demo agent=r2d2 memory=lstm",
    "gridworld/lag0": "experiment=demo collector.lag=0 exploration=rnd",
    "gridworld/shares": "experiment=demo condition=imitation agent.teacher_share=0.3",
    "playroom/matching": "experiment=playroom_lift_compact condition=impala_hindsight network=matching",
    "playroom/imitation_matching": "experiment=playroom_lift_compact condition=imitation_hindsight_augmented network=matching hindsight.matching_cost=1.0",
    "playroom/supervised": "experiment=playroom_find_compact condition=supervised",
    "playroom/language": "experiment=playroom_lift_compact condition=impala_vision_language collector.num_envs=16",
    "labyrinth": "experiment=labyrinth_compact condition=impala collector.num_envs=32 updates=4 evaluation.every=4 schedule.window=[0,4] evaluation.episodes=1 evaluation.num_envs=1",
}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--write", type=Path)
    parser.add_argument("--compare", type=Path)
    parser.add_argument("--only", default="")
    parser.add_argument("--jobs", type=int, default=2)
    given = parser.parse_args()
    digests: dict[str, str] = {}
    tasks = {f"run/{name}": options for name, options in runs().items()}
    names = [name for name in [*tasks, "environments"] if re.search(given.only, name)]
    with ThreadPoolExecutor(given.jobs) as pool:
        for name, found in zip(
            names,
            pool.map(lambda n: trained(tasks[n]) if n in tasks else environments(), names),
            strict=True,
        ):
            for part, digest in found.items():
                digests[f"{name}/{part}"] = digest
            print(name, flush=True)
    if given.write:
        given.write.write_text(json.dumps(digests, indent=1))
    if given.compare:
        before = json.loads(given.compare.read_text())
        before = {k: v for k, v in before.items() if any(k.startswith(f"{n}/") for n in names)}
        differ = sorted(
            k for k in before.keys() | digests.keys() if before.get(k) != digests.get(k)
        )
        for key in differ:
            print("DIFFERS" if key in before and key in digests else "MISSING", key)
        print(f"{len(before)} digests, {len(differ)} differ")
        sys.exit(bool(differ))


def runs() -> dict[str, str]:
    """Options of the runs, by name: every condition where it can learn, and `FURTHER`."""
    conditions = CONDITIONS.split()
    found = {}
    for name in conditions:
        if name.startswith("supervised"):
            found[name] = f"experiment=playroom_find_compact condition={name} collector.num_envs=64"
        else:
            found[name] = f"experiment=demo_conditions condition={name}"
    return found | FURTHER


def trained(options: str) -> dict[str, str]:
    with tempfile.TemporaryDirectory() as folder:
        words = [*options.split(), f"run_root={folder}"]
        given = {word.partition("=")[0] for word in words}
        words += [word for word in SHORT.split() if word.partition("=")[0] not in given]
        done = subprocess.run(
            [sys.executable, "-m", "zipf.train", *words],
            capture_output=True,
            text=True,
            env={**os.environ, "OMP_NUM_THREADS": "1"},
        )
        if done.returncode:
            return {"failed": done.stderr[-2000:]}
        (run,) = Path(folder).glob("*/*/seed*")
        with open(run / "checkpoint.pt", "rb") as file:
            file.readline()
            state = torch.load(io.BytesIO(file.read()), map_location="cpu", weights_only=False)
        found = {f"agent/{key}": digest(part) for key, part in state["agent"].items()}
        for path in sorted(run.glob("*.csv")):
            found[path.name] = table(path)
        return found


def table(path: Path) -> str:
    """Of a table's columns but those of times; what follows the header's columns, or a line that is
    no row, is not read. One with a row for each metric is read as one with a column for each."""
    header, *rows = path.read_text().splitlines()
    names = header.split(",")
    if "metric" in names:
        updates: dict[str, dict[str, str]] = {}
        for row in rows:
            update, frames, _, metric, value = row.split(",")
            updates.setdefault(update, {"update": update, "frames": frames})[metric] = value
        names = list(dict.fromkeys(name for of_update in updates.values() for name in of_update))
        header = ",".join(names)
        rows = [",".join(one.get(name, "") for name in names) for one in updates.values()]
    kept = [i for i, name in enumerate(names) if not TIMES.fullmatch(name) and name != "rows"]
    kept = sorted(kept, key=lambda i: names[i])
    text = [",".join(names[i] for i in kept)]
    text += [
        ",".join(row.split(",")[i] for i in kept)
        for row in rows
        if row.count(",") == header.count(",")
    ]
    return hashlib.sha256("\n".join(text).encode()).hexdigest()[:16]


def digest(value: Any) -> str:
    hash = hashlib.sha256()
    _add(hash, value)
    return hash.hexdigest()[:16]


def _add(hash: Any, value: Any) -> None:
    if isinstance(value, dict):
        for key in sorted(value, key=str):
            hash.update(str(key).encode())
            _add(hash, value[key])
    elif isinstance(value, list | tuple):
        for part in value:
            _add(hash, part)
    elif isinstance(value, torch.Tensor):
        hash.update(value.contiguous().cpu().numpy().tobytes())
    elif isinstance(value, np.ndarray):
        hash.update(np.ascontiguousarray(value).tobytes())
    else:
        hash.update(repr(value).encode())


def environments() -> dict[str, str]:
    from zipf import envs

    found = {}
    levels = {str(one.level) for split in envs.all_splits().values() for one in split.all_levels}
    for name in sorted(levels):
        level = name
        env = envs.make_vec(level, 8)
        parts = [env.reset(seed=5)[0]]
        random = np.random.default_rng(7)
        for _ in range(60):
            actions = random.integers(env.single_action_space.n, size=8)
            observation, reward, terminated, truncated, _ = env.step(actions)
            parts += [{k: v.copy() for k, v in observation.items()}, reward, terminated, truncated]
        found[name] = digest([parts, env.get_state()])
        env.close()
    return found


if __name__ == "__main__":
    main()
