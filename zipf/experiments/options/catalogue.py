"""The choices that a user has, with a line about each: for `--help` and the documentation."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from omegaconf import OmegaConf
from pydantic import ValidationError

from zipf import envs
from zipf.errors import UserError
from zipf.experiments.options import composing
from zipf.experiments.options.config_files import find
from zipf.experiments.options.schema import RandomSearch, RowOptions

EXPLAINED = ("experiment", "condition", "environment")
"""Groups that are listed with a line about each choice."""

LAUNCHERS = {
    "basic": "one job after another; the default",
    "joblib": 'hydra.launcher.n_jobs=<number> jobs at a time on this machine; ".[sweep]"',
    "submitit_slurm": 'jobs of a Slurm cluster; ".[sweep]"',
    "submitit_local": 'as submitit_slurm, all at once on this machine; ".[sweep]"',
    "ray": 'tasks of Ray, here or (hydra.launcher.address=auto) on a cluster; ".[ray]"',
}
"""What starts the jobs of a sweep, and the extra of the package that has it."""


def conditions() -> dict[str, RowOptions]:
    """How tables show each condition, in their order."""
    rows = {name: condition_row(name) for name in composing.choices("condition")}

    def place(item: tuple[str, RowOptions]) -> tuple[float, str]:
        name, row = item
        return float("inf") if row.order is None else row.order, name

    return dict(sorted(rows.items(), key=place))


def condition_row(name: str) -> RowOptions:
    """How tables show a condition; with its name as title where its file has none.

    Raises:
        UserError: the file says what a row cannot be.
    """
    written = find("condition", name)
    row = (written.values.get("row") if written else None) or {}
    place = written.place if written else ""
    if not isinstance(row, dict):
        raise UserError(f"{place}: row={row}: should be a mapping, such as row: {{title: {name}}}")
    try:
        return RowOptions(**{"title": name, **row})
    except ValidationError as error:
        first = error.errors()[0]
        where = ".".join(("row", *map(str, first["loc"])))
        raise UserError(f"{place}: {where}={first['input']}: {first['msg']}") from None


def summary(group: str, name: str) -> str:
    """What the comment above a choice says, on one line; empty for one that is in no file."""
    written = find(group, name)
    return written.place.comment if written else ""


HELP = """usage: python -m zipf.train experiment=NAME [option=value ...]
       python -m zipf.train -m [sweep=NAME] [option=value,value ...]

Trains an agent and scores it as it learns; with -m, one after another, many. Options and their
choices are below. Flags:

    --explain [GROUP]   tells of every option, or of those of a group, where its value comes from;
                        --explain FOLDER: of a run that there is
    --config-dir DIR    a folder of your own experiments, conditions and choices
    --cfg job           prints the options as YAML
    --version           prints the version; --hydra-help tells of Hydra's other flags

Examples:

    python -m zipf.train experiment=gridworld
    python -m zipf.train experiment=demo condition=r2d2 agent.learning_rate=1e-4 --explain agent
    python -m zipf.train -m experiment=gridworld_compact memory=mlp,lstm seed=0,1,2
    python -m zipf.train -m sweep=demo hydra/launcher=joblib hydra.launcher.n_jobs=2
    python -m zipf.train -m experiment=demo 'agent.discount=interval(0.9,1)' search=random"""


def help_text(overrides: Sequence[str] = ()) -> str:
    """What `--help` prints: all choices, and all options as they are after these overrides.

    Raises:
        UserError: the overrides cannot be composed.
    """
    options = OmegaConf.to_yaml(OmegaConf.create(composing.composed(*overrides).values))
    explained = f"Options, with the values of the choices made:\n\n{options.rstrip()}"
    return f"{HELP}\n\n{_all_choices()}\n\n{explained}"


def _all_choices() -> str:
    parts = {
        "experiment=": _summaries("experiment"),
        "condition=": [(name, row.title) for name, row in conditions().items()],
        "environment= (a family of envs)": [
            (family.name, _described(family))
            for family in envs.families().values()
            if family.splits
        ],
        "-m sweep= (a sweep; or -m and lists of values)": _summaries("sweep"),
        "-m search= (a sweep over intervals and lists, drawn and scored)": [
            ("random", _random_search())
        ],
        "hydra/launcher= (what starts the jobs of a sweep)": list(LAUNCHERS.items()),
        "Other groups:": [
            (f"{group}=", ", ".join(composing.choices(group)))
            for group in composing.groups()
            if group not in EXPLAINED
        ],
    }
    return "\n\n".join(f"{heading}\n{_columns(rows)}" for heading, rows in parts.items())


def _summaries(group: str) -> list[tuple[str, str]]:
    return [(name, summary(group, name)) for name in composing.choices(group)]


def _random_search() -> str:
    fields = RandomSearch.model_fields.items()
    options = " ".join(f"search.{name}={field.default}" for name, field in fields)
    return f"values drawn at random, all trials at once; {options}"


def _described(family: envs.Family) -> str:
    return f"{family.summary}; environment.split={', '.join(family.split_names)}"


def _columns(rows: Iterable[tuple[str, str]]) -> str:
    rows = list(rows)
    width = max(len(name) for name, _ in rows)
    return "\n".join(f"  {name:{width}}  {text}".rstrip() for name, text in rows)
