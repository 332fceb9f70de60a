"""A dm_env_rpc server with the names, settings and types of the released Playroom, and no room.

It is as strict as the protocol: one request, one response, and an error for a request in the wrong
state, for settings that the released loader does not send, and for tensors of other types.
"""

from collections.abc import Iterator
from concurrent import futures
from contextlib import contextmanager
from typing import Any

import grpc
import numpy as np
from dm_env_rpc.v1 import dm_env_rpc_pb2 as rpc
from dm_env_rpc.v1 import dm_env_rpc_pb2_grpc, spec_manager, tensor_spec_utils, tensor_utils
from google.rpc import status_pb2

from zipf.envs.playroom.levels import LEVELS

CONTROLS = (
    *("STRAFE_LEFT_RIGHT", "MOVE_BACK_FORWARD", "LOOK_LEFT_RIGHT", "LOOK_DOWN_UP"),
    *("HAND_ROTATE_AROUND_RIGHT", "HAND_ROTATE_AROUND_UP", "HAND_ROTATE_AROUND_FORWARD"),
    *("HAND_PUSH_PULL", "HAND_GRIP"),
)
TEXTS = ("Lift a duck", "Lift a rubber duck", "Put the aeroplane on the bed.")
CREATED = {"seed": int, "episodeId": int, "levelName": str}
JOINED = {"width": int, "height": int, "EpisodeLengthSeconds": float, "ShowReachabilityHUD": bool}


class Room:
    """An episode: moving forward for `far` frames is the task, and gripping for long fails it."""

    def __init__(self, seed: int, sound: bool) -> None:
        self.generator = np.random.default_rng(seed if sound else None)
        self.far = int(self.generator.integers(3, 40))
        self.controls = dict.fromkeys(CONTROLS, 0.0)
        self.frames, self.walked, self.gripped = 0, 0.0, 0
        self.first = True

    def advance(self) -> None:
        self.frames += 1
        self.walked += self.controls["MOVE_BACK_FORWARD"]
        self.gripped += int(self.controls["HAND_GRIP"])


class Service(dm_env_rpc_pb2_grpc.EnvironmentServicer):
    """Serves an env to each connection.

    Attributes:
        requests: of all connections: the names of the payloads.
        controls: what a step of a running episode was given.
        envs: names of the envs that there are.
        sound: False: the seed does not determine an episode.
        channels: of the image.
    """

    def __init__(self) -> None:
        self.requests: list[str] = []
        self.controls: list[dict[str, float]] = []
        self.envs: set[str] = set()
        self.made = 0
        self.sound = True
        self.channels = 3

    def Process(self, request_iterator: Any, context: Any) -> Iterator[Any]:
        session = Session(self)
        for request in request_iterator:
            kind = request.WhichOneof("payload")
            self.requests.append(kind)
            response = rpc.EnvironmentResponse()
            try:
                given = getattr(session, kind)(getattr(request, kind))
                getattr(response, kind).CopyFrom(given)
            except (ValueError, TypeError, KeyError) as error:
                response.error.CopyFrom(status_pb2.Status(message=str(error)))
            yield response


class Session:
    """One connection."""

    def __init__(self, service: Service) -> None:
        self.service = service
        self.made: dict[str, Any] = {}
        self.joined = ""

    def create_world(self, request: Any) -> Any:
        settings = _settings(request.settings, CREATED)
        if settings["levelName"] not in LEVELS:
            raise ValueError(f"no level {settings['levelName']}")
        name = f"world {self.service.made}"
        self.service.made += 1
        self.service.envs.add(name)
        self.made[name] = settings
        return rpc.CreateWorldResponse(world_name=name)

    def join_world(self, request: Any) -> Any:
        _require(not self.joined, "joined already")
        _require(request.world_name in self.made, f"no env {request.world_name!r}")
        self.settings = _settings(request.settings, JOINED)
        self.joined = request.world_name
        self.room = Room(int(self.made[self.joined]["seed"]), self.service.sound)
        shape = [int(self.settings["height"]), int(self.settings["width"]), self.service.channels]
        self.shape = shape
        response = rpc.JoinWorldResponse()
        for uid, name in enumerate(CONTROLS, 1):
            grips = name == "HAND_GRIP"
            spec = rpc.TensorSpec(name=name, dtype=rpc.INT32 if grips else rpc.DOUBLE)
            low, high = (0, 1) if grips else (-1.0, 1.0)
            tensor_spec_utils.set_bounds(spec, minimum=low, maximum=high)
            response.specs.actions[uid].CopyFrom(spec)
        for uid, (name, dtype, dims) in enumerate(
            (
                ("RGB_INTERLEAVED", rpc.UINT8, shape),
                ("TEXT", rpc.STRING, []),
                ("reward", rpc.DOUBLE, []),
            ),
            1,
        ):
            spec = rpc.TensorSpec(name=name, dtype=dtype, shape=dims)
            response.specs.observations[uid].CopyFrom(spec)
        self.specs = response.specs
        return response

    def step(self, request: Any) -> Any:
        _require(self.joined, "cannot step: not joined")
        _require(self.room is not None, "cannot step: the episode has ended")
        room = self.room
        given = spec_manager.SpecManager(self.specs.actions).unpack(request.actions)
        for name, value in given.items():
            wanted = np.int32 if name == "HAND_GRIP" else np.float64
            _require(value.dtype == wanted, f"{name} is {value.dtype}")
            _require(abs(value) <= 1, f"{name}={value}")
            room.controls[name] = float(value)
        if room.first:
            room.first = False  # the first step shows the env and takes no action
        else:
            self.service.controls.append(dict(room.controls))
            room.advance()
        done = room.walked >= room.far
        ended = done or room.gripped >= 12
        late = room.frames >= self.settings["EpisodeLengthSeconds"] * 30
        state = rpc.RUNNING
        if ended or late:
            state = rpc.TERMINATED if ended else rpc.INTERRUPTED
            self.room = None
        image = np.full(self.shape, room.frames % 256, np.uint8)
        image[0, 0] = room.far
        shown = {
            "RGB_INTERLEAVED": image,
            "TEXT": TEXTS[room.far % len(TEXTS)],
            "reward": float(done),
        }
        packed = spec_manager.SpecManager(self.specs.observations).pack(shown)
        wanted = {uid: packed[uid] for uid in request.requested_observations}
        return rpc.StepResponse(state=state, observations=wanted)

    def leave_world(self, request: Any) -> Any:
        self.joined = ""
        return rpc.LeaveWorldResponse()

    def destroy_world(self, request: Any) -> Any:
        _require(self.joined != request.world_name, "cannot destroy an env that is joined")
        del self.made[request.world_name]
        self.service.envs.remove(request.world_name)
        return rpc.DestroyWorldResponse()


def _settings(given: Any, expected: dict[str, type]) -> dict[str, Any]:
    _require(given.keys() == expected.keys(), f"settings {sorted(given)}")
    values = {name: tensor_utils.unpack_tensor(value) for name, value in given.items()}
    for name, value in values.items():
        kind = {int: "i", float: "f", bool: "b", str: "UO"}[expected[name]]
        _require(np.asarray(value).dtype.kind in kind, f"{name}={value!r}")
    return values


def _require(condition: Any, message: str) -> None:
    if not condition:
        raise ValueError(message)


@contextmanager
def serving() -> Iterator[tuple[Service, str]]:
    """A running server and its address."""
    service = Service()
    with futures.ThreadPoolExecutor(max_workers=64) as pool:  # one for each open connection
        server = grpc.server(pool)
        dm_env_rpc_pb2_grpc.add_EnvironmentServicer_to_server(service, server)
        port = server.add_secure_port("localhost:0", grpc.local_server_credentials())
        server.start()
        try:
            yield service, f"localhost:{port}"
        finally:
            server.stop(None).wait()
