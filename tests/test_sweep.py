"""Sweeps: which jobs they have, what becomes of jobs that fail, and the launchers at work."""

import io
import os
import re
import signal
import subprocess
import sys
import textwrap
import time
from pathlib import Path

import pandas as pd
import pytest
from conftest import PACKAGE, TINY, command, contents
from envs_of import chosen, needs
from rich.console import Console

from zipf import envs, report
from zipf.errors import UserError
from zipf.experiments.building import checkpoint, feasibility, loading, run_folder
from zipf.experiments.options import composing, config_files
from zipf.experiments.options.catalogue import help_text, summary
from zipf.experiments.records.paper import paper_table
from zipf.experiments.sweeping import job, launching, progress, sweep, sweeps
from zipf.experiments.training import runner
from zipf.experiments.training.signals import SWEEP_PIPE, StopSignals

SWEEPS = composing.choices("sweep")


def expanded(*overrides):
    """The jobs' overrides, as dictionaries."""
    jobs = sweeps.expand([*overrides])
    return [dict(word.split("=", 1) for word in words) for words, _ in jobs]


def pairs(jobs):
    return {(one["experiment"], one["condition"]) for one in jobs}


def split_of(experiment):
    return envs.split(composing.composed(f"experiment={experiment}").values["environment"]["split"])


# What sweeps consist of


PAPERS = [name for name in SWEEPS if name.startswith("paper_")]


@pytest.mark.parametrize("name", SWEEPS)
def test_every_shipped_sweep_can_be_read(name):
    assert sweeps.read_blocks(name)


@pytest.mark.parametrize("name", PAPERS)
def test_the_papers_sweeps_have_every_row_of_its_tables(name):
    jobs = expanded(f"sweep={name}")
    for experiment in {one["experiment"] for one in jobs}:
        rows = {condition for one, condition in pairs(jobs) if one == experiment}
        assert rows == set(paper_table(split_of(experiment).paper).rows)
        assert all(needs(experiment, **chosen(experiment, row)) is None for row in rows)
    assert len(jobs) == 3 * len(pairs(jobs))
    assert {one["seed"] for one in jobs} == {"0", "1", "2"}


def test_the_papers_sweeps_have_all_its_experiments():
    swept = {one["experiment"] for name in PAPERS for one in expanded(f"sweep={name}")}
    every = composing.choices("experiment")
    assert swept == {one for one in every if split_of(one).name == one}


def test_the_tail_is_what_the_paper_has_not():
    found = pairs(expanded("sweep=tail", "seed=0"))
    files = {name: summary("condition", name) for name in composing.choices("condition")}
    tail = {name for name, told in files.items() if "Not in the paper" in told}
    wanted = {
        "gridworld_conditions": set(files),
        "playroom_lift_compact": {"impala", *tail},
        "playroom_find_compact": {"impala", "supervised", *tail},
    }
    assert found == {(one, row) for one, rows in wanted.items() for row in rows}


def test_conditions_of_a_set_that_do_not_fit_are_left_out():
    words = ["sweep=demo", "condition=impala,supervised,vmpo", "seed=0"]
    found = sweeps.check(words)
    assert [one.config.condition for one in found.jobs] == ["impala", "vmpo"]
    (why,) = found.left_out
    assert "condition=supervised: agent=supervised" in why
    with pytest.raises(UserError, match="updates=many"):  # a mistake is not a misfit
        sweeps.check([*words, "updates=many"])


def test_a_condition_that_fits_nowhere_is_one_clear_line():
    told = r"^experiment=demo_conditions condition=supervised: agent=supervised: there are no"
    with pytest.raises(UserError, match=told) as error:
        sweeps.check(["sweep=demo", "condition=supervised"])
    assert len(str(error.value).splitlines()) == 1


@pytest.mark.parametrize("root", ["~nouser/x", "x" * 300])
def test_a_root_that_can_be_no_folder_is_one_clear_line(root):
    words = [*TINY, "seed=0,1", f"run_root='{root}'"]
    with pytest.raises(UserError, match=r"^run_root=.*: cannot be a folder: ") as error:
        sweeps.check(words, run_folder.is_finished)
    assert len(str(error.value).splitlines()) == 1


def test_overrides_apply_to_all_jobs_of_a_sweep():
    jobs = expanded("sweep=tail", "condition=impala", "seed=7", "updates=9", "run_root=x")
    assert {(one["seed"], one["updates"], one["run_root"]) for one in jobs} == {("7", "9", "x")}
    assert len(jobs) == 3
    assert len(expanded("sweep=tail", "experiment=gridworld_conditions", "condition=impala")) == 3
    both = pairs(expanded("sweep=paper_gridworld,paper_labyrinth", "condition=r2d2", "seed=0"))
    assert both == {
        (one, "r2d2") for one in ("gridworld", "labyrinth_forward", "labyrinth_reversed")
    }


@pytest.fixture
def own(tmp_path, monkeypatch):
    """A function that writes a sweep of one's own, `mine`."""
    monkeypatch.setattr(config_files, "_user_folder", tmp_path / "configs")
    path = tmp_path / "configs" / "sweep.yaml"
    path.parent.mkdir()
    return lambda text: path.write_text(f"# Mine.\nmine:\n{textwrap.indent(text, '  ')}")


def everything(*overrides):
    """The jobs, as if all were finished: composed, and nothing built."""
    return sweeps.check([*overrides], is_finished=lambda _: True).jobs


def test_a_sweep_of_ones_own(own):
    own(
        "- {experiments: demo, conditions: impala, seeds: [3, 4], overrides: ['memory=mlp,lstm']}\n"
        "- {experiments: [demo, gridworld], seeds: [3]}\n"
        "- {experiments: demo, conditions: impala, seeds: [4, 5], overrides: [memory=lstm]}\n"
    )
    jobs = everything("sweep=mine")
    assert [(j.config.experiment, j.config.condition, j.config.seed) for j in jobs] == [
        ("demo", "impala-memory_mlp", 3),
        ("demo", "impala", 3),
        ("demo", "impala-memory_mlp", 4),
        ("demo", "impala", 4),
        ("demo", "impala_mlp", 3),
        ("gridworld", "impala", 3),
        ("demo", "impala", 5),
    ]
    assert len(expanded("sweep=mine", "memory=lstm", "seed=1")) == 3
    assert len(expanded("sweep=mine", "memory=lstm", "++seed=1")) == 3
    assert re.search(r"^  mine +Mine\.$", help_text(), re.MULTILINE)


@pytest.mark.parametrize(
    ("words", "told"),
    [
        (["sweep=papr_gridworld"], "did you mean paper_gridworld"),
        (["sweep=demo", "experiment=gridworld"], "experiment=gridworld: is not in sweep=demo"),
        (["sweep=paper_gridworld", "condition=vmpo"], "condition=vmpo: is not in sweep=paper_grid"),
        (["experiment=demo", "sweeep=demo"], "did you mean sweep"),
        (["experiment=demo", "seed=0,0"], "experiment=demo seed=0: is given twice"),
        (["experiment=demo", "updates=3,4"], "two jobs would use this folder"),
        (["sweep=mine"], "sweep.yaml:2: is no sweep: should be a list of blocks"),
    ],
)
def test_a_mistake_is_one_clear_line(words, told, own):
    own("experiments: demo")
    with pytest.raises(UserError, match=re.escape(told)) as error:
        everything(*words)
    assert len(str(error.value).splitlines()) == 1


@pytest.mark.parametrize(
    ("block", "told"),
    [
        ("experiments: dmo, seeds: [0]", "no such experiment as dmo; did you mean demo"),
        ("experiments: demo, seeds: [0], conditions: impla", "no such condition as impla; did you"),
        ("experiments: demo_conditions, seeds: [0], conditions: papr", "did you mean paper"),
        ("experiments: demo", "seeds: Field required; a block has experiments, conditions"),
        ("experiments: demo, seeds: [-1]", "greater than or equal to 0"),
        ("experiments: [], seeds: [0]", "sweep=mine: has no experiments"),
        ("experiments: demo, seeds: [0], seed: 1", "seed: Extra inputs"),
        ("experiments: demo, seeds: [0], overrides: ['seeed=1']", "seeed: no such option"),
    ],
)
def test_a_mistake_in_a_sweeps_file_is_one_clear_line(block, told, own):
    own(f"- {{{block}}}")
    with pytest.raises(UserError, match=re.escape(told)) as error:
        everything("sweep=mine")
    assert len(str(error.value).splitlines()) == 1


CHAIN = """- seeds: [3, 4]
  stages:
    - {name: one, experiment: demo, condition: imitation}
    - {name: two, experiment: demo, overrides: [pretrained.run=one, updates=7]}
    - {name: three, experiment: demo, overrides: [pretrained.run=two, updates=8]}
  overrides: [updates=9, "schedule.window=[1,2]"]
"""


@pytest.mark.parametrize("text", ["updates: 3", "environment: {size: 3}"])
def test_the_paper_has_no_table_of_an_experiment_without_an_environment(text, own, tmp_path):
    (tmp_path / "configs" / "experiments").mkdir()
    (tmp_path / "configs" / "experiments" / "bare.yaml").write_text(text)
    own("- {experiments: bare, seeds: [0], conditions: paper}")
    with pytest.raises(UserError, match="the paper has no table of experiment=bare"):
        everything("sweep=mine")


def test_stages_begin_with_the_run_of_the_same_seed(own):
    own(CHAIN)
    jobs = sweeps.check(["sweep=mine", "run_root=here"]).jobs  # though none is there yet
    assert [(str(one.config.folder), one.config.pretrained.run) for one in jobs] == [
        ("here/demo/one/seed3", None),
        ("here/demo/one/seed4", None),
        ("here/demo/two/seed3", "here/demo/one/seed3"),
        ("here/demo/two/seed4", "here/demo/one/seed4"),
        ("here/demo/three/seed3", "here/demo/two/seed3"),
        ("here/demo/three/seed4", "here/demo/two/seed4"),
    ]
    assert [one.config.updates for one in jobs] == [9, 9, 7, 7, 8, 8]
    assert {one.config.updates for one in everything("sweep=mine", "updates=5")} == {5}
    with pytest.raises(UserError, match="is no run's folder"):  # what it begins with is left out
        sweeps.check(["sweep=mine", "run_root=here", "seed=3", "pretrained.run=elsewhere/seed3"])


@pytest.mark.parametrize(
    ("stages", "told"),
    [
        ("[{name: a, experiment: demo, overrides: [pretrained.run=b]}]", "b: is no earlier stage"),
        (
            "[{name: left, experiment: demo}, {name: b, experiment: demo, overrides: "
            "[pretrained.run=lefft]}]",
            "sweep=mine: b: pretrained.run=lefft: is no earlier stage, nor a folder with a /; did "
            "you mean left?",
        ),
        ("[{name: a, experiment: demo}, {name: a, experiment: demo}]", "two stages have the name"),
        ("[{name: a, experiment: dmo}]", "no such experiment as dmo; did you mean demo"),
        ("[{name: a, experiment: demo, condition: impla}]", "no such condition as impla; did you"),
        ("[]", "stages: List should have at least 1 item"),
        ("[{experiment: demo}]", "stages.0.name: Field required; a block has stages, seeds, over"),
    ],
)
def test_a_mistake_in_stages_is_one_clear_line(stages, told, own):
    own(f"- {{seeds: [0], stages: {stages}}}")
    with pytest.raises(UserError, match=re.escape(told)) as error:
        everything("sweep=mine")
    assert len(str(error.value).splitlines()) == 1


@pytest.mark.parametrize(
    ("word", "told"),
    [
        ("seed=range(0,0)", "seed=range(0,0): lists no values"),
        ("seed=range(0,9,0)", "seed=range(0,9,0): range() arg 3 must not be zero"),
        ("loggers=tensorboard,wandb", "several of them: loggers=[tensorboard,wandb]"),
    ],
)
def test_a_list_that_makes_no_jobs_is_one_clear_line(word, told):
    with pytest.raises(UserError, match=re.escape(told)) as error:
        sweeps.check(["experiment=demo", word])
    assert len(str(error.value).splitlines()) == 1


@pytest.mark.parametrize("name", ["best_gridworld", "best_lifting"])
def test_the_best_agents_are_chains(name):
    jobs = sweeps.check([f"sweep={name}", "seed=5", "run_root=nowhere"]).jobs
    begun = [job.config.pretrained.run for job in jobs]
    assert begun == [None, *(str(job.config.folder) for job in jobs[:-1])]
    assert len(jobs) == 3


@pytest.mark.parametrize(
    ("words", "told"),
    [
        (["hydra/launcher=joblb"], "joblb"),
        (["hydra/launcher=nothing"], 'pip install ".[sweep]"'),
        (["hydra/launcher=joblib", "hydra.launcher.n_job=2"], "n_job"),
        (["hydra.launcher.n_jobs=2"], "choose the launcher too, as in hydra/launcher=joblib"),
        (["hydra/sweeper=basic"], "hydra/sweeper=basic: sweeps here are over lists"),
    ],
)
def test_a_launcher_that_there_is_not_is_one_clear_line(words, told, tmp_path):
    with pytest.raises(UserError) as error:
        sweep.run(["experiment=demo", f"run_root={tmp_path}", *words])
    assert told in str(error.value)
    assert len(str(error.value).splitlines()) == 1
    assert list(tmp_path.iterdir()) == []


def test_help_lists_sweeps_and_launchers():
    shown = help_text()
    for name in (*SWEEPS, "joblib", "submitit_slurm", "submitit_local", "ray"):
        assert re.search(rf"^  {name} +\S", shown, re.MULTILINE), name


# What becomes of jobs: their command is a script that does as its seed says

SCRIPT = """
import os, signal, sys, time
seed = next(word for word in sys.argv if word.startswith("seed="))
if seed == "seed=2":
    print("error: first\\nerror: second", file=sys.stderr)
    sys.exit(2)
if seed == "seed=3":
    os.kill(os.getpid(), signal.SIGKILL)
if seed == "seed=4":
    raise RuntimeError("some bug")
if seed == "seed=9":
    for update in (1, 2):
        print(f"update {update}/6  5 frames/s", flush=True)
        print("another line", flush=True)
        time.sleep(2)
if seed in ("seed=5", "seed=6"):  # stops when it is told to, or later
    os.kill(os.getppid(), signal.SIGTERM)
    os.read(int(os.environ["ZIPF_SWEEP_PIPE"]), 1)
    if seed == "seed=6":
        os.kill(os.getppid(), signal.SIGTERM)
        signal.pause()
    print("stopped at update 3; the same command resumes")
    sys.exit(128 + signal.SIGTERM)
if seed == "seed=12":  # schedule.stop_after
    print("stopped at update 3; the same command resumes")
if seed in ("seed=10", "seed=11"):  # the time of its job is over
    os.kill(os.getppid(), signal.SIGUSR2)
    os.read(int(os.environ["ZIPF_SWEEP_PIPE"]), 1)
    print("stopped at update 3; the same command resumes")
    sys.exit(128 + signal.SIGTERM)
"""


@pytest.fixture
def scripted(tmp_path, monkeypatch, capsys):
    """A function that runs a sweep over seeds; returns the exit code and the lines shown."""
    monkeypatch.setattr(job, "TRAIN", (sys.executable, "-c", SCRIPT))

    def run(seeds):
        code = sweep.run([*TINY, "name=x", f"seed={seeds}", f"run_root={tmp_path}"])
        assert not (tmp_path / ".sweeps").exists() or seeds == "6,7"
        return code, capsys.readouterr().out.splitlines()

    return run


def test_jobs_that_fail_stop_no_others(scripted, tmp_path):
    code, lines = scripted("0,2,3,4,7")
    assert code == 2
    log = tmp_path / "demo" / "x" / "seed4" / "train.log"
    failures = [
        "2/5 demo x seed 2: failed: first; second",
        "3/5 demo x seed 3: failed: its process was killed by SIGKILL, as happens where a machine "
        "runs out of RAM",
        f"4/5 demo x seed 4: failed: RuntimeError: some bug (traceback in {log})",
    ]
    ended = [re.sub(r"\d+ s$", "", line) for line in lines[:-6] if "begins" not in line]
    done = "demo x seed {}: finished, {:,} updates, "
    updates = loading.read(TINY).updates
    assert ended == [f"1/5 {done.format(0, updates)}", *failures, f"5/5 {done.format(7, updates)}"]
    assert lines[-6:] == [
        "5 jobs: 2 finished, 3 failed",
        *failures,
        "the same command does what is missing",
        f"python -m zipf.report {tmp_path}/demo",
    ]
    assert "Traceback" in log.read_text()


def test_how_far_a_job_is_is_told_from_time_to_time(scripted, monkeypatch):
    monkeypatch.setattr(job, "REPORT_EVERY", 0.3)
    monkeypatch.setattr(progress, "REPORT_EVERY", 0.3)
    code, lines = scripted("9")
    assert code == 0
    begins, *told, finished = lines[:-2]
    assert "begins, in " in begins
    assert told == [f"1/1 demo x seed 9: update {n}/6  5 frames/s" for n in (1, 2)]
    assert "finished, " in finished


def test_the_file_of_a_job_that_has_ended_is_not_read_again_and_again(scripted, monkeypatch):
    read = []
    outcome = job.Board.outcome
    monkeypatch.setattr(
        job.Board, "outcome", lambda self, one: read.append(one.number) or outcome(self, one)
    )
    assert scripted("7,9")[0] == 0
    assert read.count(1) < read.count(2) / 2


@pytest.fixture
def staged(own, tmp_path, monkeypatch, capsys):
    """A function that runs three stages with some seeds; returns the exit code and the lines."""
    monkeypatch.setattr(job, "TRAIN", (sys.executable, "-c", SCRIPT))
    own(CHAIN)

    def run(seeds):
        code = sweep.run(["sweep=mine", f"run_root={tmp_path}", f"seed={seeds}"])
        return code, capsys.readouterr().out.splitlines()

    return run


def test_stages_run_one_after_another(staged, tmp_path):
    code, lines = staged("0,7")
    assert code == 0
    ended = [re.sub(r":.*", "", line) for line in lines if "finished, " in line]
    names = [f"demo {name} seed {seed}" for name in ("one", "two", "three") for seed in (0, 7)]
    assert ended == [f"{number}/6 {name}" for number, name in enumerate(names, start=1)]
    assert lines[-1] == f"python -m zipf.report {tmp_path}/demo"


def test_what_would_begin_with_the_weights_of_a_failed_run_is_named(staged):
    code, lines = staged("2,0")
    assert code == 2
    why = "not begun: begins with the weights of demo {} seed 2, which has not finished"
    assert lines[-6:-1] == [
        "6 jobs: 3 finished, 2 not begun, 1 failed",
        "1/6 demo one seed 2: failed: first; second",
        f"3/6 demo two seed 2: {why.format('one')}",
        f"5/6 demo three seed 2: {why.format('two')}",
        "the same command does what is missing",
    ]


def test_later_stages_wait_for_one_that_its_time_has_stopped(staged):
    code, lines = staged("12")
    assert code == 0
    assert "3 jobs: 3 stopped by schedule.stop_after or a callback" in lines
    assert any(line.startswith("2/3 demo two seed 12: not begun: begins with") for line in lines)


def test_a_signal_stops_later_stages(staged):
    code, lines = staged("5")
    assert code == 128 + signal.SIGTERM
    assert "3 jobs: 1 stopped, 2 not begun" in lines


@pytest.mark.parametrize(
    ("words", "window"),
    [
        (["updates=4"], ["window=last"]),
        (["updates=500"], []),
        (["updates=500", "schedule.window=[3,4],[5,6]"], ["window=own"]),
    ],
)
def test_the_suggested_report_shows_something(words, window):
    configs = [loading.read(list(one)) for one, _ in sweeps.expand([*TINY, *words])]
    assert sweep._window(configs) == window


def lines_of(text):
    return re.sub(r"\x1b\[[0-9;?]*[a-zA-Z]", "", text.replace("\r", "\n")).splitlines()


def test_a_sweep_says_when_it_will_have_ended(monkeypatch):
    now = [0.0]
    monkeypatch.setattr(progress.time, "monotonic", lambda: now[0])
    console = Console(file=io.StringIO(), width=200, highlight=False)
    shows = progress.SweepProgress(5, console)
    jobs = [job.Job(i, 5, f"run {i}", "", 9, ()) for i in range(1, 6)]

    def show(number, state, text, after=0.0):
        now[0] += after
        shows.show(jobs[number - 1], job.Outcome(state, text))

    show(1, "skipped", "skipped, is finished")
    show(2, "begun", "begins")
    show(3, "begun", "begins")
    show(2, "running", "update 3/9", after=60)
    show(2, "running", "update 6/9", after=70)
    show(2, "running", "update 7/9", after=70)
    show(2, "finished", "finished, 9 updates, 5 min", after=100)
    show(3, "failed", "failed: why")
    told = lines_of(console.file.getvalue())
    assert told[:-2] == [
        "1/5 run 1: skipped, is finished",
        "2/5 run 2: begins",
        "3/5 run 3: begins",
        "2/5 run 2: update 6/9",
    ]
    # Run 3 has been on its way for as long as run 2 took; then two run side by side.
    assert told[-2].startswith("2/5 run 2: finished, 9 updates, 5 min; about 5 min left, until ")
    assert told[-1] == "3/5 run 3: failed: why"


def test_a_terminal_has_a_bar(monkeypatch):
    console = Console(file=io.StringIO(), width=80, force_terminal=True, highlight=False)
    shows = progress.SweepProgress(2, console)
    first, second = (job.Job(i, 2, f"run {i}", "", 9, ()) for i in (1, 2))
    with shows:
        shows.show(first, job.Outcome("begun", "begins"))
        shows.show(first, job.Outcome("finished", "finished"))
        shows.show(second, job.Outcome("begun", "begins"))
        shows.show(second, job.Outcome("running", "update 3/9 " + "x" * 90))
        shows._live.refresh()
    told = lines_of(console.file.getvalue())
    assert any("1/2 jobs about 0 s left, until " in line for line in told)
    assert any(line.startswith("run 2: update 3/9") and line.endswith("…") for line in told)
    assert "2/2 run 2: update" not in "".join(told)


def test_a_signal_stops_the_running_job_and_begins_no_other(scripted):
    before = signal.getsignal(signal.SIGTERM)
    code, lines = scripted("5,7")
    assert code == 128 + signal.SIGTERM
    assert "1/2 demo x seed 5: stopped at update 3; the same command resumes" in lines
    assert "2 jobs: 1 stopped, 1 not begun" in lines
    assert signal.getsignal(signal.SIGTERM) is before


def test_a_job_that_its_time_has_stopped_is_no_failure(scripted):
    code, lines = scripted("12,7")
    assert code == 0
    assert "1/2 demo x seed 12: stopped at update 3; the same command resumes" in lines
    assert "2 jobs: 1 finished, 1 stopped by schedule.stop_after or a callback" in lines
    assert "the same command does what is missing" in lines


def test_a_cluster_stops_a_sweep_as_a_user_does(scripted):
    code, lines = scripted("10,7")
    assert code == 128 + signal.SIGUSR2
    assert "2 jobs: 1 stopped, 1 not begun" in lines


@pytest.mark.parametrize("ends", [True, False], ids=["again", "too often"])
def test_a_job_saves_before_submitit_gives_it_back_to_the_queue(ends, scripted, monkeypatch):
    """As in a process of submitit's, whose handler ends it, or raises after too many times."""

    def checkpoint_and_try_requeue(number, frame):
        assert job.Board.outcome(*told[-1][:2]).text.startswith("stopped at update 3: its time is")
        if ends:
            raise SystemExit(144)
        raise RuntimeError("timed-out too many times")

    told, tell = [], job.Board.tell
    monkeypatch.setattr(job.Board, "tell", lambda *of: (told.append(of), tell(*of)))
    before = signal.signal(signal.SIGUSR2, checkpoint_and_try_requeue)
    try:
        if ends:
            with pytest.raises(SystemExit):
                scripted("10")
        else:
            code, lines = scripted("11,7")
            assert code == 2
            last = "stopped at update 3; the same command resumes; timed-out too many times"
            assert f"1/2 demo x seed 11: {last}" in lines
            assert "2 jobs: 1 finished, 1 stopped" in lines
        assert signal.getsignal(signal.SIGUSR2) is checkpoint_and_try_requeue
    finally:
        signal.signal(signal.SIGUSR2, before)


def test_a_second_signal_stops_at_once(scripted):
    code, lines = scripted("6,7")
    assert code == 128 + signal.SIGTERM
    assert "2 jobs: 1 stopped, 1 not begun" in lines


def test_a_launcher_that_breaks_is_told(scripted, monkeypatch):
    """As joblib does when one of its workers is killed: it returns nothing of any job."""

    class Broken:
        def __init__(self, task):
            self.task = task

        def launch(self, overrides, first):
            self.task.board.tell(self.task.jobs[0], job.Outcome("finished", "finished"))
            self.task.board.tell(self.task.jobs[1], job.Outcome("begun", "begins"))
            raise RuntimeError("a worker\nwas killed")

    monkeypatch.setattr(launching, "launcher", lambda words, root, task, gpu: (Broken(task), ""))
    code, lines = scripted("0,7,8")
    assert code == 2
    failure = "failed: the launcher failed: RuntimeError: a worker was killed"
    assert f"2/3 demo x seed 7: {failure}" in lines
    assert f"3/3 demo x seed 8: {failure}" in lines
    assert "3 jobs: 1 finished, 2 failed" in lines


@pytest.mark.parametrize(
    ("words", "told"),
    [
        ([], True),
        (["hydra.launcher.gpus_per_node=1"], False),
        (["hydra.launcher.gres='gpu:1'"], False),
        (["+hydra.launcher.additional_parameters.gpus=1"], False),
        (["device=cpu"], False),
    ],
)
def test_a_launcher_that_gives_no_gpu_is_told(words, told, monkeypatch, tmp_path, capsys):
    plugin = pytest.importorskip("hydra_plugins.hydra_submitit_launcher.submitit_launcher")
    monkeypatch.setattr(plugin.SlurmLauncher, "launch", lambda *_: [])
    words = ["device=auto", "hydra/launcher=submitit_slurm", *words]
    sweep.run([*TINY, f"run_root={tmp_path}", *words])
    line = (
        "hydra.launcher.gpus_per_node=None: jobs are given no GPU, and device=auto is a CPU there"
    )
    assert (line in capsys.readouterr().out) == told


def test_a_job_stops_when_its_sweep_has_gone(monkeypatch):
    said = []
    reading, writing = os.pipe()
    monkeypatch.setenv(SWEEP_PIPE, str(reading))
    with StopSignals(said.append) as stop:
        assert not stop.requested
        os.close(writing)
        assert stop.requested == signal.SIGTERM
        assert stop.requested == signal.SIGTERM
    os.close(reading)
    assert len(said) == 1


def test_what_is_finished_is_told_from_the_files_alone(tmp_path, monkeypatch):
    words = [*TINY, "updates=2", f"run_root={tmp_path}"]
    config = loading.load(words)
    assert not run_folder.is_finished(config)
    assert runner.train(config) == 0
    before = contents(config.folder)

    def refuse(*_, **__):
        raise AssertionError("makes worlds")

    with monkeypatch.context() as patched:
        patched.setattr(runner.envs, "make_train", refuse)
        patched.setattr(feasibility, "problems", refuse)
        assert sweep.run(words) == 0
    assert contents(config.folder) == before
    for other in ("updates=3", "updates=1", "resume=never", "seed=1"):
        assert not run_folder.is_finished(loading.read([*words, other])), other
    name = f"name='{config.condition}'"
    assert not run_folder.is_finished(loading.read([*words, name, "agent.discount=0.5"]))
    for file in ("metrics.csv", "evaluations.csv", "run.json", "config.yaml", "checkpoint.pt"):
        path = config.folder / file
        content = path.read_bytes()
        path.write_bytes(content[:-9])
        assert not run_folder.is_finished(config), file
        path.write_bytes(content)
    assert run_folder.is_finished(config)


# Launchers at work

SHORT = [word for word in TINY if not word.startswith("evaluation.every=")]
SHORT += ["name=x", "updates=40", "evaluation.every=20", "schedule.window=[20,40]"]


def scores(root):
    """What a report says of the runs of seeds 0 and 1."""
    made = report.report([root / "demo" / "x" / f"seed{seed}" for seed in (0, 1)], root / "report")
    return [path.read_text() for path in made.files if path.suffix in (".csv", ".tex")]


def table(root, seed):
    path = root / "demo" / "x" / f"seed{seed}" / "evaluations.csv"
    return pd.read_csv(path).drop(columns="seconds")


@pytest.fixture(scope="module")
def beside(tmp_path_factory):
    """A sweep by joblib, two jobs at a time, one of which cannot begin: the folder, the exit code
    and what it showed."""
    root = tmp_path_factory.mktemp("beside")
    damaged = root / "demo" / "x" / "seed2" / "checkpoint.pt"
    damaged.parent.mkdir(parents=True)
    damaged.write_text("no checkpoint")
    words = [*SHORT, f"run_root={root}", "seed=2,0,1"]
    words += ["hydra/launcher=joblib", "hydra.launcher.n_jobs=2"]
    return root, words, sweep.run(words)


@pytest.mark.slow
def test_joblib_runs_jobs_beside_each_other(beside, capsys):
    root, words, code = beside
    assert code == 2
    for seed in (0, 1):
        assert run_folder.is_finished(loading.read([*SHORT, f"run_root={root}", f"seed={seed}"]))
    before = contents(root)
    assert sweep.run([word for word in words if "launcher" not in word]) == 2
    lines = capsys.readouterr().out.splitlines()
    assert "2/3 demo x seed 0: skipped, is finished" in lines
    assert "3 jobs: 2 were finished before, 1 failed" in lines
    assert any("1/3 demo x seed 2: failed" in line and "checkpoint" in line for line in lines)
    assert {path: what for path, what in contents(root).items() if "seed2" not in str(path)} == {
        path: what for path, what in before.items() if "seed2" not in str(path)
    }


@pytest.mark.slow
@pytest.mark.parametrize(
    "launcher",
    [
        ["hydra/launcher=submitit_local", "hydra.launcher.cpus_per_task=1"],
        ["hydra/launcher=ray", "hydra.launcher.init.num_cpus=1"],
    ],
    ids=["submitit", "ray"],
)
def test_other_launchers_make_the_same_runs(launcher, beside, tmp_path, capsys):
    root = beside[0]
    bad = tmp_path / "demo" / "x" / "seed2" / "checkpoint.pt"
    bad.parent.mkdir(parents=True)
    bad.write_text("no checkpoint")
    assert sweep.run([*SHORT, f"run_root={tmp_path}", "seed=2,0", *launcher]) == 2
    lines = capsys.readouterr().out.splitlines()
    assert "2 jobs: 1 finished, 1 failed" in lines
    assert any(line.startswith("2/2 demo x seed 0: finished, 40 updates") for line in lines)
    pd.testing.assert_frame_equal(table(root, 0), table(tmp_path, 0))


@pytest.mark.slow
def test_a_sweep_that_was_killed_gives_the_same_table_when_asked_for_again(
    beside, tmp_path, capsys
):
    """SIGKILL for all of its processes in the middle of the second run."""
    words = [*SHORT, f"run_root={tmp_path}", "seed=0,1"]
    process = begun(*words, cwd=tmp_path)
    metrics = tmp_path / "demo" / "x" / "seed1" / "metrics.csv"
    while not metrics.exists() or "\n12," not in metrics.read_text():
        assert process.poll() is None
        time.sleep(0.001)
    os.killpg(process.pid, signal.SIGKILL)
    process.communicate()
    assert 10 <= checkpoint.load(metrics.with_name("checkpoint.pt"))["update"] < 40

    assert sweep.run(words) == 0
    lines = capsys.readouterr().out.splitlines()
    assert "1/2 demo x seed 0: skipped, is finished" in lines
    assert "2 jobs: 1 finished, 1 was finished before" in lines
    assert scores(tmp_path) == scores(beside[0])


def begun(*arguments, cwd, **variables):
    """A sweep of one's own session, as on a terminal."""
    return subprocess.Popen(
        command("-m", *arguments),
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
        cwd=cwd,
        env={**os.environ, "PYTHONPATH": os.pathsep.join([str(PACKAGE), str(cwd)]), **variables},
    )


@pytest.mark.slow
def test_ctrl_c_in_a_parallel_sweep_stops_every_job_with_a_checkpoint(tmp_path):
    arguments = [*TINY, "updates=100000", "schedule.checkpoint_every=99999", "name=x"]
    arguments += ["evaluation.every=99999", f"run_root={tmp_path}", "seed=0,1,2"]
    process = begun(*arguments, "hydra/launcher=joblib", "hydra.launcher.n_jobs=2", cwd=tmp_path)
    running: list[Path] = []
    while len(running) < 2:
        assert process.poll() is None
        found = tmp_path.glob("demo/x/*/metrics.csv")
        running = [path for path in found if "\n2," in path.read_text()]
        time.sleep(0.05)
    os.killpg(process.pid, signal.SIGINT)
    output, errors = process.communicate(timeout=60)
    assert process.returncode == 128 + signal.SIGINT, errors
    assert "Traceback" not in errors
    assert output.count(": stopped at update") == 2
    assert "3 jobs: 2 stopped, 1 not begun" in output
    for path in running:
        update = checkpoint.load(path.parent / "checkpoint.pt")["update"]
        assert pd.read_csv(path)["update"].nunique() == update > 1


@pytest.mark.slow
def test_a_job_whose_place_submitit_needs_goes_on_where_it_was(tmp_path):
    """By the signal that its controller sends to it."""
    arguments = [*TINY, "updates=100", "schedule.checkpoint_every=99999", "name=x"]
    arguments += ["evaluation.every=99999", f"run_root={tmp_path}", "hydra/launcher=submitit_local"]
    process = begun(*arguments, cwd=tmp_path)
    metrics = tmp_path / "demo" / "x" / "seed0" / "metrics.csv"
    while not metrics.exists() or "\n2," not in metrics.read_text():
        assert process.poll() is None
        time.sleep(0.01)
    for path in Path("/proc").glob("[0-9]*/cmdline"):
        if b"submitit.core._submit" in path.read_bytes() and str(tmp_path) in path.read_text():
            os.kill(int(path.parent.name), signal.SIGUSR2)
    output, errors = process.communicate(timeout=120)
    assert process.returncode == 0, errors
    assert "1/1 demo x seed 0: stopped at update" in output
    assert output.count("1/1 demo x seed 0: begins") == 2
    assert "resumes at update " in (metrics.parent / "train.log").read_text()
    assert pd.read_csv(metrics)["update"].unique().tolist() == list(range(1, 101))


SEEN = """
import os
if "ZIPF_SWEEP_PIPE" in os.environ:
    open("seen", "w").write(os.environ.get("CUDA_VISIBLE_DEVICES", "all"))
"""


@pytest.mark.slow
@pytest.mark.parametrize(("words", "seen"), [((), "3"), (("hydra.launcher.gpus_per_node=0",), "")])
def test_jobs_of_submitit_on_this_machine_see_its_gpus(words, seen, tmp_path):
    (tmp_path / "seen_gpus.py").write_text(SEEN)
    arguments = [*TINY, "updates=1", "plugins=[seen_gpus]", "hydra/launcher=submitit_local"]
    process = begun(*arguments, *words, cwd=tmp_path, CUDA_VISIBLE_DEVICES="3")
    output, errors = process.communicate(timeout=120)
    assert process.returncode == 0, output + errors
    assert (tmp_path / "seen").read_text() == seen
