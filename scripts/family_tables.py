"""Tables and sections of the pages about families of envs, from the registry of families."""

import importlib
import inspect
import re
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from gymnasium import spaces
from tables import code, comments, described, markdown

from zipf import envs
from zipf.envs import floors
from zipf.envs.labyrinth import FAMILY as _labyrinth
from zipf.envs.labyrinth.levels import LEVELS
from zipf.envs.playroom.levels import LEVELS as PLAYROOM
from zipf.envs.playroom.levels import LIFT, NEAR
from zipf.protocol import says_little

LITTLE = "‡"
LEGEND = [
    "",
    f"{LITTLE} Says little about reading: a policy that is not told what is asked for has more "
    "than half of the expert's score.",
]


def families(folder: str) -> list[str]:
    """All families, each with a link to its page in `folder`."""
    return markdown(
        ("Family", "Task", "Gymnasium id", "Splits"),
        (
            (
                f"[{code(family.name)}]({folder}/{family.name}.md)",
                family.summary,
                code(family.id) if family.id else "",
                ", ".join(map(code, family.split_names)),
            )
            for family in envs.families().values()
        ),
    )


def family(name: str) -> list[str]:
    """What a family's envs are: a table of facts, and the docstring of its single env."""
    found = envs.find_family(name)
    assert isinstance(found.make, str)
    single = _attribute(found.make)
    batch = envs.make_train(found.splits[0], 1)
    of_a_level = type(envs.make_vec(f"{name}/{found.levels[0]}", 1))
    facts = [
        ("Gymnasium id", code(str(found.id))),
        ("Splits", ", ".join(map(code, found.split_names))),
        ("Observations", "; ".join(_spaces(batch.single_observation_space))),
        ("Actions", code(str(batch.single_action_space))),
        ("Situation", _situation(batch.situation)),
        ("One env, a batch", f"{_path(single)}, {_path(of_a_level)}"),
        ("Scripted policies", ", ".join(code(one) for one in envs.SCRIPTED if getattr(found, one))),
        ("Says what an episode asks for", _yes(found.goal is not None)),
        ("Tells what an episode achieved", _yes(batch.achieves)),
        ("Has symmetries", _yes(found.symmetries is not None)),
        ("Keys to play by hand", _yes(found.keys is not None)),
    ]
    batch.close()
    table = markdown(("", code(name)), facts)
    return [*table, "", *described(single, without_title=True)]


def _attribute(path: str) -> type:
    module, _, name = path.partition(":")
    return getattr(importlib.import_module(module), name)


def _path(documented: type) -> str:
    return code(f"{documented.__module__}.{documented.__qualname__}")


def _yes(fact: bool) -> str:
    return "yes" if fact else "no"


def _spaces(observation: spaces.Dict) -> Iterator[str]:
    for name, space in observation.items():
        yield f"{code(name)}, {np.dtype(space.dtype).name} {list(space.shape or ())}"


def _situation(ranks: dict[str, int]) -> str:
    return ", ".join(f"{code(name)} ({count} ranks)" for name, count in ranks.items())


def levels(family: str) -> list[str]:
    found = envs.find_family(family)
    uses: dict[str, list[str]] = {}
    for split in found.splits:
        if split.only_trains:  # one level alone
            continue
        for kind in split.kinds:
            for level in split.levels(kind):
                uses.setdefault(level.name, []).append(f"{code(split.name)} ({kind})")
    names = [one.name for one in envs.BASELINES if one.name in found.baselines]
    rows = []
    marked = False
    for level in (f"{family}/{level}" for level in found.levels):
        known = {name: envs.baseline(name, level) for name in names}
        texts = ("" if score is None else f"{score.score:.3f}" for score in known.values())
        little = _says_little(known)
        marked |= little
        shown = code(level) + (f" {LITTLE}" if little else "")
        rows.append((shown, ", ".join(uses.get(level, [])), *texts, _policy(known)))
    titles = (one.title for one in envs.BASELINES if one.name in names)
    lines = markdown(("Level", "Used by split", *titles, "Blind policy"), rows)
    return [*lines, *(LEGEND if marked else [])]


def _policy(known: dict[str, envs.BaselineScore | None]) -> str:
    """The policy that has the blind score, where it was found by a search."""
    blind = known.get("blind")
    return code(floors.summary(blind.policy)) if blind and blind.policy else ""


def _says_little(known: dict[str, envs.BaselineScore | None], random: float = 0.0) -> bool:
    blind, expert = (known.get(name) for name in ("blind", "expert"))
    return says_little(blind and blind.score - random, expert and expert.score - random)


@dataclass(frozen=True)
class Group:
    """Levels that look alike and differ in what is drawn how often: full names.

    Attributes:
        tasks: of levels that draw one of other levels, those, with pictures of their own.
    """

    levels: tuple[str, ...]
    task: str
    tasks: tuple[str, ...] = ()

    @property
    def file(self) -> str:
        """The name of their picture in docs/gallery."""
        return self.levels[0].replace("/", "_") + ".jpg"


def groups(family: str) -> list[Group]:
    """The levels of a family, grouped by what they look like, with their tasks in a line."""
    tasks = {"gridworld": _gridworld_task, "playroom": _playroom_task, "labyrinth": _goal}
    found = envs.find_family(family)
    alike: dict[tuple[str, str], list[str]] = {}
    for level in found.levels:
        task = tasks[family](level) if family in tasks else found.summary
        look = level if family == "labyrinth" and level in LEVELS else ""
        alike.setdefault((task, look), []).append(f"{family}/{level}")
    drawn = tuple(f"labyrinth/{level}" for level in LEVELS)
    return [
        Group(tuple(levels), task, drawn if task == _goal("uniform") else ())
        for (task, _), levels in alike.items()
    ]


def _gridworld_task(level: str) -> str:
    where = "20 other maps, which nobody trains on" if level == "fresh" else "20 maps"
    return f"Walk to the object that the corner shows, in one of {where}."


def _playroom_task(level: str) -> str:
    found = PLAYROOM[level]
    toys = f"the named one of {found.others + 1} toys"
    if found.finding:
        return f"Go to {toys}."
    if found.tasks == (LIFT,):
        return f"Lift {toys}{', in a room with bed and tray' if found.furnished else ''}."
    return f"Put {toys} {'near' if NEAR in found.tasks else 'on'} the bed or the tray, as told."


def _goal(level: str) -> str:
    """The goal of a level of the labyrinth, from the docstring of its rules."""
    if level not in LEVELS:
        return f"One of the {len(LEVELS)} tasks above, drawn at every reset."
    goal = re.search(r"Goal: (.*?)\n\n", inspect.getdoc(LEVELS[level].load()) or "", re.DOTALL)
    assert goal is not None, level
    words = " ".join(goal[1].split())
    return words[0].upper() + words[1:]


def gallery(family: str) -> list[str]:
    """Three pictures a row, each with the levels that look so and their task."""
    cells = []
    for group in groups(family):
        names = "<br>".join(code(level) for level in group.levels)
        picture = f"![{group.task}](gallery/{group.file})"
        cells.append(f"{picture}<br>{names}<br>{group.task}")
    cells += [""] * (-len(cells) % 3)
    return markdown(("", "", ""), (tuple(cells[k : k + 3]) for k in range(0, len(cells), 3)))


def labyrinth() -> list[str]:
    """The labyrinth's levels: length and, from the docstrings of their rules, goal and rewards."""
    rows = []
    for name, level in LEVELS.items():
        text = inspect.getdoc(level.load()) or ""
        rewards = re.search(r"\nRewards: (.*?)(?:\n\w[\w ,]*:|$)", text, re.DOTALL)
        told = " ".join(rewards[1].split()) if rewards else "+1 for a mushroom."
        rows.append((code(name), _goal(name), told, f"{level.seconds} s"))
    return markdown(("Level", "Goal", "Rewards", "Length"), rows)


def labyrinth_baselines() -> list[str]:
    """What policies that do not learn, and people, score in the labyrinth."""
    names = [one.name for one in envs.BASELINES if one.name in _labyrinth.baselines]
    rows = []
    for name, level in LEVELS.items():
        known = {of: envs.baseline(of, f"labyrinth/{name}") for of in names}
        texts = (
            "" if one is None else f"{one.score:.1f} ± {one.error:.1f}" for one in known.values()
        )
        shown = code(name) + (f" {LITTLE}" if _says_little(known, level.random) else "")
        published = f"{level.random:g}", f"{level.human:g}"
        rows.append((shown, *published, *texts, _policy(known)))
    titles = (one.title for one in envs.BASELINES if one.name in names)
    header = ("Level", "Random, published", "Human, published", *titles, "Blind policy")
    return [*markdown(header, rows), *LEGEND]


def constructor_options(family: str) -> list[str]:
    """Defaults of a family's options, with the sources that stand beside them in the code."""
    options = envs.find_family(family).options_class
    sources = comments(options)
    return markdown(
        ("Option", "Default", "Source"),
        (
            (code(name), code(str(field.get_default(call_default_factory=True))), sources[name])
            for name, field in options.model_fields.items()
        ),
    )
