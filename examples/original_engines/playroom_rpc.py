"""One env of the released Playroom, which talks dm_env_rpc, in a container or elsewhere.

Messages, settings and names are those of the released loader (github.com/google-deepmind/
zipfian_environments, `playroom/load_environment.py`) and of dm_env_rpc's documentation.
"""

import shutil
import subprocess
import time
import weakref
from collections.abc import Mapping
from typing import Any, NamedTuple

IMAGE = (
    "gcr.io/google.com/deepmind-environments-staging/dm_zipfian_distributions:"
    "dm_zipfian_distributions_staging_gcr_20220629_RC00"
)
"""The released environment's image, as its loader names it."""

FRAMES_PER_SECOND = 30
ADDRESS = "ZIPF_PLAYROOM_ADDRESS"
"""The environment variable with the `host:port` of a running server."""

_PORT = 10000  # on which a container listens
_ATTEMPTS = 10
_PATIENCE = 1.0  # seconds of each attempt to connect, and between two
_OBSERVATIONS = ("RGB_INTERLEAVED", "TEXT")


class Shown(NamedTuple):
    """What the env returned for a frame: `discount` is 0 at the end of a task."""

    image: Any
    text: str
    reward: float
    last: bool
    discount: float


def check(address: str | None) -> None:
    """Raises ValueError without what a connection needs."""
    try:
        import dm_env_rpc.v1.dm_env_adaptor  # noqa: F401
    except ImportError as error:
        raise ValueError(
            "the family released_playroom needs dm_env_rpc, which cannot be imported "
            f"({error}): pip install dm-env-rpc, or use the family playroom"
        ) from error
    if address is None and shutil.which("docker") is None:
        raise ValueError(
            "the family released_playroom needs the command docker, which is not there, or "
            f"{ADDRESS}=host:port of a running server on this machine; or use the family playroom"
        )
    if address is not None and not address.rpartition(":")[2].isdigit():
        raise ValueError(f"{ADDRESS} must be host:port, got {address!r}")


class World:
    """A connection to a server, and the env that it is joined to.

    Every episode is an env of its own, created with the episode's seed.

    Args:
        address: `host:port` of a server on this machine; None: a container is started.
        level: as the release names it, for instance `lift/lift_shape_zipf3`.
        settings: width, height and length of an episode, as the release names them.
    """

    def __init__(self, address: str | None, level: str, settings: Mapping[str, Any]) -> None:
        self.level = level
        self.settings = settings
        self._name: str | None = None
        self._adaptor: Any = None
        self._connection: Any = None
        self._stop = None
        if address is None:
            identity, address = _start()
            self._stop = weakref.finalize(self, _docker, "kill", identity)
        try:
            self._connection = _connect(address)
        except BaseException:
            self.close()
            raise

    def begin(self, seed: int) -> Shown:
        """Begins an episode."""
        from dm_env_rpc.v1 import dm_env_adaptor, dm_env_rpc_pb2

        self._leave()
        self._name = self._connection.send(
            dm_env_rpc_pb2.CreateWorldRequest(
                settings=_packed({"seed": seed, "episodeId": 0, "levelName": self.level})
            )
        ).world_name
        joined = self._connection.send(
            dm_env_rpc_pb2.JoinWorldRequest(world_name=self._name, settings=_packed(self.settings))
        )
        self._adaptor = dm_env_adaptor.DmEnvAdaptor(
            self._connection, joined.specs, list(_OBSERVATIONS)
        )
        self._types = {name: one.dtype.type for name, one in self._adaptor.action_spec().items()}
        return self.step({})

    def step(self, controls: Mapping[str, float]) -> Shown:
        """A frame with these controls; those that are not named stay as they are.

        Raises:
            ValueError: the server has no such control.
        """
        if missing := controls.keys() - self._types.keys():
            raise ValueError(f"no control {sorted(missing)}, only {sorted(self._types)}")
        typed = {name: self._types[name](value) for name, value in controls.items()}
        told = self._adaptor.step(typed)
        return Shown(
            told.observation["RGB_INTERLEAVED"],
            str(told.observation["TEXT"]),
            0.0 if told.reward is None else float(told.reward),
            told.last(),
            1.0 if told.discount is None else float(told.discount),
        )

    def close(self) -> None:
        """Leaves the env and stops the container, if one was started."""
        try:
            if self._connection is not None:
                self._leave()
                self._connection.close()
        except Exception:  # the server is gone, and the env with it
            pass
        finally:
            self._connection = None
            if self._stop is not None:
                self._stop()

    def _leave(self) -> None:
        from dm_env_rpc.v1 import dm_env_rpc_pb2

        name, self._name = self._name, None
        if name is not None:
            if self._adaptor is not None:
                self._adaptor = None
                self._connection.send(dm_env_rpc_pb2.LeaveWorldRequest())
            self._connection.send(dm_env_rpc_pb2.DestroyWorldRequest(world_name=name))


def _packed(settings: Mapping[str, Any]) -> dict[str, Any]:
    from dm_env_rpc.v1 import tensor_utils

    return {name: tensor_utils.pack_tensor(value) for name, value in settings.items()}


def _connect(address: str) -> Any:
    """A connection that answers.

    Raises:
        ConnectionError: none did, after several attempts.
    """
    import grpc
    from dm_env_rpc.v1 import connection, dm_env_rpc_pb2, error

    for attempt in range(_ATTEMPTS):
        if attempt:
            time.sleep(_PATIENCE)
        try:
            found = connection.create_secure_channel_and_connect(address, timeout=_PATIENCE)
        except grpc.FutureTimeoutError:
            continue
        try:  # a server that starts may accept a channel before it answers
            found.send(dm_env_rpc_pb2.StepRequest())
        except error.DmEnvRpcError:
            return found  # there is no env to step yet: an answer
        except grpc.RpcError:
            found.close()
    raise ConnectionError(f"no dm_env_rpc server answers at {address}")


def _start() -> tuple[str, str]:
    """Starts a container: its identity, and the address that it listens at."""
    identity = _docker("run", "--detach", "--rm", "--publish", f"127.0.0.1::{_PORT}", IMAGE)
    try:
        return identity, _docker("port", identity, str(_PORT)).splitlines()[0]
    except BaseException:
        _docker("kill", identity)
        raise


def _docker(*arguments: str) -> str:
    """What a docker command prints.

    Raises:
        RuntimeError: it failed, with what it said.
    """
    done = subprocess.run(["docker", *arguments], capture_output=True, text=True, check=False)
    if done.returncode and arguments[0] != "kill":  # a container may have ended by itself
        raise RuntimeError(f"docker {' '.join(arguments)}: {done.stderr.strip()}")
    return done.stdout.strip()
