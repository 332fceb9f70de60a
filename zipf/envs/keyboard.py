"""What the keys of a keyboard do in a family of envs, as data."""

from collections import Counter
from dataclasses import dataclass

LEAVE, NEXT = "q", "enter"
"""Keys with a meaning in every family: leave; go on to the next episode."""


@dataclass(frozen=True)
class Binding:
    """Keys that take an action.

    Attributes:
        keys: names of keys, each of which will do: a character as typed without Shift, or "up",
            "down", "left", "right", "home", "end", "pageup", "pagedown", "space", "tab",
            "backspace". The numeric pad gives its digits.
        label: what the action does, in a word or two.
        actions: the action for each combination of toggles, that with toggle `t` on at the index
            whose bit `t` is set; or a single one, where toggles make no difference.
    """

    keys: tuple[str, ...]
    label: str
    actions: tuple[int, ...]


@dataclass(frozen=True)
class Toggle:
    """A key that changes what others do, until it is pressed again.

    Attributes:
        key: its name, as in `Binding`.
        label: what is on or off.
        actions: the action that the press itself takes, by the combination of toggles after it,
            as in `Binding`; empty where it takes none.
    """

    key: str
    label: str
    actions: tuple[int, ...] = ()


@dataclass(frozen=True)
class Keys:
    """The keyboard of a family.

    Attributes:
        bindings, toggles: what the keys do.
        goal: what to do in these envs, a sentence for the person who plays; empty: the
            instruction says it.

    Raises:
        ValueError: for a key that means two things, or a number of actions that is neither 1 nor
            that of the combinations of toggles.
    """

    bindings: tuple[Binding, ...]
    toggles: tuple[Toggle, ...] = ()
    goal: str = ""

    def __post_init__(self) -> None:
        named = [key for binding in self.bindings for key in binding.keys]
        named += [toggle.key for toggle in self.toggles] + [LEAVE, NEXT]
        twice = [key for key, times in Counter(named).items() if times > 1]
        if twice:
            raise ValueError(f"keys {twice} have more than one meaning")
        count = 2 ** len(self.toggles)
        taken = [(binding.label, binding.actions) for binding in self.bindings]
        taken += [(toggle.label, toggle.actions) for toggle in self.toggles if toggle.actions]
        for label, actions in taken:
            if len(actions) not in (1, count):
                raise ValueError(
                    f"{label!r} has {len(actions)} actions: must be 1 or {count}, one for each "
                    "combination of toggles"
                )

    def press(self, key: str, toggled: int = 0) -> tuple[int | None, int]:
        """What a key does.

        Args:
            key: its name; unknown ones do nothing.
            toggled: which toggles are on, a bit each.

        Returns:
            The action to take, or None, and which toggles are on now.
        """
        actions: tuple[int, ...] = ()
        for i, toggle in enumerate(self.toggles):
            if key == toggle.key:
                toggled ^= 1 << i
                actions = toggle.actions
        for binding in self.bindings:
            if key in binding.keys:
                actions = binding.actions
        if not actions:
            return None, toggled
        return actions[toggled if len(actions) > 1 else 0], toggled
