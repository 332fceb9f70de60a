"""The playroom's keys: letters move, arrows turn the view, the space bar grips and lets go."""

from zipf.envs.keyboard import Binding, Keys, Toggle
from zipf.envs.playroom.actions import ACTIONS, GRAB, NOOP


def _bind(keys: tuple[str, ...], label: str, name: str, fine: str | None = None) -> Binding:
    """Keys for a movement, with the hand open or closed, at full strength or `fine`."""
    full, less = ACTIONS.index(name), ACTIONS.index(fine or name)
    return Binding(keys, label, (full, GRAB + full, less, GRAB + less))


def _spin(key: str, way: str) -> Binding:
    return Binding((key,), f"spin {way.lower()}", (ACTIONS.index(f"GRAB_AND_SPIN_{way}"),))


def _push(key: str, label: str, name: str) -> Binding:
    free, full = ACTIONS.index(f"{name}_MID"), ACTIONS.index(f"GRAB_AND_{name}_FULL")
    return Binding((key,), label, (free, full, free, ACTIONS.index(f"GRAB_AND_{name}_MID")))


KEYS = Keys(
    (
        _bind(("w",), "forward", "MOVE_FORWARD_FULL"),
        _bind(("s",), "backward", "MOVE_BACKWARD_FULL"),
        _bind(("a",), "left", "MOVE_LEFT_FULL", "MOVE_LEFT_SLIGHTLY"),
        _bind(("d",), "right", "MOVE_RIGHT_FULL", "MOVE_RIGHT_SLIGHTLY"),
        _bind(("left",), "look left", "LOOK_LEFT_FULL", "LOOK_LEFT_MID"),
        _bind(("right",), "look right", "LOOK_RIGHT_FULL", "LOOK_RIGHT_MID"),
        _bind(("up",), "look up", "LOOK_UP_FULL", "LOOK_UP_MID"),
        _bind(("down",), "look down", "LOOK_DOWN_FULL", "LOOK_DOWN_MID"),
        _bind((",",), "look slightly left", "LOOK_LEFT_SLIGHTLY"),
        _bind((".",), "look slightly right", "LOOK_RIGHT_SLIGHTLY"),
        _push("r", "pull closer", "PULL_CLOSER"),
        _push("f", "push away", "PUSH_AWAY"),
        _spin("j", "LEFT"),
        _spin("l", "RIGHT"),
        _spin("i", "UP"),
        _spin("k", "DOWN"),
        _spin("o", "FORWARD"),
        _spin("u", "BACKWARD"),
        Binding(("x",), "wait", (NOOP, GRAB, NOOP, GRAB)),
    ),
    (Toggle("space", "grip", (NOOP, GRAB, NOOP, GRAB)), Toggle("tab", "fine")),
)
