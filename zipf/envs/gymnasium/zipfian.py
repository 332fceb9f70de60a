"""Zipfian families of existing Gymnasium environments."""

import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from enum import Enum
from functools import partial
from itertools import takewhile
from typing import Any

import numpy as np

from zipf.envs import distributions
from zipf.envs.arguments import mapping
from zipf.envs.baselines import BaselineScore
from zipf.envs.family import Family, check_name
from zipf.envs.gymnasium.vector import GymnasiumVectorEnv
from zipf.envs.mixture import Mixture, ordered
from zipf.envs.splits import Split
from zipf.envs.vector import ZipfVectorEnv, rank_name
from zipf.options import Options

LONGEST_NAME = 100  # ours: characters of the text of an option's value
_ENV_OPTIONS = (
    "wrap",
    "codes",
    "image_axes",
    "success",
    "text_length",
    "cut_texts",
    "vocabulary",
    "longest_episode",
)


def zipfian(
    ids: str | Sequence[str],
    *,
    exponent: float = 1.0,
    over: Mapping[str, Iterable[Any]] | None = None,
    order: str | int = "forward",
    name: str | None = None,
    chance: Mapping[str, BaselineScore] | None = None,
    options: Mapping[str, Any] | None = None,
    **envs: Any,
) -> Family:
    """A family of existing environments of which one is drawn at every reset.

        family = zipfian(["MiniGrid-DoorKey-5x5-v0", "MiniGrid-Empty-8x8-v0", ...], exponent=1)
        family = zipfian("MyEnv-v0", over={"goal": range(50)}, exponent=2)
        zipf.envs.register(family)

    Its environments, ranked by `order`, are drawn from Zipf's law on level `zipf_<exponent>` (of
    any exponent >= 0), all alike on `uniform`, and from the rarest fifth on `rare`. Each of them is
    a level of its own, too: `<family>/MiniGrid-DoorKey-5x5-v0`, or `<family>/goal_3`, after the
    value's text. Where a value has no text of its own, of one line and at most 100 characters, as
    arrays, functions and other objects have none, all are called after their ranks. The family has
    one split, of its own name, that trains on `zipf_<exponent>`.

    The situation of an episode is the rank of its environment: `info["level"]`, with its name in
    `info["level_name"]`; with `over` both are called after the option, `info["goal"]` and
    `info["goal_name"]`. Observations are equal in kind for all environments, and do not tell which
    it is unless the environment's own do.

    Args:
        ids: Gymnasium ids, from the most frequent on; or one id, with `over`.
        exponent: of the training level.
        over: the name of one option of the environment and its values, from the most frequent on.
            The rank has this name, so it is none that `ZipfVectorEnv` reserves.
        order: "forward", "reversed", or an integer that seeds a shuffle; see `Mixture`.
        name: the family's; None: made from what the ids have in common, `minigrid` in the example.
        chance: measured chance by level name, without the family's, as `measure_chance` returns it.
        options: arguments of `gymnasium.make` for all environments.
        envs: further arguments of `GymnasiumVectorEnv`: `wrap`, `codes`, `image_axes`, `success`,
            `text_length`, `cut_texts`, `vocabulary`, `longest_episode`.

    Returns:
        The family, not registered.

    Raises:
        ValueError: fewer than five environments, one of them twice, `over` missing or with several
            ids, a reserved name in `over`, an environment named like a distribution, no name that
            fits, chance of an unknown level, or unknown arguments or ones of another kind.
    """
    rank = "level"
    options = mapping("options", options)
    chance = mapping("chance", chance)
    if unknown := sorted(envs.keys() - set(_ENV_OPTIONS)):
        raise ValueError(f"unknown arguments {unknown}: expected some of {', '.join(_ENV_OPTIONS)}")
    if isinstance(ids, str):
        if not isinstance(over, Mapping) or len(over) != 1:
            raise ValueError(
                f"zipfian({ids!r}) needs over={{option: values}} with one option of the "
                f"environment, got over={over}; or give a list of ids"
            )
        ((rank, values),) = over.items()
        rank_name("over: an option that is a rank", rank)
        values = _listed(f"over: the values of {rank!r}", values)
        own = zip(_texts(values, order), values, strict=True)
        given = [(f"{rank}_{text}", ids, {rank: value}) for text, value in own]
        ids = [ids]
    else:
        ids = _listed("ids", ids)
        if not all(isinstance(id, str) for id in ids):
            raise ValueError(f"ids must be Gymnasium ids, which are strings, got {ids}")
        if over is not None:
            raise ValueError(f"over={over} needs a single id, got {len(ids)}")
        given = [(_without_module(id), id, {}) for id in ids]
    makers = {
        level: partial(GymnasiumVectorEnv, id=id, options={**options, **own}, **envs)
        for level, id, own in given
    }
    if len(makers) < len(given):
        names = [level for level, _, _ in given]
        twice = sorted({level for level in names if names.count(level) > 1})
        raise ValueError(f"a family has every environment once, got {', '.join(twice)} twice")
    if len(makers) < 5:
        raise ValueError(
            "a family needs at least five environments, or its rarest fifth is empty: "
            f"got {len(makers)}"
        )
    if taken := [level for level in makers if _is_distribution(level)]:
        raise ValueError(
            f"environments cannot be called {', '.join(taken)}, as levels of distributions are: "
            "register them with Gymnasium under another id or with another option"
        )
    trained = distributions.law_name(exponent)
    ordered(len(makers), order)  # refuses a bad order now rather than when a batch is made
    name = _common_name(ids) if name is None else name
    check_name(name)
    levels = _Levels(makers, order, rank)
    for level, score in chance.items():
        levels.check(level)
        if (usual := distributions.usual_name(level)) != level:
            raise ValueError(f"chance has the level {level!r}: expected its usual name {usual!r}")
        if not isinstance(score, BaselineScore):
            raise ValueError(f"chance of {level!r} must be a BaselineScore, got {score!r}")
    return Family(
        name=name,
        options=_Options,
        summary=f"{len(makers)} environments of Gymnasium, one drawn at every reset",
        levels=(trained, "uniform", "rare", "validation", *makers),
        check=levels.check,
        make_vec=levels.make_vec,
        splits=(
            Split(
                name,
                f"{name}/{trained}",
                f"{name}/uniform",
                f"{name}/rare",
                validation=f"{name}/validation",
            ),
        ),
        baselines={"chance": partial(_known, chance)},
    )


class _Options(Options):
    """The families have no constructor options: an unknown one is an error."""


@dataclass(frozen=True)
class _Levels:
    """The levels of a family.

    Attributes:
        makers: what makes a batch of each environment, by level name.
        order: see `Mixture`.
        rank: name of the environments' rank.
    """

    makers: Mapping[str, Callable[..., ZipfVectorEnv]]
    order: str | int
    rank: str

    def check(self, level: str) -> None:
        """Raises ValueError for a name that is not a level."""
        if level not in self.makers:
            try:
                distributions.by_name(level)
            except ValueError as error:
                raise ValueError(f"{error}, or one of {', '.join(self.makers)}") from None

    def make_vec(self, num_envs: int, level: str, **kwargs: Any) -> ZipfVectorEnv:
        self.check(level)
        if level in self.makers:
            return self.makers[level](num_envs, **kwargs)
        return Mixture(
            self.makers,
            num_envs,
            draw="resets",
            probabilities=distributions.by_name(level)(len(self.makers)),
            order=self.order,
            rank=self.rank,
            **kwargs,
        )


def _known(scores: Mapping[str, BaselineScore], level: str, **options: Any) -> BaselineScore | None:
    return None if options else scores.get(distributions.usual_name(level))


def _listed(what: str, values: Any) -> list[Any]:
    """Values in an order, as a list.

    Raises ValueError for something else.
    """
    unordered = isinstance(values, str | bytes | Mapping | set | frozenset)
    if unordered or not isinstance(values, Iterable):
        raise ValueError(f"{what} must be a list, from the most frequent on, got {values!r}")
    return list(values)


def _texts(values: Sequence[Any], order: str | int) -> list[str]:
    """What the values of an option are called: their texts, or, where one of them has none of its
    own, their ranks. A text of its own is short, of one line, and the same in every process.

    Raises ValueError for a bad order.
    """
    texts = [str(value) for value in values]
    if all(len(text) <= LONGEST_NAME and text.isprintable() for text in texts) and all(
        map(_has_text, values)
    ):
        return texts
    return [str(rank) for rank in np.argsort(ordered(len(values), order)).tolist()]


def _has_text(value: Any) -> bool:
    """Whether a value's text tells it: an object's may be its place in memory, the text of a set
    differs between processes, and that of an array leaves digits out."""
    if isinstance(value, Mapping):
        return all(_has_text(one) for one in (*value.keys(), *value.values()))
    if isinstance(value, list | tuple):
        return all(map(_has_text, value))
    return value is None or isinstance(value, str | bool | int | float | np.generic | Enum)


def _is_distribution(level: str) -> bool:
    try:
        distributions.by_name(level)
    except ValueError:
        return False
    return True


def _without_module(id: str) -> str:
    return id.rpartition(":")[2]


def _common_name(ids: Sequence[str]) -> str:
    """The words that all ids begin with, in lower case.

    Raises ValueError if there are none.
    """
    words = [re.split(r"\W+", re.sub(r"-v\d+$", "", _without_module(id))) for id in ids]
    alike = takewhile(lambda places: len(set(places)) == 1, zip(*words, strict=False))
    common = "_".join(places[0].lower() for places in alike)
    if not common:
        raise ValueError(
            f"{', '.join(ids)} have nothing in common to name the family after: give name=..."
        )
    return common
