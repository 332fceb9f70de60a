"""Families of levels, and the registry of all of them.

A level is its family's name and its own, for instance `gridworld/zipf_2` or
`playroom/lift/lift_shape_uniform`. Whatever walks all families, levels or splits asks here:

    for family in zipf.envs.families().values():
        for split in family.splits: ...

A family of your own needs a batch of envs (`ZipfVectorEnv`) and one call:

    zipf.envs.register(Family(name="bandit", levels=("zipf_2", "uniform", "rare"), ...))
"""

from __future__ import annotations

import importlib
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property, partial
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, Literal, Protocol, get_args

import gymnasium as gym
import numpy as np
from numpy.typing import NDArray

from zipf.envs.arguments import unknown
from zipf.envs.baselines import BaselineScore
from zipf.envs.splits import Level, Levels, Split, SplitLevel, level_name, split_levels
from zipf.options import Options
from zipf.protocol import BASELINE_NAMES

if TYPE_CHECKING:
    from zipf.envs.goals import Goal
    from zipf.envs.keyboard import Keys
    from zipf.envs.tensor import TensorEnv
    from zipf.envs.vector import ZipfVectorEnv

BoundPolicy = Callable[[], NDArray[np.int64]]
"""A scripted policy of a batch of envs: called, it gives actions [N]."""

Scripted = Literal["expert", "generalist"]
SCRIPTED: tuple[Scripted, ...] = get_args(Scripted)
"""The fields of a `Family` that are scripted policies."""


class NoOptions(Options):
    """A family without constructor options."""


class Symmetries(Protocol):
    """Ways to show envs otherwise, such as turned or in a mirror.

    Attributes:
        count: how many there are. Number 0 changes nothing.
        actions: int64 [count, actions]; row `k` is a permutation, which maps each action of an
            agent that sees the env under symmetry `k` to the action in the unchanged env.
    """

    count: int
    actions: NDArray[np.int64]

    def __call__(
        self, observation: dict[str, NDArray], which: NDArray[np.int64], mask: NDArray[np.bool_]
    ) -> None:
        """Shows the observations `{name: [N, ...]}` where `mask` [N] is set, in place, in the ways
        that `which` [N] names."""
        ...


@dataclass(frozen=True, kw_only=True)
class Family:
    """Everything that the rest of the program asks of a family of levels.

    Fields that are functions, classes or tables may also be given as `"module:attribute"`, which
    is imported when it is first used: registering a family then costs nothing.

    Attributes:
        name: unique; levels are called `<name>/<level>`.
        summary: what the envs are, a few words for help and tables.
        levels: names of the levels, without the family's; see `check`.
        make_vec: makes a batch: `make_vec(num_envs, level=..., autoreset_mode=..., copy=...,
            render_mode=..., **options)`, with the level's name without the family's.
        options: class of the constructor options, with the benchmark's values as defaults.
        splits: the benchmarks of the family.
        make: makes one env: `make(level=..., render_mode=..., **options)`; None: a batch of one.
        id: the Gymnasium id; None: the family is not registered with Gymnasium.
        image_changes: what has changed in the images, a few words for each change; agents that were
            trained before one see other images since. There are as many as the number in `id` says.
        check: raises ValueError for a name that is not a level; None: those in `levels` are.
        baselines: scores of policies that do not learn, by the name that the policy has in
            `zipf.protocol.BASELINES`: "chance" is of uniformly random actions, "blind" the best
            that is known of policies that are not told what an episode asks for,
            "generalist" and "expert" of scripted policies. Each is a function:
            `function(level, **options)` gives a `BaselineScore`, or None where it is not known.
            Baselines that are known of no level are left out.
        appearance: names of options that change what is shown and nothing else; the functions in
            `baselines` are not told of them.
        keys: what a keyboard's keys do, for `zipf.play`; None: nobody can play by hand.
        expert: `expert(env)` is a scripted policy of a batch that reads the state of its envs;
            None: there is none.
        blind_policies: by name, `policy(env)` is a scripted policy of a batch that does not read
            what an episode asks for; `zipf.envs.floors` tries them beside those that act without
            a look.
        generalist: `generalist(env)` is a scripted policy of a batch that knows of each env what
            has been in view in the episode, and no map. It may be called at any time on envs in
            which another policy acts, leaves them as they are, and gives the same actions again
            where they have not moved. None: there is none.
        questions: `questions(split)` is a variant of a split whose episodes are questions about
            their first frame, for agents that answer and do not act (raises ValueError where there
            is none); None: there is none.
        symmetries: `symmetries(observations, actions)`, of the spaces of one env, makes the ways
            in which all its envs may be shown otherwise without changing what is right, see
            `Symmetries`; None: there are none.
        goal: `goal(env)` is the `zipf.envs.goals.Goal` of a batch: it reads from observations what
            an episode asks for; None: they do not say.
        sliceable: whether several threads or processes may step its envs, see `zipf.envs.slices`.
        tensor: makes a batch that a PyTorch device steps, a `zipf.envs.tensor.TensorEnv`:
            `tensor(num_envs, level=..., device=..., **options)`, of the same levels and options as
            `make_vec`; None: there is none.
    """

    name: str
    summary: str
    levels: tuple[str, ...]
    make_vec: Callable[..., ZipfVectorEnv] | str
    options: type[Options] | str = NoOptions
    splits: tuple[Split, ...] = ()
    make: Callable[..., gym.Env] | str | None = None
    id: str | None = None
    image_changes: tuple[str, ...] = ()
    check: Callable[[str], object] | str | None = None
    baselines: Mapping[str, Callable[..., BaselineScore | None] | str] = field(
        default_factory=dict, hash=False
    )
    appearance: frozenset[str] = frozenset()
    keys: Keys | str | None = None
    expert: Callable[[Any], BoundPolicy] | str | None = None
    blind_policies: Mapping[str, Callable[[Any], BoundPolicy] | str] = field(
        default_factory=dict, hash=False
    )
    generalist: Callable[[Any], BoundPolicy] | str | None = None
    questions: Callable[[Split], Split] | str | None = None
    symmetries: Callable[[Any, Any], Symmetries] | str | None = None
    goal: Callable[[Any], Goal] | str | None = None
    sliceable: bool = False
    tensor: Callable[..., TensorEnv] | str | None = None

    @cached_property
    def options_class(self) -> type[Options]:
        """The class of the constructor options."""
        return _loaded(self.options)

    @property
    def split_names(self) -> tuple[str, ...]:
        """The names of the splits, for a list of them: `<family>_<level>` stands for those of one
        level alone."""
        alone = {f"{self.name}_{level}" for level in self.levels}
        pattern = f"{self.name}_<level>"
        names = (
            pattern if one.only_trains and one.name in alone else one.name for one in self.splits
        )
        return tuple(dict.fromkeys(names))

    def check_level(self, name: str) -> None:
        """Raises ValueError if this name, without the family's, is not a level."""
        if self.check is not None:
            _loaded(self.check)(name)
        elif name not in self.levels:
            raise unknown(f"{self.name} level", name, self.levels)

    def check_options(self, given: Iterable[str], *more: str) -> None:
        """Raises ValueError for a name that is neither a constructor option nor one of `more`, if
        the family declares options."""
        if self.options is NoOptions:
            return
        known = (*self.options_class.model_fields, *more)
        for name in given:
            if name not in known:
                raise unknown(f"{self.name} option", name, known)

    def make_batch(self, level: str, num_envs: int, **kwargs: Any) -> ZipfVectorEnv:
        """`num_envs` envs of a level, named without the family's name."""
        self.check_options(kwargs, "autoreset_mode", "copy", "render_mode")
        return self.load_make_vec()(num_envs, level=level, **kwargs)

    def load_make_vec(self) -> Callable[..., ZipfVectorEnv]:
        """What `make_vec` is, imported where it is a name."""
        return _loaded(self.make_vec)

    def make_single(self, level: str, **kwargs: Any) -> gym.Env:
        """One env of a level, named without the family's name."""
        self.check_options(kwargs, *(["copy"] if self.make is None else []), "render_mode")
        if self.make is not None:
            return _loaded(self.make)(level=level, **kwargs)
        from zipf.envs.single import SingleEnv

        return SingleEnv(_loaded(self.make_vec), level=level, **kwargs)

    def loaded_blind_policies(self) -> dict[str, Callable[[Any], BoundPolicy]]:
        """The family's own policies that do not read, by name."""
        return {name: _loaded(policy) for name, policy in self.blind_policies.items()}

    def make_goal(self, env: ZipfVectorEnv) -> Goal | None:
        """What reads the goals of a batch of the family from its observations; None: nothing."""
        return None if self.goal is None else _loaded(self.goal)(env)

    def register_with_gymnasium(self) -> None:
        """Makes `gymnasium.make(id, level=...)` and `gymnasium.make_vec` work."""
        if self.id is None:
            return
        make: Any = self.make or self.make_single
        gym.register(
            id=self.id, entry_point=make, vector_entry_point=f"zipf.envs.registered:{self.name}"
        )


OURS = ("gridworld", "playroom", "labyrinth")
"""The families of this package, each a package of its name in `zipf.envs`."""

_FAMILIES: dict[str, Family] = {}


def register(family: Family) -> Family:
    """Adds a family: its levels, its splits and its Gymnasium id; returns it.

    Raises:
        ValueError: a family or a split of that name is there already or twice, a name cannot be
            part of a level's name, a field is of another kind, it has an unknown baseline, or
            Gymnasium does not take the id.
            Nothing is registered then.
    """
    _check_fields(family)
    if family.name in _FAMILIES:
        raise ValueError(
            f"there is a family {family.name!r} already: give another name, or restart Python"
        )
    splits = [*all_splits(), *(split.name for split in family.splits)]
    for split in family.splits:
        if splits.count(split.name) > 1:
            raise ValueError(f"there is a split {split.name!r} already")
    for name in family.baselines:
        _check_baseline(name)
    if family.id in gym.registry:
        raise ValueError(f"Gymnasium has an environment {family.id!r} already")
    try:
        family.register_with_gymnasium()
    except (gym.error.Error, TypeError) as error:
        raise ValueError(f"Gymnasium does not take the id {family.id!r}: {error}") from None
    _FAMILIES[family.name] = family
    return family


def _check_fields(family: Family) -> None:
    """Raises ValueError for fields that are not of the kind that `Family` says."""
    check_name(family.name)
    for field_name, kind in (("levels", str), ("splits", Split)):
        value = getattr(family, field_name)
        if not isinstance(value, tuple) or not all(isinstance(one, kind) for one in value):
            raise ValueError(
                f"{field_name} of a family must be a tuple of {kind.__name__}, got {value!r}"
            )
    for field_name, value in {**vars(family), **family.baselines}.items():
        texts = ("name", "summary", "id")
        if field_name not in texts and isinstance(value, str) and not all(value.partition(":")):
            raise ValueError(
                f"{field_name} of a family must be an object or 'module:attribute', got {value!r}"
            )


def check_name(name: Any) -> None:
    """Raises ValueError for what cannot be a family's name."""
    if not isinstance(name, str) or not name or "/" in name:
        raise ValueError(f"a family's name must be a string, not empty, without '/'; got {name!r}")


def families() -> Mapping[str, Family]:
    """All families by name, in the order in which they were registered."""
    return MappingProxyType(_FAMILIES)


def find_family(name: str) -> Family:
    """The family of this name. Raises ValueError for an unknown one."""
    return _named("family", name, _FAMILIES)


def all_splits() -> dict[str, Split]:
    """All splits of all families by name."""
    return {split.name: split for family in _FAMILIES.values() for split in family.splits}


def split(name: str) -> Split:
    """The split of this name. Raises ValueError for an unknown one."""
    return _named("split", name, all_splits())


def family_of_split(name: str) -> Family:
    """The family that a split belongs to. Raises ValueError for an unknown split."""
    split(name)
    return next(f for f in _FAMILIES.values() if any(s.name == name for s in f.splits))


def find_level(level: str) -> tuple[Family, str]:
    """The family of a level's full name, and the level's name within it.

    Raises:
        ValueError: there is no such level; names the nearest.
    """
    if not isinstance(level, str):
        raise ValueError(f"a level must be a name such as 'gridworld/zipf_2', got {level!r}")
    prefix, _, name = level.partition("/")
    found = _FAMILIES.get(prefix)
    twice = found is not None and name.startswith(f"{prefix}/") and name not in found.levels
    if found is None or not name or twice:
        known = [f"{one.name}/{name}" for one in _FAMILIES.values() for name in one.levels]
        raise unknown("level", level, known)
    found.check_level(name)
    return found, name


def make(level: str, **kwargs: Any) -> gym.Env:
    """One env of a level; `kwargs` are its family's constructor options and `render_mode`.

    Raises:
        ValueError: for an unknown level, or options out of range.
    """
    found, name = find_level(level)
    return found.make_single(name, **kwargs)


def make_vec(
    level: Level | SplitLevel | Sequence[Level | SplitLevel],
    num_envs: int,
    *,
    threads: int = 1,
    processes: int | None = None,
    **kwargs: Any,
) -> ZipfVectorEnv:
    """`num_envs` envs of a level that step together.

    Args:
        level: a full name, or what a `Split` may hold in a name's place. Several levels share the
            envs evenly, see `Mixture`.
        num_envs: number of envs N.
        threads: how many step the envs, where these are `sliceable`, see `zipf.envs.slices`.
        processes: the same with processes in the place of threads, see `zipf.envs.processes`;
            None: this one.
        kwargs: `autoreset_mode`, `copy`, `render_mode` and constructor options; a `SplitLevel`'s
            own options go before those.

    Raises:
        ValueError: for an unknown level, or options out of range.
    """
    if threads != 1 or processes is not None:
        make = partial(_rows_of, level)
        return _sliced(make, level, num_envs, threads, processes, **kwargs)
    if isinstance(level, str):
        found, name = find_level(level)
        return found.make_batch(name, num_envs, **kwargs)
    if isinstance(level, SplitLevel):
        return make_vec(level.level, num_envs, **{**kwargs, **level.options})
    if callable(level):
        return level(num_envs, **kwargs)
    if not isinstance(level, Sequence):
        raise ValueError(
            "a level must be a name such as 'gridworld/zipf_2', a function that makes a batch, or "
            f"a list of these; got {level!r}"
        )
    return _mixture(level, num_envs, **kwargs)


def _sliced(
    make: Callable[..., ZipfVectorEnv],
    levels: Levels,
    num_envs: int,
    threads: int,
    processes: int | None,
    **kwargs: Any,
) -> ZipfVectorEnv:
    if processes is None:
        from zipf.envs.slices import Slices

        return Slices(make, num_envs, threads, **kwargs)
    if threads != 1:
        raise ValueError(f"threads={threads}, processes={processes}: give one of them")
    from zipf.envs.processes import Processes

    named = (one.level for one in split_levels(levels))
    found = (find_level(one)[0] for one in named if isinstance(one, str))
    registered = {one.name: one for one in found if one.name not in OURS}
    make = partial(_made_of, tuple(registered.values()), make)
    return Processes(make, num_envs, processes, **kwargs)


def _made_of(
    registered: tuple[Family, ...],
    make: Callable[..., ZipfVectorEnv],
    rows: slice,
    num_envs: int,
    **kwargs: Any,
) -> ZipfVectorEnv:
    """What `make` makes, in a process that knows the package's own families only."""
    for family in registered:
        if family.name not in _FAMILIES:
            register(family)
    return make(rows, num_envs, **kwargs)


def _rows_of(
    level: Level | SplitLevel | Sequence[Level | SplitLevel],
    rows: slice,
    num_envs: int,
    **kwargs: Any,
) -> ZipfVectorEnv:
    """These rows of what `make_vec` makes."""
    count = rows.stop - rows.start
    if isinstance(level, str | SplitLevel) or not isinstance(level, Sequence):
        return make_vec(level, count, **kwargs)
    from zipf.envs.mixture import shared

    if kwargs.get("draw", "worlds") != "worlds":
        return _mixture(level, count, **kwargs)
    levels = shared(_names(level), num_envs)[rows]
    return _mixture(level, count, levels_of_envs=levels, **kwargs)


def _rows_drawn(
    levels: Sequence[SplitLevel],
    probabilities: Sequence[float],
    rows: slice,
    num_envs: int,
    **kwargs: Any,
) -> ZipfVectorEnv:
    return _mixture(levels, rows.stop - rows.start, probabilities, **kwargs)


def sliceable(split: Split) -> bool:
    """Whether several threads or processes can step the envs that `make_train` makes of a split."""

    def one(level: Level | SplitLevel) -> bool:
        if isinstance(level, SplitLevel):
            return one(level.level)
        return isinstance(level, str) and find_level(level)[0].sliceable

    return all(map(one, split.train))


def make_train(
    split: Split,
    num_envs: int,
    *,
    threads: int = 1,
    processes: int | None = None,
    **kwargs: Any,
) -> ZipfVectorEnv:
    """The envs to train on, as the split shares them among its train levels; the arguments are
    those of `make_vec`.

    Raises:
        ValueError: options that a level cannot have, or fewer envs than levels to share them.
    """
    if split.draw == "worlds":
        levels = split.train if len(split.train) > 1 else split.train[0]
        return make_vec(levels, num_envs, threads=threads, processes=processes, **kwargs)
    ranked = _ranked(split)
    trained = {level.name: level.weight for level in split.train}
    drawn = ranked, [trained.get(one.name, 0.0) for one in ranked]
    if threads != 1 or processes is not None:
        make = partial(_rows_drawn, *drawn)
        return _sliced(make, ranked, num_envs, threads, processes, **kwargs)
    return _mixture(drawn[0], num_envs, drawn[1], **kwargs)


def has_tensor(split: Split) -> bool:
    """Whether `make_tensor` makes the envs that a split trains on."""
    if split.draw == "resets" or len(split.train) > 1:
        return False
    level = split.train[0].level
    return isinstance(level, str) and find_level(level)[0].tensor is not None


def make_tensor(
    level: Split | SplitLevel | Level, num_envs: int, device: Any, **options: Any
) -> TensorEnv:
    """`num_envs` envs of a level as tensors, which a PyTorch device steps.

    Args:
        level: a split, whose train level is meant; or a level, by its full name or as a split
            holds it.
        num_envs: number of envs N.
        device: where they are, a `torch.device` or its name.
        options: constructor options; a `SplitLevel`'s own go before those.

    Raises:
        ValueError: the level's family has no tensor environments, the split trains on several
            levels; an unknown level, options out of range, or a device that there is not.
    """
    if isinstance(level, Split):
        if level.draw == "resets" or len(level.train) > 1:
            raise ValueError(
                f"a tensor environment plays one level, and split {level.name!r} of the family "
                f"{family_of_split(level.name).name} draws among {len(_ranked(level))}"
            )
        return make_tensor(level.train[0], num_envs, device, **options)
    if isinstance(level, SplitLevel):
        return make_tensor(level.level, num_envs, device, **{**options, **level.options})
    if not isinstance(level, str):
        raise ValueError(
            f"a tensor environment plays a level of a family, got the function {level_name(level)}"
        )
    found, name = find_level(level)
    if found.tensor is None:
        known = [one.name for one in _FAMILIES.values() if one.tensor is not None]
        raise ValueError(
            f"the family {found.name} has no tensor environments: expected a level of "
            f"{' or '.join(known)}, got {level!r}"
        )
    found.check_options(options)
    return _loaded(found.tensor)(num_envs, level=name, device=device, **options)


def make_scored(split: Split, level: SplitLevel, num_envs: int, **kwargs: Any) -> ZipfVectorEnv:
    """Envs of one level of a split, to score an agent on.

    Where levels are drawn at resets these are envs of the same mixture in which only this level
    is drawn, so that situations have its rank in training and its name. Levels that are not trained
    on have the ranks after those.

    Raises:
        ValueError: options that a level cannot have.
    """
    if split.draw == "worlds":
        return make_vec(level, num_envs, **kwargs)
    ranked = [level if one.name == level.name else one for one in _ranked(split)]
    only = [float(one.name == level.name) for one in ranked]
    return _mixture(ranked, num_envs, only, **kwargs)


def ranks_of(split: Split, **kwargs: Any) -> dict[str, int]:
    """The ranks of the situations of a split's levels, with how many each has: the most of any
    level. The constructor options are those of `make_scored`, as are the errors."""
    levels = _ranked(split)
    ranks: dict[str, int] = {}
    for level in levels if split.draw == "worlds" else levels[:1]:
        env = make_scored(split, level, 1, **kwargs)
        env.close()
        for name, size in env.situation.items():
            ranks[name] = max(size, ranks.get(name, 0))
    return ranks


def _ranked(split: Split) -> list[SplitLevel]:
    """All levels of a split, each once: the train levels from the most frequent on, then others."""
    levels = {one.name: one for one in sorted(split.train, key=lambda level: -level.weight)}
    for one in split.all_levels:
        levels.setdefault(one.name, one)
    return list(levels.values())


def _mixture(
    levels: Sequence[Level | SplitLevel],
    num_envs: int,
    probabilities: Sequence[float] | None = None,
    **kwargs: Any,
) -> ZipfVectorEnv:
    from zipf.envs.mixture import Mixture

    makers = dict(zip(_names(levels), (partial(make_vec, one) for one in levels), strict=True))
    if len(makers) < len(levels):
        raise ValueError(f"a mixture has every level once, got {', '.join(map(str, levels))}")
    if probabilities is None:
        return Mixture(makers, num_envs, **kwargs)
    return Mixture(makers, num_envs, draw="resets", probabilities=probabilities, **kwargs)


def _names(levels: Sequence[Level | SplitLevel]) -> list[str]:
    return [one.name if isinstance(one, SplitLevel) else level_name(one) for one in levels]


def baseline(name: str, level: Level | SplitLevel, /, **kwargs: Any) -> BaselineScore | None:
    """The mean return of a policy that does not learn on a level, exact or measured.

    Args:
        name: "chance", "blind", "generalist" or "expert", see `zipf.protocol.BASELINES`.
        level: a full level name, or what a `Split` may hold in its place. A function that makes a
            level may know baselines itself: `level.baseline(name, **options)`.
        kwargs: constructor options as for `make` and `make_vec`.

    Returns:
        The mean return, or None if it is not known for the level with these options.

    Raises:
        ValueError: for an unknown baseline, level or option.
    """
    _check_baseline(name)
    if isinstance(level, SplitLevel):
        return baseline(name, level.level, **{**kwargs, **level.options})
    for ignored in ("render_mode", "copy", "autoreset_mode"):
        kwargs.pop(ignored, None)
    if not isinstance(level, str):
        known = getattr(level, "baseline", None)
        return None if known is None else known(name, **kwargs)
    found, own = find_level(level)
    found.check_options(kwargs)
    if name not in found.baselines:
        return None
    options = {key: value for key, value in kwargs.items() if key not in found.appearance}
    return _loaded(found.baselines[name])(own, **options)


def _check_baseline(name: str) -> None:
    if name not in BASELINE_NAMES:
        raise unknown("baseline", name, BASELINE_NAMES)


def keys(level: str) -> Keys | None:
    """What a keyboard's keys do on a level; None in a family that has none.

    Raises:
        ValueError: for an unknown level.
    """
    found, _ = find_level(level)
    return _loaded(found.keys)


def expert(level: str, env: ZipfVectorEnv) -> BoundPolicy | None:
    """A scripted policy that reads the state of envs which `make_vec` made of a level.

    The arguments and the rest are those of `scripted`.
    """
    return scripted("expert", level, env)


def generalist(level: str, env: ZipfVectorEnv) -> BoundPolicy | None:
    """A scripted policy that knows of envs what has been in view in the episode, see `Family`.

    The arguments and the rest are those of `scripted`.
    """
    return scripted("generalist", level, env)


def scripted(name: Scripted, level: str, env: ZipfVectorEnv) -> BoundPolicy | None:
    """A scripted policy of envs that `make_vec` made of a level; None in a family without one.

    Args:
        name: which one, of `SCRIPTED`.
        level: the level's full name.
        env: the envs.

    Raises:
        ValueError: for an unknown policy or level, or envs that the policy cannot play.
    """
    _named("scripted policy", name, dict.fromkeys(SCRIPTED))
    found, _ = find_level(level)
    _check_batch(f"the {name} plays", env)
    make = getattr(found, name)
    if make is None:
        return None
    from zipf.envs.slices import SlicedPolicy, Slices

    policy = _loaded(make)
    return SlicedPolicy(env, policy) if isinstance(env, Slices) else policy(env)


def goal(level: str, env: ZipfVectorEnv) -> Goal | None:
    """The `Goal` of envs that `make_vec` made of a level: it reads from observations what an
    episode asks for. None if the family defines no goals.

    Raises:
        ValueError: for an unknown level, or envs that `make_vec` did not make.
    """
    found, _ = find_level(level)
    _check_batch("a goal is of", env)
    return found.make_goal(env)


def _check_batch(what: str, env: Any) -> None:
    from zipf.envs.vector import ZipfVectorEnv

    if not isinstance(env, ZipfVectorEnv):
        raise ValueError(f"{what} what make_vec makes, got {type(env).__name__}")


def questions(split: Split) -> Split:
    """The variant of a split whose episodes are questions about their first frame.

    Raises:
        ValueError: there is none.
    """
    found = family_of_split(split.name)
    if found.questions is None:
        raise ValueError(f"there are no questions about the first frames of {found.name}")
    return _loaded(found.questions)(split)


def symmetries(split: Split, env: ZipfVectorEnv | TensorEnv) -> Symmetries | None:
    """The symmetries that the family of a split declares, for its envs; None where there are
    none."""
    found = family_of_split(split.name)
    if found.symmetries is None:
        return None
    return _loaded(found.symmetries)(env.single_observation_space, env.single_action_space)


def _loaded(value: Any) -> Any:
    """A field of a `Family`: itself, or what `"module:attribute"` names."""
    if not isinstance(value, str):
        return value
    module, _, attribute = value.partition(":")
    return getattr(importlib.import_module(module), attribute)


def _named(kind: str, name: str, known: Mapping[str, Any]) -> Any:
    if not isinstance(name, str):
        raise ValueError(f"a {kind} must be a name, got {name!r}")
    if name not in known:
        raise unknown(kind, name, known)
    return known[name]
