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
from run_folders import (
    SITUATIONS,
    constant,
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
from zipf.experiments.reporting.panels import looks_of
from zipf.experiments.reporting.seed_statistics import seed_statistics

HOSTILE = "<script>document.documentElement.dataset.owned=1</script>\"'&amp;</pre>"
VOID = {"meta", "link", "input", "img", "br", "wbr"}
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
    found = tables.score_tables(results.load_runs([root]))
    return page(report_sections([*map(seed_statistics, found)], looks_of(found)))


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
    assert len(parsed.scripts) == 1
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


def titles(text: str, name: str) -> list[str]:
    """What browsers show of the points of a picture."""
    picture = re.search(rf'aria-label="[^"]*: {name}[^"]*"[^>]*><svg.*?</svg>', text, re.DOTALL)
    assert picture, re.findall('aria-label="(.*?)"', text)
    return re.findall("<title>(.*?)</title>", picture[0])


def test_figures_have_the_data_of_the_runs(written: tuple[Path, str]) -> None:
    _, text = written
    shown = titles(text, r"learning curves, Uniform")
    for point in ("IMPALA: 0.350 at 409,600 frames", "IMPALA: 0.650 at 1,228,800 frames"):
        assert point in shown  # of the median of seeds
    assert "PPO †: 0.600 at 1,228,800 frames" in shown
    minutes = titles(text, r"score against minutes, Uniform")
    assert "IMPALA: 0.350 at 4 minutes" in minutes
    assert not any("PPO" in point for point in minutes)  # its time is not known
    ranks = titles(text, r"success against frequency rank, Map")
    assert {"IMPALA, rank 1: 0.800 of 50 episodes", "IMPALA, rank 2: 0.200 of 50 episodes"} <= {
        *ranks
    }
    assert "Train (Zipfian), rank 1: 90.000%" in titles(text, "how often situations occur, Map")
    assert "IMPALA: Rare 0.55" in titles(text, "what the training score hides")
    assert any(
        re.fullmatch(r"IMPALA: 0\.\d\d \[0\.\d\d, 0\.\d\d\]", point)
        for point in titles(text, "interquartile mean with 95 % interval across seeds")
    )
    assert "<image" in text  # a heat map


def test_pictures_say_what_they_show(written: tuple[Path, str]) -> None:
    """A panel's title is that of a picture of one panel."""
    labels = Page(written[1]).attributes("aria-label")
    assert "gridworld: interquartile mean with 95 % interval across seeds" in labels
    assert "gridworld: what the training score hides" in labels
    assert "gridworld: learning curves, Rare" in labels


def test_conditions_of_one_title_have_their_own_colours(tmp_path: Path) -> None:
    row = {"title": "Mine", "order": None, "colour": None, "line": "solid"}
    for condition in ("a", "b"):
        write_run(tmp_path, constant(0.5), condition=condition, row=row)
    swatches = re.findall('class="swatch" style="background: (.*?)"', made(tmp_path))
    assert swatches[:2] == swatches[2:]  # of the table, and of the lines
    assert len(set(swatches)) == 2


def test_lines_can_be_hidden_one_by_one(written: tuple[Path, str]) -> None:
    parsed = Page(written[1])
    boxes = {given["value"] for tag, given in parsed.tags if tag == "input"}
    assert boxes == {"row impala", "row r2d2", "row PPO †"}
    assert boxes <= set(parsed.attributes("data-key"))


def test_an_agent_has_one_colour_on_the_page(written: tuple[Path, str]) -> None:
    _, text = written
    assert text.count("background: #0072b2") == 2  # in the table and among the lines
    assert "stroke: #0072b2" in text


def test_a_page_of_a_dozen_lines_is_small(tmp_path: Path) -> None:
    for number in range(12):
        write_run(tmp_path, constant(number / 12), condition=f"agent{number}", situations=ROWS)
    assert len(made(tmp_path)) < 500_000


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
    assert len(parsed.scripts) == 1
    assert HOSTILE in "".join(parsed.text)
    assert "<script>document" not in text
    assert "<img src=x" not in text
    assert not [tag for tag, _ in parsed.tags if tag in ("img", "iframe", "object", "base")]
    assert [given for _, given in parsed.tags if given.get("value") == "row impala"]
    policy = next(given["content"] for _, given in parsed.tags if "http-equiv" in given)
    assert "default-src 'none'" in policy
    (scripts,) = re.findall("script-src ([^;]*);", policy)
    assert re.fullmatch("'sha256-[^']*'", scripts)


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


def test_a_page_is_not_older_than_the_tables_beside_it(tmp_path: Path) -> None:
    write_run(tmp_path / "runs", constant(0.5))
    output = tmp_path / "runs/report"
    report.report([tmp_path / "runs"], output, html="")
    beside = output / "report.html"
    assert "mine" not in beside.read_text()
    write_run(tmp_path / "runs", constant(0.75), condition="mine")
    assert beside in report.report([tmp_path / "runs"], output).files
    assert "mine" in beside.read_text()
    report.report([tmp_path / "runs"], tmp_path / "elsewhere")
    assert not (tmp_path / "elsewhere/report.html").exists()


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
    assert done.stdout.count("<svg") == text.count("<svg") > 5
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
