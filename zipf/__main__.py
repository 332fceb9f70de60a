"""`zipf train experiment=demo`: the commands by their names, as `python -m zipf.train` is."""

from __future__ import annotations

import importlib
import sys

import zipf
from zipf.errors import UserError, tell

COMMANDS = {
    "train": "trains an agent and scores it as it learns; with -m a sweep",
    "evaluate": "scores a trained agent or a scripted policy",
    "report": "makes tables, plots and a page of runs",
    "play": "shows an environment, played by you or by an agent",
}


def main() -> int:
    """The command that the first argument names; returns its exit code."""
    name, *others = sys.argv[1:] or ["--help"]
    if name in ("--help", "-h", "help"):
        print("usage: zipf COMMAND ...\n")
        print("\n".join(f"    {one:10}{about}" for one, about in COMMANDS.items()))
        print("\nzipf COMMAND --help tells more. zipf train is python -m zipf.train, and so on.")
        return 0
    if name == "--version":
        print(f"zipf {zipf.__version__}")
        return 0
    if name not in COMMANDS:
        tell(UserError(f"zipf {name}: no such command; choose {', '.join(COMMANDS)}"))
        return 2
    sys.argv = [f"zipf.{name}", *others]
    return importlib.import_module(f"zipf.{name}").main() or 0


if __name__ == "__main__":
    sys.exit(main())
