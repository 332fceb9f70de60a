"""Checks of combinations of options: do they fit each other, the envs and this machine?"""

from __future__ import annotations

import json
import os
import sys
from collections.abc import Callable, Collection, Iterator
from pathlib import Path

import torch

from zipf import envs
from zipf.agents.agent import Agent, agents, unsupported
from zipf.agents.encoders import is_codes, number_of_codes
from zipf.agents.episodic import NO_EPISODIC
from zipf.agents.free_space import free_ram, in_words
from zipf.agents.learner import Learner
from zipf.agents.network import ActorCritic
from zipf.agents.network_options import MatchingOptions
from zipf.errors import UserError
from zipf.experiments.building import run_folder
from zipf.experiments.building.device_envs import on_device, only_on_the_host
from zipf.experiments.building.factory import build_agent
from zipf.experiments.options.runtime import RayOptions, TorchrunOptions, has_ray
from zipf.experiments.options.schema import Config, PretrainedOptions, find_device
from zipf.experiments.records.learned_options import flatten
from zipf.options import Context
from zipf.registry import registries


def problems(config: Config, coming: Collection[Path] = ()) -> Iterator[str]:
    """The problems of options that are each valid by themselves, one line each.

    `coming` are the folders of runs that will be there when this one begins."""
    if sys.platform == "win32":
        yield "training needs Linux or macOS: on Windows, run it in WSL"
    start, end = config.schedule.window
    if start > end:
        yield f"schedule.window=[{start}, {end}]: should begin before it ends"
    if decay := config.learning_rate_decay:
        if decay[0] >= decay[1]:
            yield f"learning_rate_decay={decay}: should begin before it ends"
        elif decay[1] < config.updates:
            yield (
                f"learning_rate_decay={decay}: nothing would be learned from update {decay[1]} on; "
                f"should not end before updates={config.updates}"
            )
    split = envs.split(config.environment.split)
    train = split.levels("train")
    if split.draw == "worlds" and 0 < config.num_envs < len(train):
        of_each = ", for each learner" if config.learners > 1 else ""
        yield (
            f"collector.num_envs={config.collector.num_envs}: should be at least "
            f"{len(train) * config.learners}, an env for each train level of {split.name}{of_each}"
        )
    for option in ("threads", "processes"):
        yield from _not_so_many(config, option)
    yield from _which_workers(config)
    yield from _no_parts(config)
    if config.collector.envs == "device":
        for option in only_on_the_host(config):
            yield f"collector.envs=device: {option} takes envs on the host; choose host or auto"
    agent, collector = agents()[config.agent.name], config.collector
    if config.learning_rate_decay and not issubclass(agent, Learner):
        yield (
            f"learning_rate_decay={config.learning_rate_decay}: agent={config.agent.name} has no "
            "learning rate; choose null"
        )
    parts = {
        group: getattr(config, group)
        for group, registry in registries().items()
        if not registry.several
    }
    family = envs.family_of_split(config.environment.split)
    context = Context(
        family.name,
        family.goal is not None,
        config.num_envs,
        collector.unroll_length,
        parts,
        config.updates_per_unroll,
    )
    checked = [*parts.values(), *config.loggers.values()]
    found = [line for options in checked for line in options.problems(context)]
    found += unsupported(agents()[config.agent.name], parts)
    yield from found
    if problem := _no_folder(config):
        yield f"run_root={config.run_root:.200}: {problem}"
    if agent.largest_lag < config.lag:
        yield (
            f"collector.lag={config.lag}: agent={config.agent.name} does not correct for older "
            f"weights; should be at most {agent.largest_lag}"
        )
    yield from _no_pretrained(config, coming)
    network = config.network
    fixed = isinstance(network, MatchingOptions) and network.matcher == "fixed"
    if fixed and config.pretrained.run is None:
        yield "network.matcher=fixed: keeps random weights without pretrained.run; choose learned"
    yield from _not_in_a_cluster(config)
    yield from _not_by_several_learners(config)
    try:
        find_device(config.device)
    except UserError as error:
        yield str(error)
        return  # what follows is tried on it
    yield from (line for line in _cannot_be_built(config) if line not in found)


def _no_pretrained(config: Config, coming: Collection[Path]) -> Iterator[str]:
    """Why a new run cannot begin with another's weights."""
    run = config.pretrained.run
    if run is None and config.pretrained.parts != PretrainedOptions().parts:
        yield "pretrained.parts: are of another run; give pretrained.run=<its folder>"
    if run is None or (config.folder / "checkpoint.pt").exists():
        return
    if config.pretrained.folder in coming:
        return
    try:
        folder = Path(run).expanduser()
        run_folder.read_config(folder, config.plugins)
        run_folder.agent_file(folder)
    except (UserError, RuntimeError, ValueError) as error:  # or no such home, or a zero byte
        yield f"pretrained.run={run:.200}: {error}"


def _not_in_a_cluster(config: Config) -> Iterator[str]:
    """Options that `runtime=ray` does not support."""
    if not isinstance(config.runtime, RayOptions):
        return
    if not has_ray():
        yield 'runtime=ray: needs Ray: pip install ".[ray]" in a clone of zipf'
    if agents()[config.agent.name].largest_lag == 0:
        others = [name for name, agent in agents().items() if agent.largest_lag]
        yield (
            f"runtime=ray: agent={config.agent.name} does not correct for older weights; choose "
            f"runtime=local, or agent={' or '.join(others)}"
        )
    if config.collector.lag is not None:
        yield (
            f"collector.lag={config.collector.lag}: is of runtime=local; with runtime=ray choose "
            "runtime.ahead"
        )


def _not_by_several_learners(config: Config) -> Iterator[str]:
    """What does not go with several learners."""
    if not isinstance(config.runtime, TorchrunOptions):
        return
    num_envs, learners = config.collector.num_envs, config.learners
    if num_envs % learners or num_envs < learners:
        yield (
            f"collector.num_envs={num_envs}: should be a multiple of runtime.learners={learners}, "
            "which share the envs"
        )
    if not agents()[config.agent.name].averages_gradients:
        able = [name for name, agent in agents().items() if agent.averages_gradients]
        yield (
            f"runtime=torchrun: agent={config.agent.name} does not average gradients over "
            f"learners; choose runtime=local, or agent={' or '.join(able)}"
        )
    if config.episodic != NO_EPISODIC:
        yield (
            f"episodic={config.episodic.name}: each learner would have a dictionary of its own; "
            "with runtime=torchrun choose episodic=none"
        )
    if ":" in config.device:
        yield (
            f"device={config.device}: is one for all learners; with runtime=torchrun choose "
            "device=cuda, which is another for each learner of a machine"
        )


def _not_so_many(config: Config, option: str) -> Iterator[str]:
    """Why so many threads or processes cannot step the envs."""
    count = getattr(config, option)
    if count is None or (option == "threads" and count == 1):
        return
    # macOS does not say which cores a process may use.
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count()
    if not envs.sliceable(envs.split(config.environment.split)):
        yield (
            f"{option}={count}: the envs of {config.environment.split} are stepped by one thread; "
            f"{'choose threads=1, or ' if option == 'threads' else ''}leave it out"
        )
    elif count > config.num_envs:
        of_each = ", those of each learner" if config.learners > 1 else ""
        yield f"{option}={count}: should be at most {config.num_envs}, the envs{of_each}"
    elif cores and count > cores:
        yield f"{option}={count}: should be at most {cores}, the cores that this process may use"


def _which_workers(config: Config) -> Iterator[str]:
    """Both threads and processes, or one of them where others step the envs."""
    given = [
        f"{name}={count}"
        for name in ("processes", "threads")
        if (count := getattr(config, name)) is not None
    ]
    if len(given) == 2:
        yield f"{', '.join(given)}: step the same envs; leave out one of them"
    if isinstance(config.runtime, RayOptions):
        for one in given:
            if one != "threads=1":  # as it is anyway
                yield f"{one}: with runtime=ray each actor steps its envs; leave it out"


def _no_parts(config: Config) -> Iterator[str]:
    """Why updates cannot learn from parts of unrolls."""
    envs_per_update, parts = config.collector.envs_per_update, config.updates_per_unroll
    if envs_per_update is None:
        return
    option, num_envs = f"collector.envs_per_update={envs_per_update}", config.collector.num_envs
    if num_envs % envs_per_update:
        yield f"{option}: should divide collector.num_envs={num_envs}"
        return
    if envs_per_update % config.learners:
        yield (
            f"{option}: should be a multiple of runtime.learners={config.learners}, which share "
            "the envs"
        )
    if parts == 1:
        return
    able = [name for name, agent in agents().items() if agent.learns_from_parts]
    if config.agent.name not in able:
        yield (
            f"{option}: agent={config.agent.name} learns from all envs of an unroll at once; "
            f"choose null, or agent={' or '.join(able)}"
        )
    if config.episodic != NO_EPISODIC:
        yield f"{option}: episodic={config.episodic.name} follows all envs at once; choose null"
    if isinstance(config.runtime, RayOptions):
        yield f"{option}: with runtime=ray every actor has num_envs of its own; choose null"
    counts = {
        "updates": config.updates,
        "evaluation.every": config.evaluation.every,
        "schedule.checkpoint_every": config.schedule.checkpoint_every,
    }
    for name, count in counts.items():
        if count % parts:
            yield f"{name}={count}: should be a multiple of {parts}, the updates of an unroll"


def too_many_envs(config: Config, num_envs: int, episodes: int | None, option: str) -> str | None:
    """Why an evaluation with so many envs does not fit into RAM, or None."""
    played = min(num_envs, episodes or max(config.split.episodes.values()))
    # What is seen, what was seen last, and the agent's copy.
    return _too_large(f"{option}={num_envs}", "its envs", played, 3 * _frame_bytes(config))


def _too_large(options: str, what: str, count: int, each: int) -> str | None:
    free = free_ram()
    if count * each <= free:
        return None
    return (
        f"{options}: {what} take {in_words(count * each)} of RAM, and {in_words(free)} are free; "
        f"{max(free // each, 1)} would fit"
    )


def _frame_bytes(config: Config) -> int:
    """RAM for a frame of one env: the observation and what is kept beside it."""
    return sum(part.nbytes for part in _first_env(config).allocate().values()) + BESIDE_A_FRAME


def _first_env(config: Config) -> envs.ZipfVectorEnv:
    """One env of the first level of training, closed: what it shows and takes can be asked for."""
    env = envs.make_vec(config.split.train[0], 1, **config.level_options)
    env.close()
    return env


def _no_folder(config: Config) -> str | None:
    """Why a run's folder cannot be made, or None."""
    try:
        paths = config.folder, *config.folder.parents
        if any(path.exists() and not path.is_dir() for path in paths):
            return "should be a folder, but there is a file of that name"
    except OSError as error:
        return f"cannot be a folder: {error.strerror}"
    except (RuntimeError, ValueError) as error:  # a home that there is not, or a zero byte
        return f"cannot be a folder: {error}"
    return None


BESIDE_A_FRAME = 64  # bytes: reward, action, flags and so on
LARGEST_SIZE = 2**16  # ours: the weights between two such layers take 17 GB

_tried: dict[tuple[str, str], list[str]] = {}


def _cannot_be_built(config: Config) -> list[str]:
    """Why the levels or the agent cannot be made, or why memory will not hold them."""
    return _once(_no_levels, config) or list(_lacking_memory(config)) or _once(_no_agent, config)


def _once(attempt: Callable[[Config], Iterator[str]], config: Config) -> list[str]:
    """The problems of an attempt, which is made once for equal options."""
    options = config.what_is_learned | {"seed": 0, "compile": config.compile}
    key = attempt.__name__, json.dumps(options)
    if key not in _tried:
        _tried[key] = list(attempt(config))
    return _tried[key]


def _no_levels(config: Config) -> Iterator[str]:
    try:
        split = config.split
    except ValueError as error:
        answering = [one.name for one in envs.all_splits().values() if _has_questions(one)]
        yield (
            f"agent={config.agent.name}: {error}; splits with such questions: "
            f"{', '.join(answering)}"
        )
        return
    try:
        for level in split.all_levels:
            env = envs.make_vec(level, 1, **config.level_options)
            env.close()
    except ValueError as error:
        yield f"environment: {error}"
    except MemoryError as error:
        yield f"environment: one env does not fit into RAM ({error})"


def _no_agent(config: Config) -> Iterator[str]:
    family = envs.family_of_split(config.environment.split)
    env = _first_env(config)
    if config.hindsight.name != "none" and family.goal is not None and not env.achieves:
        yield (
            f"hindsight={config.hindsight.name}: these envs do not tell what an episode has "
            "achieved; choose hindsight=none"
        )
    try:
        with torch.random.fork_rng(devices=[]):  # an agent may seed the global generator
            agent = build_agent(config.model_copy(update={"device": "cpu"}), env)
    except UserError as error:
        yield from str(error).splitlines()
        return
    yield from _wrong_parts(config, agent)
    if agent.needs.teacher and getattr(family, agent.needs.teacher) is None:
        known = [name for name in envs.SCRIPTED if getattr(family, name) is not None]
        yield (
            f"agent.teacher={agent.needs.teacher}: {family.name} has no such policy; should be "
            f"{' or '.join(known) or 'another agent'}"
        )


def _wrong_parts(config: Config, agent: Agent) -> Iterator[str]:
    """Parts that are asked for and that a network has not; and those that learn nothing and are not
    taken from another run."""
    chosen = config.pretrained.parts
    if config.pretrained.run is None or not isinstance(agent, Learner):
        return
    known = agent.network.parts()
    for name in chosen:
        if name not in known:
            yield f"pretrained.parts: no part {name!r}; the network has {', '.join(known)}"
    left = [
        name
        for name in agent.network.fixed_parts()
        if not any(f"{name}.".startswith(f"{part}.") for part in chosen)
    ]
    if left:
        yield (
            f"pretrained.parts=[{','.join(chosen)}]: network.matcher=fixed keeps random weights "
            f"where they are not taken from that run; add {','.join(left)}"
        )


def _lacking_memory(config: Config) -> Iterator[str]:
    """What does not fit into RAM or the device's memory, by arithmetic: nothing is allocated."""
    evaluation = config.evaluation
    problems = [
        _too_many_on_device(config) if on_device(config) else _too_many_in_ram(config),
        too_many_envs(config, evaluation.num_envs, evaluation.episodes, "evaluation.num_envs"),
    ]
    yield from filter(None, problems)
    parts = {name: getattr(config, name).model_dump() for name in ("memory", "network", "critic")}
    too_large = False
    for name, value in flatten(parts).items():
        numbers = value if isinstance(value, list) else [value]
        if any(isinstance(one, int) and one > LARGEST_SIZE for one in numbers):
            too_large = True
            yield f"{name}={value}: should be at most {LARGEST_SIZE}"
    if too_large:
        return
    env = _first_env(config)
    if large := list(_too_many_codes(config, env)):
        yield from large
        return
    size, free = _weight_bytes(config, env), free_ram()
    chosen = f"network={config.network.name}, memory={config.memory.name}"
    if size is None:
        yield f"{chosen}: have too many weights or layers for PyTorch with these sizes"
    elif size > free:
        yield (
            f"{chosen}: their weights, gradients and the optimiser take {in_words(size)}, and "
            f"{in_words(free)} of RAM are free; choose smaller sizes"
        )


def _too_many_in_ram(config: Config) -> str | None:
    collector = config.collector
    frames = (collector.unroll_length + 1) * (1 + config.lag)
    options = (
        f"collector.num_envs={collector.num_envs}, "
        f"collector.unroll_length={collector.unroll_length}"
    )
    what = "the envs of an unroll"
    return _too_large(options, what, collector.num_envs, frames * _frame_bytes(config))


def _too_many_on_device(config: Config) -> str | None:
    """Codes of the unrolls, and the images of an update as its network reads them."""
    collector, device = config.collector, config.torch_device
    rows = collector.unroll_length + 1
    env = envs.make_tensor(config.split, 1, "cpu", **config.level_options)
    env.reset(0)
    codes = env.observe()
    kept = sum(part.nbytes for part in codes.values()) + BESIDE_A_FRAME
    read = 4 * sum(part.numel() for part in env.decode(codes).values())  # as float32
    unrolls = config.num_envs * rows * (1 + config.lag) * kept
    update = config.num_envs // config.updates_per_unroll * rows * read
    free = torch.cuda.mem_get_info(device)[0] if device.startswith("cuda") else free_ram()
    if unrolls + update <= free:
        return None
    return (
        f"collector.num_envs={collector.num_envs}, "
        f"collector.unroll_length={collector.unroll_length}: unrolls and the images of an update "
        f"take {in_words(unrolls + update)} of the device, and {in_words(free)} are free"
    )


def _too_many_codes(config: Config, env: envs.ZipfVectorEnv) -> Iterator[str]:
    """Observations and actions so many that their weights alone do not fit into RAM."""
    each = 4 if config.torch_device.startswith("cuda") else 16  # bytes of a weight
    free = free_ram()
    for name, space in env.single_observation_space.items():
        if is_codes(space):
            size = number_of_codes(space) * config.network.code_channels * each
            if size > free:
                yield (
                    f"{env.name_of(0)}: observation {name!r} is {space!s:.100}: embeddings of so "
                    f"many codes take {in_words(size)}, and {in_words(free)} of RAM are free; give "
                    "a quantity as a Box, and of codes fewer"
                )
    size = int(env.single_action_space.n) * each  # and that for each number that the head reads
    if size > free:
        yield (
            f"{env.name_of(0)}: {env.single_action_space} are too many actions: their weights take "
            f"more than {in_words(size)}, and {in_words(free)} of RAM are free"
        )


def _weight_bytes(config: Config, env: envs.ZipfVectorEnv) -> int | None:
    """Of an actor-critic with this network and memory; 0 where none can be made of them, None where
    it is too large for PyTorch. On a GPU only the weights themselves are in RAM."""
    try:
        with torch.device("meta"):
            spaces = env.single_observation_space, env.single_action_space
            network = ActorCritic(*spaces, config.network, config.memory, config.critic)
    except ValueError:
        return 0  # the agent, which may use neither, will tell
    except (RuntimeError, RecursionError):  # more bytes than an integer holds, or layers
        return None
    size = sum(parameter.nbytes for parameter in network.parameters())
    return size if config.torch_device.startswith("cuda") else 4 * size


def _has_questions(split: envs.Split) -> bool:
    try:
        envs.questions(split)
    except ValueError:
        return False
    return True
