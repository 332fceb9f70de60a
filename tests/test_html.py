"""The report's page: everything is in it, nothing of a run folder runs, and browsers draw it."""

from __future__ import annotations

import json
import re
import shutil
import subprocess
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from PIL import Image
from plotly import graph_objects as go
from run_folders import (
    SITUATIONS,
    constant,
    refusal,
    row_of,
    write_external,
    write_run,
)

from zipf import report
from zipf.errors import UserError
from zipf.experiments.records import results, video_files
from zipf.experiments.reporting import (
    comparable,
    grids,
    tables,
)
from zipf.experiments.reporting.html import Cells, Section, Text, page, report_sections

HOSTILE = "<script>document.documentElement.dataset.owned=1</script>\"'&amp;</pre>"
VOID = {"meta", "link", "input", "img", "br", "line"}
ROWS = (
    SITUATIONS,
    "200,train,0,0,60,30,30.0",
    "200,train,0,1,30,10,10.0",
    "300,train,1,0,10,1,1.0",
    "300,uniform,0,0,50,40,40.0",
    "300,uniform,1,1,50,10,10.0",
    "300,rare,1,1,50,5,5.0",
)


class Page(HTMLParser):
    """A page, parsed: raises AssertionError where an element is not closed as it should be."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.open: list[str] = []
        self.tags: list[tuple[str, dict[str, str]]] = []
        self.scripts: list[str] = []
        self.data: dict[str, Any] = {}
        self.text: list[str] = []
        self.cells: list[list[str]] = []
        self.feed(text)
        self.close()
        assert not self.open

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append((tag, {name: value or "" for name, value in attrs}))
        if tag not in VOID:
            self.open.append(tag)
        if tag == "tr":
            self.cells.append([])
        if tag in ("td", "th"):
            self.cells[-1].append("")

    def handle_startendtag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append((tag, {name: value or "" for name, value in attrs}))

    def handle_endtag(self, tag: str) -> None:
        assert self.open, f"</{tag}> closes nothing"
        assert self.open.pop() == tag

    def handle_data(self, data: str) -> None:
        inside = self.open[-1] if self.open else ""
        if inside == "script":
            attributes = next(given for tag, given in reversed(self.tags) if tag == "script")
            if attributes.get("type") == "application/json":
                self.data[attributes["id"]] = json.loads(data)
            else:
                self.scripts.append(data)
        elif inside in ("td", "th"):
            self.cells[-1][-1] += data
        if inside not in ("script", "style"):
            self.text.append(data)

    def attributes(self, name: str) -> list[str]:
        return [given[name] for _, given in self.tags if name in given]


def write_runs(root: Path) -> None:
    """Two conditions and an external agent, with situations and a failed seed."""
    write_run(root, {100: (0.1, 0.2, 0.3), 200: (0.4, 0.5, 0.6), 300: (0.7, 0.8, 0.9)})
    write_run(root, constant(0.5), seed=1, situations=ROWS)
    write_run(
        root,
        constant(0.25),
        condition="r2d2",
        settings="agent:\n  learning_rate: 0.002\n  steps: 3\n",
    )
    write_external(root, {300: (0.5, 0.6, 0.7)})


def made(root: Path) -> str:
    return page(report_sections(tables.score_tables(results.load_runs([root]))))


@pytest.fixture(scope="module")
def written(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, str]:
    root = tmp_path_factory.mktemp("runs")
    write_runs(root)
    add_videos(root / "gridworld/impala/seed1")
    return root, made(root)


def add_videos(folder: Path) -> None:
    """Videos of one situation, without a failure."""
    (folder / "videos").mkdir()
    picture = Image.fromarray(np.zeros((8, 8, 3), np.uint8))
    picture.save(folder / "videos/rarest_success.gif")
    video = video_files.Video(
        file="rarest_success.gif",
        outcome="success",
        seed=31,
        episode_return=0.5,
        length=321,
        every=3,
    )
    situation = video_files.VideosOfSituation(
        title="rarest situation",
        level="gridworld/uniform",
        ranks={"map": 19, "target": 18},
        episodes=200,
        successes=200,
        videos=(video,),
    )
    described = video_files.Videos(update=300, situations=(situation,))
    (folder / "videos" / video_files.NAME).write_text(described.model_dump_json())


# --- contents --------------------------------------------------------------------------------


def test_the_page_is_well_formed_and_needs_nothing_else(written: tuple[Path, str]) -> None:
    _, text = written
    parsed = Page(text)
    assert text.startswith("<!DOCTYPE html>")
    identifiers = parsed.attributes("id")
    assert len(set(identifiers)) == len(identifiers)
    for address in [*parsed.attributes("src"), *parsed.attributes("href")]:
        assert address.startswith(("data:", "#"))
        if address.startswith("#"):
            assert address[1:] in identifiers
    assert len(parsed.scripts) == 2  # Plotly's and ours
    assert not [name for _, given in parsed.tags for name in given if name.startswith("on")]


def test_every_table_is_there_with_all_its_numbers(written: tuple[Path, str]) -> None:
    root, text = written
    shown = Page(text).cells
    for table in tables.score_tables(results.load_runs([root])):
        for grid in (grids.main_grid(table), *grids.lower_grids(table)):
            for line in (*grid.lines, *grid.baselines):
                assert grid.cells(line) in shown
    assert shown[0][:4] == ["Condition", "Seeds", "Train (Zipfian)", "paper"]
    assert shown[1][:3] == ["IMPALA", "2/3", "0.45 ± 0.05"]


def test_every_run_is_described(written: tuple[Path, str]) -> None:
    root, text = written
    parsed = Page(text)
    everything = "".join(parsed.text)
    for run in results.load_runs([root]):
        assert run.label in everything
        if run.description.command:
            assert run.description.command in everything
        if not run.description.external:
            assert (run.folder / "config.yaml").read_text().strip() in everything
    assert [cells for cells in parsed.cells if cells[:3] == ["IMPALA", "1", "300"]]


def test_the_options_that_differ_are_listed_and_no_others(written: tuple[Path, str]) -> None:
    root, text = written
    found = comparable.differences(results.load_runs([root]))
    assert found.lines == (
        ("agent.learning_rate", ("0.001", "0.002")),
        ("agent.steps", ("–", "3")),
    )
    assert [[run.description.seed for run in column] for column in found.columns] == [[0, 1], [0]]
    shown = Page(text).cells
    assert ["agent.learning_rate", "0.001", "0.002"] in shown
    assert ["Option", "IMPALA, seeds 0, 1", "R2D2, seed 0"] in shown


def test_an_option_that_older_runs_lack_differs_where_it_changes_something(tmp_path: Path) -> None:
    write_run(tmp_path, constant(0.1), settings="network: {name: matching}\n")
    for seed, matcher in enumerate(("learned", "fixed"), 1):
        settings = f"network: {{name: matching, matcher: {matcher}}}\nlearning_rate_decay: null\n"
        write_run(tmp_path, constant(0.1), seed=seed, settings=settings)
    found = comparable.differences(results.load_runs([tmp_path]))
    assert found.lines == (("network.matcher", ("–", "fixed")),)


@pytest.mark.parametrize(
    ("value", "text"),
    [
        (True, "true"),
        (None, "null"),
        (1e-8, "1e-08"),
        ([2, [0.5, "a"]], "[2,[0.5,a]]"),
        ("lstm", "lstm"),
    ],
)
def test_values_as_on_a_command_line(value: Any, text: str) -> None:
    assert comparable.value_text(value) == text


def test_figures_have_the_data_of_the_runs(written: tuple[Path, str]) -> None:
    _, text = written
    parsed = Page(text)
    assert sorted(parsed.data) == sorted(parsed.attributes("data-specification"))
    of_rows = [f"gridworld-{kind}-{k}" for kind in ("ranks", "frequency") for k in (0, 1)]
    assert sorted(parsed.data) == sorted([*(f"gridworld-learning-{k}" for k in range(3)), *of_rows])
    curves = parsed.data["gridworld-learning-1"]
    seed, other, median = (
        trace for trace in curves["data"] if trace["legendgroup"] == "row impala"
    )
    assert seed["y"] == [0.2, 0.5, 0.8]
    assert other["y"] == [0.5, 0.5, 0.5]
    assert median["y"] == [0.35, 0.5, 0.65]
    place = curves["data"].index(median)
    axes = curves["axes"]
    assert axes["update"]["x"][place] == [100, 200, 300]
    assert axes["frames"]["x"][place] == [409600, 819200, 1228800]
    assert axes["time"]["x"][place] == pytest.approx([250 / 60, 500 / 60, 750 / 60])
    assert axes["update"]["shapes"][0]["x0"] == 100
    assert axes["time"]["shapes"] == []
    assert all(len(axis["x"]) == len(curves["data"]) for axis in axes.values())
    # An external agent's updates are not ours, and its time is not known.
    rare = parsed.data["gridworld-learning-2"]
    assert rare["data"][0]["x"] == rare["axes"]["frames"]["x"][0]
    (external,) = (k for k, one in enumerate(rare["data"]) if one["name"].startswith("PPO"))
    assert rare["axes"]["time"]["x"][external] == [None]

    success = parsed.data["gridworld-ranks-0"]["data"]
    (line,) = (trace for trace in success if trace.get("customdata"))
    assert (line["x"], line["y"], line["customdata"]) == ([0, 1], [0.8, 0.2], [50, 50])
    (met,) = (
        trace
        for trace in parsed.data["gridworld-frequency-0"]["data"]
        if trace["legendgroup"] == "train"
    )
    assert (met["x"], met["y"]) == ([1, 2], [0.9, 0.1])


def test_plotly_knows_all_that_figures_say(written: tuple[Path, str], tmp_path: Path) -> None:
    header = f"{SITUATIONS},visits,visits_map,visits_target"
    write_run(tmp_path, constant(0.5), situations=(header, "300,uniform,1,1,50,10,10.0,0,3,50"))
    for text in (written[1], made(tmp_path)):
        for specification in Page(text).data.values():
            figure = go.Figure(specification["data"], specification["layout"])  # raises ValueError
            assert len(figure.data) == len(specification["data"])


def test_a_situation_that_training_never_met_is_at_0(tmp_path: Path) -> None:
    header = f"{SITUATIONS},visits,visits_map,visits_target"
    rows = (
        header,
        "300,uniform,0,0,50,40,40.0,2000,2000,2000",
        "300,uniform,1,1,50,10,10.0,0,0,0",
    )
    write_run(tmp_path, constant(0.5), situations=rows)
    drawn = Page(made(tmp_path)).data["gridworld-visits-0"]
    band, line = drawn["data"]
    assert (line["x"], line["y"]) == ([0.1, 2000], [0.2, 0.8])
    assert line["customdata"] == [[0, 50], [2000, 50]]
    assert band["x"] == [0.1, 2000, 2000, 0.1]
    axis = drawn["layout"]["xaxis"]
    assert (axis["type"], axis["range"][0] < -1, axis["range"][1] > 3.3) == ("log", True, True)
    assert axis["tickvals"] == [0.1, 1, 10, 100, 1000]
    assert axis["ticktext"] == ["0", "1", "10", "100", "1k"]


def test_levels_drawn_inside_one_train_level_are_as_frequent_as_they_were(tmp_path: Path) -> None:
    """`zipfian([...])` draws environments by its law in training and in evaluations on it."""
    header = "update,level_kind,level,episodes,successes,return_sum"
    rows = (header, "300,train,0,60,5,5.0", "300,train,1,30,5,5.0", "300,train,2,10,5,5.0")
    write_run(tmp_path, constant(0.5), situations=rows, situation={"level": 3})
    drawn = Page(made(tmp_path)).data["gridworld-frequency-0"]["data"]
    assert drawn[0]["y"] == pytest.approx([0.6, 0.3, 0.1])


def test_a_run_without_evaluations_has_a_page(tmp_path: Path) -> None:
    write_run(tmp_path, {})
    assert "no evaluation yet" in "".join(Page(made(tmp_path)).text)


def test_videos_are_in_the_page(written: tuple[Path, str]) -> None:
    _, text = written
    parsed = Page(text)
    (picture,) = (given for tag, given in parsed.tags if tag == "img")
    assert picture["src"].startswith("data:image/gif;base64,R0lG")
    everything = "".join(parsed.text)
    assert "Success: seed 31, return 0.5, 321 frames, one in 3 shown" in everything
    assert "No failure in 200 episodes." in everything
    assert "rank: map 19, target 18" in everything


def test_a_film_can_be_stopped(tmp_path: Path) -> None:
    folder = write_run(tmp_path, constant(0.5))
    add_videos(folder)
    described = folder / "videos" / video_files.NAME
    described.write_text(described.read_text().replace(".gif", ".mp4"))
    (folder / "videos/rarest_success.mp4").write_bytes(b"\0\0\0\x18ftypisom")
    (film,) = (given for tag, given in Page(made(tmp_path)).tags if tag == "video")
    assert film["src"] == "data:video/mp4;base64,AAAAGGZ0eXBpc29t"
    assert "controls" in film
    assert "autoplay" not in film


def test_videos_are_videos(tmp_path: Path) -> None:
    folder = write_run(tmp_path, constant(0.5))
    add_videos(folder)
    (folder / "videos/rarest_success.gif").write_text("#!/bin/sh")
    with pytest.raises(UserError, match=r"rarest_success\.gif: is no GIF file"):
        made(tmp_path)
    described = folder / "videos" / video_files.NAME
    described.write_text(described.read_text().replace("rarest_success", "../../secret"))
    with pytest.raises(UserError, match=r"videos\.json: is damaged \(situations\.0\.videos\.0"):
        made(tmp_path)


def test_sections_can_be_added() -> None:
    cells = Cells("Claims", ["Claim", "Holds"], [["Rare is harder", "yes"]], leading=2)
    parsed = Page(page([Section("What the paper claims", (Text("Of all tables."), cells))]))
    assert ["Rare is harder", "yes"] in parsed.cells
    assert "What the paper claims" in parsed.text


# --- safety and sameness ---------------------------------------------------------------------


def write_hostile(root: Path) -> None:
    """A run whose every text tries to run a script."""
    row = {**row_of("impala"), "title": HOSTILE}
    levels = json.loads(
        json.dumps(
            [
                {
                    "level_kind": kind,
                    "level": f"{kind}{HOSTILE}",
                    "weight": 1.0,
                    "normalised": False,
                    "references": {},
                }
                for kind in ("train", "uniform", "rare")
            ]
        )
    )
    rank = "<img src=x onerror=alert(1)>"
    folder = write_run(
        root,
        {},
        condition="impala",
        row=row,
        experiment="x",
        paper=None,
        levels=levels,
        situation={rank: 3},
        settings=yaml.safe_dump({"agent": {HOSTILE: HOSTILE}}),
        **dict.fromkeys(("command", "commit", "version", "torch", "device", "precision"), HOSTILE),
    )
    quoted = f'"{levels[0]["level"].replace(chr(34), chr(34) * 2)}"'
    lines = ["update,frames,seconds,level_kind,level,episodes,score,success,return,length"]
    for one in levels:
        quoted = '"' + one["level"].replace('"', '""') + '"'
        lines.append(f"300,4096,1.0,{one['level_kind']},{quoted},10,0.5,0.5,0.5,3.0")
    (folder / "evaluations.csv").write_text("\n".join(lines) + "\n")
    header = f"update,level_kind,{rank},episodes,successes,return_sum"
    rows = [f"300,{kind},{place},10,5,5.0" for kind in ("train", "uniform") for place in range(3)]
    (folder / "situations.csv").write_text("\n".join([header, *rows]) + "\n")
    other = write_run(
        root / "other",
        {},
        condition="b",
        experiment="x",
        paper=None,
        levels=levels,
        situation={rank: 3},
    )
    assert other != folder


def test_nothing_of_a_run_folder_runs(tmp_path: Path) -> None:
    write_hostile(tmp_path)
    text = made(tmp_path)
    parsed = Page(text)
    assert len(parsed.scripts) == 2
    assert HOSTILE in "".join(parsed.text)
    assert "<script>document" not in text
    assert "<img src=x" not in text
    assert not [tag for tag, _ in parsed.tags if tag in ("img", "iframe", "object", "base")]
    assert [given for _, given in parsed.tags if given.get("value") == "row impala"]
    for name, specification in parsed.data.items():
        for trace in specification["data"]:  # what Plotly would read as HTML
            assert "<" not in trace.get("name", ""), name
        titles = json.dumps(specification["layout"]).replace("<b>", "").replace("</b>", "")
        assert "<" not in titles
    policy = next(given["content"] for _, given in parsed.tags if "http-equiv" in given)
    assert "default-src 'none'" in policy
    (scripts,) = re.findall("script-src ([^;]*);", policy)
    assert re.fullmatch("'sha256-[^']*' 'sha256-[^']*'", scripts)


def test_the_same_runs_give_the_same_bytes(written: tuple[Path, str]) -> None:
    root, text = written
    assert made(root) == text


# --- the command -----------------------------------------------------------------------------


def test_the_command_writes_the_page(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    write_run(tmp_path / "runs", constant(0.5))
    assert report.main([str(tmp_path / "runs"), "html=true"]) == 0
    beside = tmp_path / "runs/report/report.html"
    assert f"Wrote {beside.as_posix()}" in capsys.readouterr().out
    chosen = tmp_path / "mine.html"
    assert report.main([str(tmp_path / "runs"), f"html={chosen}"]) == 0
    assert chosen.read_bytes() == beside.read_bytes()


def test_a_folder_is_not_taken_for_the_page(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    write_run(tmp_path, constant(0.5))
    told = refusal(capsys, str(tmp_path), "html=runs")
    assert "html=runs: should be true, or a name that ends in .html" in told


# --- in a browser ----------------------------------------------------------------------------

CHROMIUM = next(
    filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None
)


@pytest.mark.skipif(CHROMIUM is None, reason="no Chromium is installed")
def test_a_browser_draws_every_figure_and_asks_for_nothing(tmp_path: Path) -> None:
    assert CHROMIUM is not None
    write_runs(tmp_path / "runs")
    add_videos(tmp_path / "runs/gridworld/impala/seed1")
    write_hostile(tmp_path / "runs")
    text = made(tmp_path / "runs")
    (tmp_path / "page.html").write_text(text, encoding="utf-8")
    log = tmp_path / "network.json"
    done = subprocess.run(
        [
            *(CHROMIUM, "--headless", "--no-sandbox", "--disable-gpu", "--enable-logging=stderr"),
            *("--disable-background-networking", "--disable-component-update"),
            *(f"--user-data-dir={tmp_path / 'profile'}", "--no-first-run"),
            *("--virtual-time-budget=20000", "--window-size=390,800", f"--log-net-log={log}"),
            *("--dump-dom", (tmp_path / "page.html").as_uri()),
        ],
        capture_output=True,
        text=True,
        timeout=120,
    )
    figures = text.count("data-specification=")
    assert figures > 5
    assert f'data-drawn="{figures}"' in done.stdout
    assert len(re.findall('<div class="[^"]*svg-container', done.stdout)) == figures
    assert "data-owned" not in done.stdout
    assert "CONSOLE" not in done.stderr  # neither an error nor a refusal of the page's policy
    assert (tmp_path / "page.html").as_uri() in log.read_text()
    assert requests(log) == []


def requests(log: Path) -> list[str]:
    """What pages asked the network for; Chromium itself asks for updates of its own."""
    started = [event.get("params", {}) for event in json.loads(log.read_text())["events"]]
    own = "not an origin"
    of_pages = (given for given in started if given.get("initiator", own) != own)
    return [given["url"] for given in of_pages if not given["url"].startswith(("file:", "data:"))]
