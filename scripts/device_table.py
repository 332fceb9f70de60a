"""What of a run is done on a CUDA device: the table in `docs/speed.md`."""

from __future__ import annotations

from collections.abc import Iterator

from tables import code, markdown

from zipf import envs
from zipf.errors import UserError
from zipf.experiments.building import loading
from zipf.experiments.building.device_envs import not_captured, only_on_the_host
from zipf.experiments.building.factory import build_agent
from zipf.experiments.options import composing, config_files
from zipf.experiments.options.schema import Config
from zipf.registry import registries


def configs() -> Iterator[tuple[str, str, Config]]:
    """A run of the gridworld with every choice of every group."""
    config = loading.load(["experiment=demo", "memory.size=16", "collector.envs=device"])
    for group, registry in registries().items():
        for choice in [] if registry.several else registry.options:
            written = config_files.find(group, choice)
            values = dict(written.values) if written is not None and written.values else {}
            options = composing.options_class(group, choice).model_validate(
                {**values, "name": choice}
            )
            yield group, choice, config.model_copy(update={group: options})


def device() -> list[str]:
    """The choices of every group, by what is done on the device."""
    env = envs.make_vec("gridworld/zipf_2", 1)
    columns: dict[str, list[list[str]]] = {}
    for group, choice, config in configs():
        about = f"{group}={choice}"
        host = any(line.startswith(about) for line in only_on_the_host(config))
        eager = any(line.startswith(about) for line in not_captured(config))
        if group in ("network", "auxiliary"):  # some read what the gridworld does not show
            try:
                build_agent(config, env)
            except UserError:
                host = True
        row = columns.setdefault(group, [[], [], []])
        row[2 if eager else 1 if host else 0].append(code(choice))
    titles = (
        "Group",
        "On the device, captured",
        "Environments on the host, captured",
        "Environments on the host, not captured",
    )
    rows = [(code(name), *(", ".join(part) for part in row)) for name, row in columns.items()]
    return markdown(titles, rows)
