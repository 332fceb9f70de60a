"""Writes what follows from registries, configurations and code into the documentation.

    python scripts/write_tables.py

A page marks the place of a table, or of a file, by comments:

    <!-- levels gridworld -->
    <!-- /levels -->

The lines between them are replaced by what the function in `BLOCKS` returns. The tests fail where a
page is out of date.
"""

import argparse
import ast
import re
from collections.abc import Callable
from pathlib import Path

import agent_tables
import device_table
import family_tables
import number_tables
from tables import code, markdown

from zipf import envs
from zipf.experiments.options import catalogue, composing, config_files
from zipf.experiments.reporting.glossary import GLOSSARY

ROOT = Path(__file__).parent.parent
MARKS = re.compile(
    r"^<!-- (\w+)(?: ([\w/.]+))? -->\n(?:.*?\n)??<!-- /\1 -->$", re.MULTILINE | re.DOTALL
)


def pages() -> list[Path]:
    """The pages that may have tables."""
    return [ROOT / "README.md", ROOT / "RESULTS.md", *sorted((ROOT / "docs").rglob("*.md"))]


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


def splits() -> list[str]:
    rows = []
    for split in envs.all_splits().values():
        if split.only_trains:  # one level alone; the level's table has its scores
            continue
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
    return [f'```{language} title="{name}"', text, "```"]


def glossary() -> list[str]:
    """The words of `zipf.experiments.reporting.glossary`."""
    return markdown(("Word", "Meaning"), [(f"*{word}*", meaning) for word, meaning in GLOSSARY])


BLOCKS: dict[str, Callable[..., list[str]]] = {
    "families": family_tables.families,
    "family": family_tables.family,
    "levels": family_tables.levels,
    "constructor_options": family_tables.constructor_options,
    "gallery": family_tables.gallery,
    "labyrinth": family_tables.labyrinth,
    "labyrinth_baselines": family_tables.labyrinth_baselines,
    "groups": agent_tables.groups,
    "parts": agent_tables.parts,
    "device": device_table.device,
    "splits": splits,
    "experiments": experiments,
    "conditions": conditions,
    "sweeps": sweeps,
    "modules": modules,
    "file": file,
    "glossary": glossary,
    "numbers": number_tables.numbers,
    "alone": number_tables.alone,
    "tail_best": number_tables.best,
    "tail_situations": number_tables.situations,
    "comparison": number_tables.comparison,
    "runs": number_tables.runs,
}


def new_pages() -> dict[Path, str]:
    """The pages that families and parts of agents still lack, with the places of their tables."""
    found = {}
    for name in envs.families():
        blocks = (f"family {name}", f"levels {name}", f"constructor_options {name}")
        found[ROOT / "docs" / "environments" / f"{name}.md"] = (name.capitalize(), blocks)
    for group in config_files.parts():
        found[ROOT / "docs" / "agents" / f"{group}.md"] = (group.capitalize(), (f"parts {group}",))
    places = "<!-- {} -->\n<!-- /{} -->\n"
    return {
        path: "\n".join([f"# {title}\n", *(places.format(one, one.split()[0]) for one in blocks)])
        for path, (title, blocks) in found.items()
        if not path.exists()
    }


def main() -> None:
    argparse.ArgumentParser(description=__doc__.partition("\n")[0]).parse_args()
    for page, text in new_pages().items():
        page.write_text(text, encoding="utf-8")
    for page in pages():
        text = page.read_text(encoding="utf-8")
        new = rewritten(text)
        if new != text:
            page.write_text(new, encoding="utf-8")
            print(f"written: {page.relative_to(ROOT)}")


if __name__ == "__main__":
    main()
