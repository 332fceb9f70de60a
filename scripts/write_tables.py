"""Writes what follows from registries, configurations and code into the documentation.

    python scripts/write_tables.py

A page marks the place of a table, or of a file, by comments:

    <!-- levels gridworld -->
    <!-- /levels -->

The lines between them are replaced by what the function in `BLOCKS` returns. The tests fail where a
page is out of date.
"""

import ast
import inspect
import re
from collections.abc import Callable, Iterable
from pathlib import Path

from zipf import envs
from zipf.envs.labyrinth.levels import LEVELS
from zipf.experiments import catalogue, composing

ROOT = Path(__file__).parent.parent
MARKS = re.compile(
    r"^<!-- (\w+)(?: ([\w/.]+))? -->\n(?:.*?\n)??<!-- /\1 -->$", re.MULTILINE | re.DOTALL
)


def pages() -> list[Path]:
    """The pages that may have tables."""
    return [ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md"))]


def rewritten(text: str) -> str:
    """A page's text with its blocks renewed.

    Raises:
        KeyError: it marks the place of an unknown block.
    """

    def block(match: re.Match[str]) -> str:
        name, argument = match.groups()
        rows = BLOCKS[name](argument) if argument else BLOCKS[name]()
        opening = " ".join(filter(None, [name, argument]))
        return "\n".join([f"<!-- {opening} -->", "", *rows, "", f"<!-- /{name} -->"])

    return MARKS.sub(block, text)


def families() -> list[str]:
    return markdown(
        ("Family", "Task", "Gymnasium id", "Splits"),
        (
            (
                code(family.name),
                family.summary,
                code(family.id) if family.id else "",
                ", ".join(code(split.name) for split in family.splits),
            )
            for family in envs.families().values()
        ),
    )


def levels(family: str) -> list[str]:
    found = envs.find_family(family)
    uses: dict[str, list[str]] = {}
    for split in found.splits:
        for kind in envs.KINDS:
            for level in split.levels(kind):
                uses.setdefault(level.name, []).append(f"{code(split.name)} ({kind})")
    known = [one for one in envs.REFERENCES if one.name in found.references]
    rows = []
    for name in (f"{family}/{level}" for level in found.levels):
        scores = (envs.reference(one.name, name) for one in known)
        texts = ("" if score is None else f"{score.score:.3f}" for score in scores)
        rows.append((code(name), ", ".join(uses.get(name, [])), *texts))
    return markdown(("Level", "Used by split", *(one.title for one in known)), rows)


def labyrinth() -> list[str]:
    """The labyrinth's levels: length and, from the docstrings of their rules, goal and rewards."""
    rows = []
    for name, level in LEVELS.items():
        text = inspect.getdoc(level.load()) or ""
        goal = re.search(r"Goal: (.*?)\n\n", text, re.DOTALL)
        rewards = re.search(r"\nRewards: (.*?)(?:\n\w[\w ,]*:|$)", text, re.DOTALL)
        assert goal is not None, name
        told = " ".join(rewards[1].split()) if rewards else "+1 for a mushroom."
        rows.append((code(name), " ".join(goal[1].split()), told, f"{level.seconds} s"))
    return markdown(("Level", "Goal", "Rewards", "Length"), rows)


def labyrinth_references() -> list[str]:
    """What players that do not learn, and people, score in the labyrinth."""
    known = [one for one in envs.REFERENCES if one.name in envs.find_family("labyrinth").references]
    rows = []
    for name, level in LEVELS.items():
        scores = (envs.reference(one.name, f"labyrinth/{name}") for one in known)
        texts = ("" if one is None else f"{one.score:.1f} ± {one.error:.1f}" for one in scores)
        rows.append((code(name), f"{level.random:g}", f"{level.human:g}", *texts))
    titles = (one.title for one in known)
    return markdown(("Level", "Random, published", "Human, published", *titles), rows)


def constructor_options(family: str) -> list[str]:
    fields = envs.find_family(family).options_class.model_fields
    return markdown(
        ("Option", "Default"),
        (
            (code(name), code(str(field.get_default(call_default_factory=True))))
            for name, field in fields.items()
        ),
    )


def splits() -> list[str]:
    rows = []
    for split in envs.all_splits().values():
        kinds = [level_names([one.name for one in split.levels(kind)]) for kind in envs.KINDS]
        rows.append((code(split.name), *kinds))
    return markdown(("Split", *(kind.capitalize() for kind in envs.KINDS)), rows)


def level_names(names: list[str]) -> str:
    """The levels of a kind; of many of them the first and the last."""
    if len(names) <= 3:
        return ", ".join(map(code, names))
    return f"{len(names)} levels, from {code(names[0])} to {code(names[-1])}"


def experiments() -> list[str]:
    rows = []
    for name in composing.choices("experiment"):
        values = composing.composed(f"experiment={name}").values
        collector = values["collector"]
        frames = values["updates"] * collector["num_envs"] * collector["unroll_length"]
        rows.append(
            (
                code(name),
                catalogue.summary("experiment", name),
                code(values["environment"]["split"]),
                f"{values['updates']:,}",
                f"{frames / 1e6:,.1f} M",
            )
        )
    return markdown(("Experiment", "What it is", "Split", "Updates", "Frames"), rows)


def conditions() -> list[str]:
    return markdown(
        ("Condition", "Title in tables", "What it is"),
        (
            (code(name), row.title, catalogue.summary("condition", name))
            for name, row in catalogue.conditions().items()
        ),
    )


def sweeps() -> list[str]:
    return markdown(
        ("Sweep", "What it is"),
        ((code(name), catalogue.summary("sweep", name)) for name in composing.choices("sweep")),
    )


def choices() -> list[str]:
    groups = [group for group in composing.groups() if group not in ("experiment", "condition")]
    return markdown(
        ("Group", "Choices"),
        ((code(group), ", ".join(map(code, composing.choices(group)))) for group in groups),
    )


def modules(package: str) -> list[str]:
    """The modules of a package, each with the first paragraph of its docstring."""
    rows = []
    for path in sorted((ROOT / package).glob("*.py")):
        text = ast.get_docstring(ast.parse(path.read_text(encoding="utf-8"))) or ""
        summary = " ".join(text.split("\n\n")[0].split())
        rows.append((code(path.name), summary.replace("|", "\\|")))
    return markdown(("Module", "Contents"), rows)


def file(path: str) -> list[str]:
    """A file of an example, named as it is called in the example's folder."""
    example, _, name = path.removeprefix("examples/").partition("/")
    text = (ROOT / "examples" / example / name).read_text(encoding="utf-8").rstrip()
    language = {".py": "python", ".yaml": "yaml"}[Path(name).suffix]
    return [f"```{language}", f"# {name}", text, "```"]


BLOCKS: dict[str, Callable[..., list[str]]] = {
    "families": families,
    "levels": levels,
    "constructor_options": constructor_options,
    "labyrinth": labyrinth,
    "labyrinth_references": labyrinth_references,
    "splits": splits,
    "experiments": experiments,
    "conditions": conditions,
    "sweeps": sweeps,
    "choices": choices,
    "modules": modules,
    "file": file,
}


def code(text: str) -> str:
    return f"`{text}`"


def markdown(heading: tuple[str, ...], rows: Iterable[tuple[str, ...]]) -> list[str]:
    """A table's lines."""
    dashes = tuple(":--" for _ in heading)
    return [f"| {' | '.join(cells)} |" for cells in (heading, dashes, *rows)]


def main() -> None:
    for page in pages():
        text = page.read_text(encoding="utf-8")
        new = rewritten(text)
        if new != text:
            page.write_text(new, encoding="utf-8")
            print(f"written: {page.relative_to(ROOT)}")


if __name__ == "__main__":
    main()
