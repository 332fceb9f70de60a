"""`python -m zipf.play level=<level>`: play a level, or watch and record who plays it."""

from __future__ import annotations

import signal
import sys

from zipf.experiments.command_line import read_options
from zipf.experiments.errors import UserError
from zipf.experiments.playing.playing import PlayOptions, play

__all__ = ["main"]

USAGE = """Plays a level by hand, or shows or records who plays it.

    python -m zipf.play level=gridworld/zipf_2
    python -m zipf.play level=gridworld/rare policy=expert record=expert.mp4 episodes=3
    python -m zipf.play run=runs/demo/impala_mlp/seed0 level=rare record=agent.gif

level=NAME        a level; with run=, also train, uniform or rare, those of the run (train)
run=FOLDER        a run's folder (holds checkpoint.pt): its agent plays, on its kind of worlds
policy=NAME       who plays: keyboard, random, expert (scripted), agent (of the run)
record=FILE       to a .gif, for what is short, or an .mp4; without a screen unless you play
episodes=N        1 where there is no screen, else until you leave
plugins=NAMES     modules to import first, for worlds and agents from outside the package
seed=N            of the worlds and the actions; fresh each time, and told
fps=N             frames per second of recordings and of what is watched; the family's own
scale=N           screen pixels for a pixel, each way, in windows and recordings
view=NAME         world (as drawn for people) or agent (what it sees); agent in a terminal
screen=auto       window, terminal, or auto: a window where there can be one

The keys are shown on the screen; q leaves."""


def main() -> None:
    """The command."""
    arguments = sys.argv[1:]
    if not arguments or {"-h", "--help"} & set(arguments):
        print(USAGE)
        sys.exit(0 if arguments else 2)
    for number in (signal.SIGTERM, signal.SIGHUP):  # leave a terminal and a recording in order
        signal.signal(number, _exit)
    try:
        play(read_options(PlayOptions, arguments), lambda line: print(line, flush=True))
    except KeyboardInterrupt:
        sys.exit(130)
    except UserError as error:
        for line in str(error).splitlines():
            print(f"error: {line}", file=sys.stderr)
        sys.exit(2)


def _exit(number: int, frame: object) -> None:
    sys.exit(128 + number)


if __name__ == "__main__":
    main()
