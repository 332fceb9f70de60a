"""What scripted policies remember of their episodes, and how it is saved."""

from collections.abc import Mapping
from typing import Any, ClassVar

from numpy.typing import NDArray


class Remembering:
    """The base of scripted policies that remember something of their episodes."""

    # names of the attributes, arrays [N, ...], that its next actions depend on
    remembered: ClassVar[tuple[str, ...]]

    def get_state(self) -> dict[str, NDArray[Any]]:
        """What it remembers, by name."""
        return {name: getattr(self, name).copy() for name in self.remembered}

    def set_state(self, state: Mapping[str, NDArray[Any]]) -> None:
        """Continues from `get_state()`, in the same envs."""
        for name in self.remembered:
            getattr(self, name)[:] = state[name]
