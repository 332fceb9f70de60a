"""The labyrinth's keys: letters move, arrows turn the view."""

from zipf.envs.keyboard import Binding, Keys
from zipf.envs.labyrinth.actions import EXTENDED

_NAMES = [action.name for action in EXTENDED]

KEYS = Keys(
    tuple(
        Binding(keys, label, (_NAMES.index(name),))
        for keys, label, name in (
            (("w",), "forward", "forward"),
            (("s",), "backward", "backward"),
            (("a",), "left", "strafe left"),
            (("d",), "right", "strafe right"),
            (("left",), "look left", "look left"),
            (("right",), "look right", "look right"),
            (("up",), "look up", "look up"),
            (("down",), "look down", "look down"),
            ((",",), "look slightly left", "look slightly left"),
            ((".",), "look slightly right", "look slightly right"),
            (("u",), "run left", "forward and left"),
            (("o",), "run right", "forward and right"),
            (("j",), "run slightly left", "forward and slightly left"),
            (("l",), "run slightly right", "forward and slightly right"),
            (("space",), "fire, or wait", "fire"),
        )
    )
)
