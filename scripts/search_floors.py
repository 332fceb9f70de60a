"""Searches for policies that are not told what is asked for, on every level that a split uses. In
the gridworld the best of these is known exactly.

    python scripts/search_floors.py
    python scripts/search_floors.py labyrinth --seconds 100 --episodes 300
    python scripts/search_floors.py playroom --levels put/put_near_bed_tray_frequent

`zipf.envs.floors` says what is tried. Each level is searched with the split's own options, and
with those of each experiment in the split's environments. The best five policies are played again
on seeds that the search has not seen. All five stand in `results/floors.csv`; the best is the
level's "blind" in `baselines.json` of the family's package, which evaluations, reports and the
documentation read. `results/floors.md` has it beside chance and expert, for the record.

Levels that stand in the table are passed over, so that the command may be stopped and given again;
`--again` searches them anew, beginning with the policies that are there and with the best of the
family's other levels, and keeps the better. With `--seconds 0` it only measures those policies.
"""

import argparse
import json
import os
from collections.abc import Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from pathlib import Path
from typing import Any

import pandas as pd
from measure_baselines import RESULTS, experiments_of, write_figure
from tables import markdown

from zipf import envs
from zipf.envs import floors
from zipf.experiments.building.run_folder import commit
from zipf.protocol import says_little

TABLE = RESULTS / "floors.csv"
ROWS = {"playroom": 256, "labyrinth": 64}
"""How many envs are stepped together; more of them take more RAM."""
PLACE = ["family", "level", "options"]
Task = tuple[str, str, dict[str, Any]]
"""Family, level and constructor options."""


def tasks(family: str) -> list[Task]:
    """Family, level and options of everything that is searched: each level that a split uses, with
    the defaults and with the options of each experiment."""
    plain = [(split, {}) for split in envs.find_family(family).splits]
    found: list[Task] = [
        (family, level.name.partition("/")[2], {**options, **level.options})
        for split, options in [*plain, *experiments_of(family)]
        for level in split.all_levels
    ]
    return [task for place, task in enumerate(found) if task not in found[:place]]


def split_level(family: str, level: str) -> envs.SplitLevel:
    """The level as the first split has it that uses it: with its normalisation."""
    return next(
        one
        for split in envs.find_family(family).splits
        for one in split.all_levels
        if one.name == f"{family}/{level}"
    )


def arena(family: str, level: str, options: Mapping[str, Any]) -> floors.Arena:
    """The level's envs, with images of a few pixels: nobody looks at them."""
    small = {"image_size": (3, 4), **options}
    return floors.Arena(f"{family}/{level}", ROWS[family], options=small)


def searched(task: Task, seconds: float, episodes: int, first: Sequence[str]) -> list[floors.Floor]:
    """The best policies of a level, the best first."""
    played = arena(*task)
    best = floors.search(played, seconds=seconds, known=first)
    found = floors.play(best, played, episodes=episodes)
    played.close()
    return sorted(found, key=lambda one: -one.score)


def main(arguments: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("families", nargs="*", metavar="family", help="all if none is given")
    parser.add_argument("--levels", nargs="+", default=[], help="without the family's name")
    parser.add_argument("--options", type=json.loads, help="only with these, as JSON")
    parser.add_argument("--seconds", type=float, default=300, help="of searching, for each level")
    parser.add_argument("--episodes", type=int, default=2000, help="to measure the best five over")
    parser.add_argument("--jobs", type=int, default=os.cpu_count(), help="levels at a time")
    parser.add_argument("--again", action="store_true", help="search what is in the table, too")
    parser.add_argument("--table", type=Path, default=TABLE)
    given = parser.parse_args(arguments)
    if unknown := sorted(set(given.families) - set(ROWS)):
        parser.error(f"unknown families {', '.join(unknown)}: expected some of {', '.join(ROWS)}")
    table = pd.read_csv(given.table) if given.table.exists() else pd.DataFrame(columns=PLACE)
    done = set(table[PLACE].itertuples(index=False, name=None))
    due = [
        task
        for family in given.families or ROWS
        for task in tasks(family)
        if (not given.levels or task[1] in given.levels)
        and (given.options is None or task[2] == given.options)
        and (given.again or _key(task) not in done)
    ]
    with ProcessPoolExecutor(given.jobs) as pool:
        running = {
            pool.submit(searched, task, given.seconds, given.episodes, known(table, task)): task
            for task in due
        }
        for number, future in enumerate(as_completed(running), 1):
            task, best = running[future], future.result()
            table = _with(table, task, best, given.seconds)
            given.table.write_text(table.to_csv(index=False, lineterminator="\n"), "utf-8")
            write_figure(task[0], "blind", task[1], best_known(table, task))
            print(f"{number}/{len(due)} {'/'.join(task[:2])} {task[2]}: {best[0]}", flush=True)
    given.table.with_suffix(".md").write_text(page(table), "utf-8")


def _key(task: Task) -> tuple[str, str, str]:
    return (*task[:2], json.dumps(task[2], sort_keys=True))


def _here(table: pd.DataFrame, task: Task) -> pd.Series:
    """Which lines are of this level with these options."""
    return (table[PLACE] == pd.Series(_key(task), PLACE)).all(axis=1)


def known(table: pd.DataFrame, task: Task) -> list[str]:
    """The policies that the table has of a level with any options, and the best of each other level
    of the family with these: how to move about is no matter of the level."""
    if not len(table):
        return []
    here = (table[PLACE[:2]] == pd.Series(_key(task)[:2], PLACE[:2])).all(axis=1)
    alike = table[(table["family"] == task[0]) & (table["options"] == _key(task)[2])]
    best = alike.drop_duplicates("level")["policy"]
    return list(dict.fromkeys([*table["policy"][here], *best]))


def best_known(table: pd.DataFrame, task: Task) -> dict[str, Any]:
    """The best policy of a level as `baselines.json` has it."""
    first = table[_here(table, task)].iloc[0]
    return {
        "score": float(first["score"]),
        "error": float(first["error"]),
        "episodes": int(first["episodes"]),
        "options": task[2],
        "seed": 0,
        "commit": str(first["commit"]),
        "policy": str(first["policy"]),
    }


def _with(
    table: pd.DataFrame, task: Task, best: Sequence[floors.Floor], seconds: float
) -> pd.DataFrame:
    """The table with a level's best policies, those of an earlier search among them."""
    rows = [
        {
            **dict(zip(PLACE, _key(task), strict=True)),
            "policy": one.policy,
            "score": round(one.score, 4),
            "error": round(one.error, 4),
            "episodes": one.episodes,
            "seconds": seconds,
            "commit": commit(),
        }
        for one in best
    ]
    here = _here(table, task)
    rows += table[here].to_dict("records")  # type: ignore[arg-type]
    # Of a policy that was measured before, the figure of more episodes counts.
    every = pd.DataFrame(rows).sort_values("episodes", ascending=False, kind="stable")
    best_first = every.drop_duplicates("policy").sort_values(
        "score", ascending=False, kind="stable"
    )
    kept = best_first.head(floors.KEPT)
    new = pd.concat([table[~here], kept] if len(table) else [kept])
    return new.sort_values(PLACE, kind="stable", ignore_index=True)


def page(table: pd.DataFrame) -> str:
    """The best policy of each level beside its baselines, for the record."""
    columns = ("Level", "Best policy", "Its score", "Episodes", "Blind", "Chance", "Expert")
    rows = []
    for (family, level, written), of_level in table.groupby(PLACE, sort=False):
        options = json.loads(written)
        names = ("blind", "chance", "expert")
        baselines = [envs.baseline(name, f"{family}/{level}", **options) for name in names]
        scores = [None if one is None else one.score for one in baselines]
        best = of_level.iloc[0]
        shown = f"{family}/{level}" + "".join(f", {key}={value}" for key, value in options.items())
        of_split = split_level(family, level)
        blind, _, expert = (None if one is None else of_split.normalised(one) for one in scores)
        mark = " ‡" if says_little(blind, expert) else ""
        rows.append(
            (
                shown + mark,
                f"`{floors.summary(best['policy'])}`",
                f"{best['score']:.3f} ± {best['error']:.3f}",
                str(best["episodes"]),
                *("–" if score is None else f"{score:.3f}" for score in scores),
            )
        )
    lines = markdown(columns, rows, right=columns[2:])
    return "\n".join(
        [
            "## Floors: the best that policies reach that are not told what is asked for",
            "",
            *lines,
            "",
            "Mean returns of an episode ± standard error, of the best of the policies that "
            "`scripts/search_floors.py` found, played on other seeds than those of the search. "
            "Blind is the higher one of this and of what follows from the rules. ‡: more than half "
            "of the expert's score; the level says little about reading. `results/floors.csv` has "
            "the five best policies of each level, whole, with the seconds of the search and the "
            "commit.",
            "",
            "```",
            "python scripts/search_floors.py",
            "```",
            "",
        ]
    )


if __name__ == "__main__":
    main()
