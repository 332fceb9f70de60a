"""Commands whose output is lost: a run trains on, a report is written, nothing is a traceback."""

import io
import os
import re
import signal
import subprocess
import sys
from pathlib import Path

import pytest
from conftest import ANNOUNCED, PACKAGE, TINY
from rich.console import Console

from zipf import output
from zipf.experiments.building import checkpoint, loading
from zipf.experiments.training.clock import shares
from zipf.experiments.training.display import Display
from zipf.experiments.training.outputs import Outputs
from zipf.experiments.training.signals import CLUSTER, StopSignals

TRAIN = [*TINY, "updates=6", "evaluation.every=1", "name=x"]


def start(module: str, *arguments: str, **options: object) -> subprocess.Popen[str]:
    """A command; `options` are those of Popen."""
    environment = {**os.environ, "PYTHONPATH": str(PACKAGE), "PYTHONIOENCODING": "ascii"}
    return subprocess.Popen(
        [sys.executable, "-m", module, *arguments],
        env=environment,
        text=True,
        **{"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, **options},
    )


def errors_of(process: subprocess.Popen[str]) -> str:
    assert process.stderr is not None
    errors = process.stderr.read()
    process.wait(timeout=60)
    return errors.replace(ANNOUNCED, "")


def finished(root: Path) -> bool:
    return checkpoint.load(root / "demo" / "x" / "seed0" / "checkpoint.pt")["update"] == 6


def test_a_reader_that_has_seen_enough_does_not_end_a_run(tmp_path: Path) -> None:
    process = start("zipf.train", *TRAIN, f"run_root={tmp_path}")
    assert process.stdout is not None
    assert "a new run" in process.stdout.readline()
    process.stdout.close()
    assert errors_of(process) == ""
    assert process.returncode == 0
    assert finished(tmp_path)


full = pytest.mark.skipif(not Path("/dev/full").exists(), reason="no device that is always full")


@full
def test_a_full_device_does_not_end_a_run_and_is_told_once(tmp_path: Path) -> None:
    with open("/dev/full", "w") as device:
        process = start("zipf.train", *TRAIN, f"run_root={tmp_path}", stdout=device)
    told = "standard output cannot be written: No space left on device; going on without it\n"
    assert errors_of(process) == told
    assert process.returncode == 0
    assert finished(tmp_path)


@pytest.mark.slow  # two processes
def test_a_report_is_written_whatever_becomes_of_its_output(tmp_path: Path) -> None:
    """Its dashes are no ASCII."""
    folder = str(PACKAGE / "results" / "demo")
    process = start("zipf.report", folder, f"output={tmp_path / 'cut'}")
    assert process.stdout is not None
    process.stdout.readline()
    process.stdout.close()
    assert errors_of(process) == ""
    assert process.returncode == 0
    assert (tmp_path / "cut" / "report.md").exists()

    process = start("zipf.report", folder, f"output={tmp_path / 'whole'}")
    output, errors = process.communicate(timeout=60)
    assert (process.returncode, errors) == (0, "")
    assert "IMPALA + MLP" in output
    assert "Wrote" in output


def test_a_closed_terminal_is_no_reason_to_stop() -> None:
    said: list[str] = []
    with StopSignals(said.append) as stop:
        os.kill(os.getpid(), signal.SIGHUP)
    assert (stop.requested, said) == (0, [])


@pytest.mark.parametrize("number", CLUSTER)
def test_what_clusters_send_stops_with_a_checkpoint_however_often(number: signal.Signals) -> None:
    said: list[str] = []
    with StopSignals(said.append) as stop:
        for _ in range(3):
            signal.raise_signal(number)
        assert stop.requested == number
        assert said == [f"stopping with a checkpoint: {number.name}"]
        signal.raise_signal(signal.SIGTERM)
        with pytest.raises(KeyboardInterrupt):
            signal.raise_signal(signal.SIGTERM)
    assert signal.getsignal(number) is signal.SIG_DFL


def test_a_signal_that_comes_while_a_line_is_written_is_heard() -> None:
    def busy(line: str) -> None:
        raise RuntimeError("reentrant call inside <_io.BufferedWriter>")

    with StopSignals(busy) as stop:
        signal.raise_signal(signal.SIGTERM)
        assert stop.requested == signal.SIGTERM
        with pytest.raises(KeyboardInterrupt):
            signal.raise_signal(signal.SIGTERM)


def test_a_handler_of_somebody_elses_stays() -> None:
    received: list[int] = []
    own = lambda number, frame: received.append(number)  # noqa: E731
    before = signal.signal(signal.SIGUSR1, own)
    try:
        with StopSignals(received.append) as stop:  # type: ignore[arg-type]
            signal.raise_signal(signal.SIGUSR1)
        assert (stop.requested, received) == (0, [signal.SIGUSR1])
        assert signal.getsignal(signal.SIGUSR1) is own
    finally:
        signal.signal(signal.SIGUSR1, before)


METRICS = {"frames": 20.0, "frames_per_second": 5.0, "seconds": 4.0} | {
    f"time_{part}": 1.0 for part in ("environment", "inference", "learning", "evaluation")
}


def shown(update: int, *, terminal: bool = False) -> tuple[Display, io.StringIO]:
    file = io.StringIO()
    console = Console(file=file, force_terminal=terminal, width=100, no_color=True)
    display = Display("demo x", 8, update, frames_per_update=4, console=console)
    return display, file


def panel(display: Display) -> str:
    with display.console.capture() as captured:
        display.console.print(display._panel())
    return re.sub(r"\x1b\[[0-9;]*m", "", captured.get())


def test_shares_of_time_add_up_to_a_hundred_percent() -> None:
    parts = {"environment": 0.5, "inference": 41, "learning": 65, "evaluation": 34}
    assert shares(parts, 141, takes_turns=True) == {
        "environment": 1,
        "inference": 29,
        "learning": 46,
        "evaluation": 24,
        "other": 0,
    }
    # Beside learning, collection takes no time of the learner's thread but what it waits.
    assert shares(parts, 100, takes_turns=False) == {
        "learning": 65,
        "evaluation": 34,
        "waiting for frames": 1,
    }
    for number in range(1, 50):
        found = shares(dict.fromkeys(parts, 1 / number), 4.0 + number / 7, number % 2 == 0)
        assert sum(found.values()) == 100
    display, _ = shown(5, terminal=True)
    display.show_metrics(METRICS)
    assert "learning 25%" in panel(display)


def test_the_frames_shown_are_those_of_the_last_update() -> None:
    """Also where no row of metrics was written since."""
    display, file = shown(0, terminal=True)
    assert "evaluating before the first update" in panel(display)
    display.advance(5)
    display.show_metrics(METRICS)
    display.advance(8)
    assert "32 frames" in panel(display)
    assert "8/8" in panel(display)
    display, file = shown(5)
    display.show_metrics(METRICS)
    display.advance(8)
    display.show_scores([])
    assert file.getvalue() == "update 8/8  32 frames  5 frames/s\n"


def test_the_lines_of_every_half_minute_have_no_older_scores(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    display, file = shown(5)
    display.scores = {"train": 0.5}
    display.show_metrics({**METRICS, "episode_return": 0.25})
    assert not file.getvalue()
    monkeypatch.setattr(display, "_printed", -100.0)
    display.show_metrics({**METRICS, "episode_return": 0.25})
    line = "update 5/8  20 frames  5 frames/s  2 s left  return 0.250 in training\n"
    assert file.getvalue() == line


def test_an_evaluation_shows_how_far_it_is(monkeypatch: pytest.MonkeyPatch) -> None:
    display, _ = shown(5, terminal=True)
    display.show_metrics(METRICS)
    display.show_evaluation(1200, 3000)
    assert "evaluating: 1,200 of 3,000 episodes" in panel(display)
    display.show_scores([])
    assert "evaluating" not in panel(display)

    display, file = shown(0)
    display.show_evaluation(7, 3000)
    assert not file.getvalue()
    monkeypatch.setattr(display, "_printed", -100.0)
    display.show_evaluation(8, 3000)
    display.show_evaluation(9, 3000)
    assert file.getvalue() == "update 0/8  evaluating: 8 of 3,000 episodes\n"


@pytest.mark.parametrize(
    ("frames_per_second", "left"),
    [(0.5, "16 s"), (0.01, "13 min"), (0.001, "2 h 13 min")],
)
def test_lines_say_how_long_training_will_take(frames_per_second: float, left: str) -> None:
    display, file = shown(6)
    display.show_metrics({**METRICS, "frames_per_second": frames_per_second})
    display.show_scores([])
    assert file.getvalue().strip().endswith(f" frames/s  {left} left")


def test_a_resumed_run_does_not_claim_to_be_at_its_beginning() -> None:
    assert "before the first update" not in panel(shown(5, terminal=True)[0])


@pytest.mark.parametrize("is_first", [True, False])
def test_warnings_of_a_quiet_run_are_those_of_the_first_learner(
    is_first: bool, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    config = loading.load([*TINY, f"run_root={tmp_path}"])
    with output.quietly():
        Outputs(config, 0, is_first=is_first).warn("slow")
    assert capsys.readouterr() == ("", "slow\n" * is_first)


def test_ctrl_c_while_options_are_checked_is_no_traceback(tmp_path: Path) -> None:
    """The signal comes as soon as the first of many jobs is being checked. A shell's background job
    ignores it, and so would this process without the first line."""
    program = (
        "import os, signal, sys, time; signal.signal(signal.SIGINT, signal.default_int_handler);"
        "from zipf import train; from zipf.experiments.building import loading;"
        "loading.read = lambda job: (os.kill(os.getpid(), signal.SIGINT), time.sleep(60));"
        "sys.argv = ['zipf.train', 'experiment=demo']; train.main()"
    )
    process = subprocess.run([sys.executable, "-c", program], capture_output=True, cwd=tmp_path)
    assert (process.returncode, process.stderr) == (130, b"")
