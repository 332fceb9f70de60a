"""Measures what policies that do not learn score on the levels of a family.

    python scripts/measure_baselines.py playroom
    python scripts/measure_baselines.py playroom --baselines expert
    python scripts/measure_baselines.py labyrinth --episodes 200

Writes `baselines.json` in the family's package, which evaluations, reports and the documentation
read, and `results/<family>_baselines.md`, which `make results` copies into the record. What is
exact is not measured. A scripted policy is measured where the family has it in `baselines` and
`zipf.envs` has a function of the baseline's name that makes it, as `zipf.envs.expert` does.

Every draw comes from fixed seeds. Images are of a few pixels: no policy looks at them.
"""

import argparse
import importlib
import json
from collections.abc import Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

from zipf import envs
from zipf.envs.episodes import measure
from zipf.envs.gridworld import FAMILY as GRIDWORLD
from zipf.envs.labyrinth.levels import LEVELS as TASKS
from zipf.envs.playroom.levels import LEVELS as PLAYROOM
from zipf.experiments.building.run_folder import commit
from zipf.experiments.options import command_line, composing

RESULTS = Path(__file__).parent.parent / "results"
NUM_ENVS = 100

Measured = Sequence[tuple[str, Mapping[str, Any]]]
Figures = dict[str, dict[str, list[dict[str, Any]]]]

LEVELS: Mapping[str, Sequence[str]] = {
    "gridworld": GRIDWORLD.levels,
    "playroom": tuple(PLAYROOM),
    "labyrinth": tuple(TASKS),
}
"""Levels of each family; one that draws others has the mean of theirs."""


def experiments_of(family: str) -> list[tuple[envs.Split, Mapping[str, Any]]]:
    """For each experiment with the family's envs its split, and the constructor options that are
    not the family's defaults."""
    found = []
    own = envs.find_family(family)
    defaults = own.options_class().model_dump(exclude=set(own.appearance))
    for experiment in command_line.choices("experiment"):
        given = composing.composed(f"experiment={experiment}").values["environment"]
        split = envs.split(given["split"])
        if envs.family_of_split(split.name) is own:
            others = {
                key: given[key]
                for key, value in defaults.items()
                if key in given and given[key] != value
            }
            found.append((split, others))
    return found


def to_measure(family: str) -> Measured:
    """Levels, and the constructor options that are not the family's defaults: none, and those of
    the experiments with the family's envs."""
    found: list[tuple[str, Mapping[str, Any]]] = [(level, {}) for level in LEVELS[family]]
    for split, others in experiments_of(family):
        if others:
            levels = {one.name.removeprefix(f"{family}/"): others for one in split.all_levels}
            found += [one for one in levels.items() if one not in found]
    return found


def measurable(family: str) -> list[str]:
    """The baselines of a family that have a policy and are not known exactly."""
    found = []
    for name in envs.find_family(family).baselines:
        if name == "chance" or hasattr(envs, name):
            known = envs.baseline(name, f"{family}/{LEVELS[family][0]}")
            if known is None or known.episodes is not None:
                found.append(name)
    return found


def figure(
    name: str, family: str, level: str, options: Mapping[str, Any], episodes: int, seed: int
) -> dict[str, Any]:
    """Plays a level."""
    full = f"{family}/{level}"
    how: dict[str, Any] = {"episodes": episodes, "seed": seed, "num_envs": NUM_ENVS, **options}
    if "image_size" in envs.find_family(family).options_class.model_fields:
        how["image_size"] = (3, 4)  # the paper's proportions
    if name == "chance":
        known = envs.measure_chance(full, **how)
    else:
        known = measure(partial(getattr(envs, name), full), full, **how)
    assert known.error is not None
    return {
        "score": round(known.score, 4),
        "error": round(known.error, 4),
        "episodes": episodes,
        "options": dict(options),
        "seed": seed,
        "commit": commit(),
    }


def write_figure(
    family: str, name: str, level: str, figure: dict[str, Any], out: Path | None = None
) -> Figures:
    """Puts a figure into `baselines.json` in the family's package, in the place of that with the
    same options; returns all figures."""
    package = importlib.import_module(f"zipf.envs.{family}")
    out = out or Path(str(package.__file__)).with_name("baselines.json")
    found: Figures = json.loads(out.read_text("utf-8")) if out.exists() else {}
    of_level = found.setdefault(name, {}).setdefault(level, [])
    of_level[:] = [*(old for old in of_level if old["options"] != figure["options"]), figure]
    order = [*LEVELS[family]]
    ordered = {
        one.name: dict(
            sorted(
                found[one.name].items(),
                key=lambda item: order.index(item[0]) if item[0] in order else len(order),
            )
        )
        for one in envs.BASELINES
        if one.name in found
    }
    out.write_text(json.dumps(ordered, indent=2) + "\n", "utf-8")
    return ordered


def page(family: str, found: Figures) -> str:
    """The table for the record."""
    published = {
        level.name.removeprefix(f"{family}/"): level.normalisation
        for split in envs.find_family(family).splits
        for level in split.all_levels
        if level.normalisation is not None
    }
    # What is blind has a table of its own, of scripts/search_floors.py.
    known = [one for one in envs.BASELINES if one.name in found and one.name != "blind"]
    titles = [title for one in known for title in (one.title, "Episodes")]
    header = ["Level", *(["Random, published", "Human, published"] if published else []), *titles]
    lines = [header, [":--"] + ["--:"] * (len(header) - 1)]
    for level, options in to_measure(family):
        shown = level + "".join(f", {name}={value}" for name, value in options.items())
        cells = [shown]
        if published:
            cells += [f"{published[level].random:g}", f"{published[level].human:g}"]
        for one in known:
            figures = found[one.name].get(level, [])
            own = next((figure for figure in figures if figure["options"] == options), None)
            cells += [
                f"{own['score']:.2f} ± {own['error']:.2f}" if own else "–",
                str(own["episodes"]) if own else "–",
            ]
        lines.append(cells)
    figures = [f for of in found.values() for each in of.values() for f in each]
    commits = ", ".join(dict.fromkeys(str(one["commit"])[:10] for one in figures))
    counts = {figure["episodes"] for figure in figures}
    episodes = f" --episodes {counts.pop()}" if len(counts) == 1 else ""
    meanings = " ".join(f"{one.title}: {one.meaning}." for one in known)
    text = (
        f"Mean returns of an episode ± standard error, measured at {commits}. {meanings} Scripted "
        "policies are no upper bound."
    )
    if published:
        text += (
            " The published returns were taken in the original engine, those of levels that end in "
            "`_train` on the `_test` levels."
        )
    table = "\n".join(f"| {' | '.join(cells)} |" for cells in lines)
    return (
        f"## Zipf's {family.capitalize()}: baselines\n\n{table}\n\n{text}\n\n"
        f"```\npython scripts/measure_baselines.py {family}{episodes}\n```\n"
    )


def main(arguments: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("family", choices=LEVELS)
    parser.add_argument("levels", nargs="*", help="levels to measure; all if none is given")
    parser.add_argument("--baselines", nargs="+", help="all that are not exact if none is given")
    parser.add_argument("--episodes", type=int, default=1000, help="of each level, at least 2")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--missing", action="store_true", help="measure only what is not there")
    parser.add_argument("--out", type=Path, help="the file to write, or to renew")
    parser.add_argument("--page", type=Path, help="the table for the record")
    given = parser.parse_args(arguments)
    names = measurable(given.family)
    levels = list(LEVELS[given.family])
    if given.episodes < 2:
        parser.error(f"--episodes must be at least 2, got {given.episodes}")
    for what, chosen, known in (
        ("baselines", given.baselines or [], names),
        ("levels", given.levels, levels),
    ):
        if unknown := [one for one in chosen if one not in known]:
            parser.error(
                f"unknown {what} {', '.join(unknown)}: expected some of {', '.join(known)}"
            )
    package = importlib.import_module(f"zipf.envs.{given.family}")
    out = given.out or Path(str(package.__file__)).with_name("baselines.json")
    found: Figures = json.loads(out.read_text("utf-8")) if out.exists() else {}
    for name in given.baselines or names:
        for level, options in to_measure(given.family):
            if given.levels and level not in given.levels:
                continue
            there = [one["options"] for one in found.get(name, {}).get(level, [])]
            if given.missing and options in there:
                continue
            new = figure(name, given.family, level, options, given.episodes, given.seed)
            found = write_figure(given.family, name, level, new, out)
            print(f"{name}, {level} {options}: {new['score']} +- {new['error']}", flush=True)
    table = given.page or RESULTS / f"{given.family}_baselines.md"
    table.write_text(page(given.family, found), "utf-8")
    print(f"written: {out}, {table}")


if __name__ == "__main__":
    main()
