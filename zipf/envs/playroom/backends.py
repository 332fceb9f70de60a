"""The engines of the playroom: ours, and the released one."""

from typing import Any

from zipf.envs.playroom import PlayroomOptions
from zipf.envs.vector import ZipfVectorEnv

_OF_BOTH = ("backend", "image_size", "max_steps")
"""Options that the released Playroom has, too."""


def make_vec(
    num_envs: int = 1,
    level: str = "lift/lift_shape_zipf3",
    *,
    backend: str = "own",
    **options: Any,
) -> ZipfVectorEnv:
    """`num_envs` worlds of a level.

    Args:
        num_envs: number of worlds N.
        level: with or without `playroom/` before it.
        backend: the engine, "own" or "docker".
        options: of `PlayroomVectorEnv`; with "docker", those that only our engine has may be given
            if they are as by default.

    Raises:
        ValueError: for an unknown level or backend, options out of range or of our engine alone,
            or a backend that is not installed.
    """
    if backend == "own":
        from zipf.envs.playroom.vector import PlayroomVectorEnv

        return PlayroomVectorEnv(num_envs, level, **options)
    if backend != "docker":
        raise ValueError(f"backend must be 'own' or 'docker', got {backend!r}")
    from zipf.envs.playroom.docker import DockerVectorEnv

    for name, value in PlayroomOptions().model_dump().items():
        if name not in _OF_BOTH and options.pop(name, value) != value:
            raise ValueError(
                f"{name} must be {value!r} with backend='docker': the released Playroom has no "
                "such option"
            )
    return DockerVectorEnv(num_envs, level, **options)
