"""Searches: which values are tried, by which scores, and what becomes of an interrupted one."""

import csv
import re

import pytest
from conftest import TINY, run

from zipf.errors import UserError
from zipf.experiments.options.catalogue import help_text
from zipf.experiments.sweeping import job, search, sweep

RATE = "agent.learning_rate=tag(log,interval(1e-4,1e-2))"
ASKED = [*TINY, RATE, "agent.discount=0.9,0.99", "seed=0,1", "search=random", "search.trials=4"]


@pytest.fixture
def finished(monkeypatch, tmp_path):
    """Runs that have finished, whose scores are given: their folders, to add to. Nothing is
    trained."""
    folders = {}
    monkeypatch.setattr(search.sweeps.loading, "check", lambda *_: None)
    monkeypatch.setattr(search.run_folder, "is_finished", lambda config: config.folder in folders)
    monkeypatch.setattr(search.Search, "_score", lambda _, folder: folders[folder])
    monkeypatch.chdir(tmp_path)
    return folders


def asked(*words):
    found = search.asked([*ASKED, *words])
    assert found is not None
    return found


def test_trials_are_drawn_from_the_seed_alone(finished):
    one, again, more = asked(), asked(), asked("search.trials=6")
    jobs = one.jobs
    assert [job.overrides for job in jobs] == [job.overrides for job in again.jobs]
    assert [job.overrides for job in more.jobs][:8] == [job.overrides for job in jobs]
    assert len(jobs) == 8
    assert one.folder == more.folder
    assert asked("search.seed=1").folder != one.folder
    assert asked("search.seed=1").jobs[0].overrides != jobs[0].overrides
    rates = {job.config.agent.learning_rate for job in jobs}
    assert len(rates) == 4
    assert all(1e-4 <= rate <= 1e-2 for rate in rates)
    assert {job.config.agent.discount for job in jobs} <= {0.9, 0.99}
    assert {job.config.seed for job in jobs} == {0, 1}


def test_the_best_trial_is_the_first_line_and_has_a_command(finished):
    one = asked()
    jobs = one.jobs
    for number, (first, second) in enumerate(zip(jobs[::2], jobs[1::2], strict=True)):
        if number < 3:  # the last trial has one of its seeds, and the best score
            finished[first.config.folder] = number / 10
        finished[second.config.folder] = number / 10 + 0.2
    one.tell()
    head, names, *rows, best = one.summary()
    assert head.startswith("4 trials of search=random, by validation score over updates 400 to 500")
    assert names.split() == [
        "trial",
        "validation",
        "seeds",
        "agent.learning_rate",
        "agent.discount",
    ]
    assert [row.split()[:3] for row in rows] == [
        ["3", "0.3000", "2/2"],
        ["2", "0.2000", "2/2"],
        ["1", "0.1000", "2/2"],
        ["4", "0.5000", "1/2"],
    ]
    chosen = jobs[4]
    rate = f"agent.learning_rate={chosen.config.agent.learning_rate:g}"
    assert best.startswith("best: python -m zipf.train -m experiment=demo ")
    assert best.endswith(f"{rate} agent.discount={chosen.config.agent.discount:g} seed=0,1")
    other = search.asked(ASKED, "own")
    other.tell()
    *_, elsewhere = other.summary()
    assert elsewhere.startswith("best: python -m zipf.train --config-dir own -m experiment=demo")
    with open(one.folder / "trials.csv") as file:
        table = list(csv.DictReader(file))
    assert [row["trial"] for row in table] == ["3", "2", "1", "4"]
    assert table[0]["folder"] == str(chosen.config.folder.parent)


def test_a_window_that_is_not_reached_is_said(finished):
    one = asked("updates=6", "search.objective=train")
    one.tell()
    head, *_, last = one.summary()
    assert "by train score at the last evaluation (schedule.window=[400,500] begins after" in head
    assert last == "no trial has finished with all its seeds"


def test_there_are_no_two_trials_alike(finished):
    words = [*TINY, "memory.size=8,16", "memory.layers=range(1,3)", "search=random"]
    found = search.asked(words)
    assert len(found.jobs) == len({job.overrides for job in found.jobs}) == 4


def test_whole_numbers_and_the_ends_of_an_interval():
    override = search.command_line.parse(["a=int(interval(1,3))", "a=tag(int,log,interval(1,8))"])
    whole, logarithmic = map(search._dimension, override)
    rng = search.np.random.default_rng(0)
    drawn = [whole.draw(rng) for _ in range(300)]
    assert {*drawn} == {"1", "2", "3"}
    assert all(drawn.count(one) > 70 for one in "123")
    assert {logarithmic.draw(rng) for _ in range(300)} == {*"12345678"}
    narrow = search.Dimension("a", (), 0.12345, 0.12346)
    assert 0.12345 <= float(narrow.draw(rng)) <= 0.12346


@pytest.mark.parametrize(
    ("words", "told"),
    [
        (["search.objective=rare"], "search.objective=rare: what is chosen by rare scores is no "),
        (["search.objective=uniform"], "should be train or validation"),
        (["search.objective=fresh"], "should be train or validation"),
        (["search.objective=trian"], "search.objective=trian: should be 'train' or 'validation'"),
        (["search.trials=0"], "search.trials=0: should be greater than or equal to 1"),
        (["search.trial=4"], "search.trial: no such option; did you mean trials?"),
        (["search.batch=4"], "search.batch: no such option"),
        (["search=randm"], "search=randm: no such search; there is random"),
        (["sweep=demo"], "sweep=demo: a search is of one experiment"),
        (["experiment=demo,gridworld"], "experiment=demo,gridworld: a search is of one experiment"),
        (["agent.discount=interval(1,0.9)"], "should be two numbers, the smaller one first"),
        (["agent.discount=tag(log,interval(0,1))"], "should begin above 0"),
        (["agent.discount=tag(logg,interval(0,1))"], "no such tag as logg"),
        (["memory.size=tag(int,log,interval(0.5,8))"], "whole numbers should have whole ends"),
        (["agent.discount=glob(*)"], "list the values"),
        (["seed=interval(0,3)"], "seed=interval(0,3): list the values, as in seed=a,b"),
        (["seed=range(0,0)"], "seed=range(0,0): lists no values"),
        (["search=random,other"], "search=random,other: should be one value"),
        (["name=x"], "two trials would use this folder"),
    ],
)
def test_a_mistake_is_one_clear_line(words, told, finished, tmp_path):
    with pytest.raises(UserError, match=re.escape(told)) as error:
        asked(*words)
    assert len(str(error.value).splitlines()) == 1
    assert list(tmp_path.iterdir()) == []


def test_what_is_no_search_says_how_to_make_one():
    with pytest.raises(UserError, match="there is nothing to search; give an option an interval"):
        search.asked([*TINY, "seed=0,1", "search=random"])
    with pytest.raises(UserError, match=r"search\.trials=3: choose the search, too: search=random"):
        search.asked([*TINY, RATE, "search.trials=3"])
    with pytest.raises(UserError, match="or draw them with search=random"):
        sweep.run([*TINY, RATE])
    assert search.asked([*TINY, "seed=0,1"]) is None


def test_help_has_the_options_of_a_search():
    told = "search.trials=20 search.objective=validation search.seed=0"
    assert re.search(rf"^  random +\S.*{re.escape(told)}$", help_text(), re.MULTILINE)


@pytest.mark.parametrize("seed", ["0", "0,1"])
def test_trials_that_do_not_fit_are_one_clear_line(seed, monkeypatch, tmp_path):
    """And not the runs of a seed that is not asked for."""
    monkeypatch.chdir(tmp_path)
    words = ["experiment=demo", "search=random", RATE, f"seed={seed}"]
    for wrong, told in (
        (["agent=supervised"], "agent=supervised: there are no questions about"),
        (["run_root='~nouser/x'"], "run_root=~nouser/x: cannot be a folder"),
    ):
        with pytest.raises(UserError, match=f"^{told}") as error:
            search.asked([*words, *wrong])
        assert len(str(error.value).splitlines()) == 1


@pytest.mark.slow
def test_a_search_trains_and_is_not_done_twice(tmp_path, monkeypatch, capsys):
    words = [*TINY, "updates=4", f"run_root={tmp_path}", RATE, "search=random", "search.trials=2"]
    assert sweep.run(words) == 0
    lines = capsys.readouterr().out.splitlines()
    assert "2 jobs: 2 finished" in lines
    assert f"python -m zipf.report {tmp_path}/demo window=last" in lines
    table = [line.split() for line in lines[-3:-1]]
    assert sorted(float(row[1]) for row in table)[::-1] == [float(row[1]) for row in table]
    monkeypatch.setattr(job, "TRAIN", ("false",))
    assert sweep.run(words) == 0
    again = capsys.readouterr().out.splitlines()
    assert "2 jobs: 2 were finished before" in again
    assert again[-5:] == lines[-5:]


def test_a_search_without_m_says_so():
    done = run(*ASKED)
    assert done.returncode == 2
    assert (
        done.stderr == "error: search=random: is a sweep of many runs: add -m, without --explain\n"
    )
