"""The pages keep their word: code runs, commands are accepted, tables are true, paths exist."""

import ast
import importlib
import re
import runpy
import sys
from pathlib import Path

import pytest
import write_tables
from conftest import naming, slow_but
from pages import DOCS, PAGES, RECORD, ROOT, TEXT, blocks, commands, files

import zipf.report
from zipf import compiled, envs, plugins
from zipf.envs import family
from zipf.experiments.building import feasibility, loading
from zipf.experiments.options import command_line, config_files
from zipf.experiments.options.schema import Config, EvaluateOptions
from zipf.experiments.playing import videos
from zipf.experiments.playing.playing import PlayOptions
from zipf.experiments.reporting.windows import parse_window
from zipf.experiments.sweeping import search, sweeps
from zipf.experiments.training import runner

FOLDERS = ("configs/", "docs/", "examples/", "scripts/", "tests/", "zipf/")
NOT_PATHS = {
    re.sub(r"\d+$", str(version), one.id)
    for one in family.families().values()
    for version in range(len(one.image_changes) + 1)
}
TAKES_LONG = re.compile(r"\.learn\(|zipf\.train\(|floors\.search\(|check_vector_env\(").search
"""Code that trains, searches or checks."""
FLAGS = {"-m", "--multirun", "--help"}


def section(page: str, heading: str) -> str:
    """The text of a second-level section."""
    return re.split(r"^## ", TEXT[page].split(f"\n## {heading}\n")[1], flags=re.MULTILINE)[0]


@pytest.fixture(autouse=True)
def forgotten(own_registries, monkeypatch):
    """What code registers is forgotten after the test."""
    monkeypatch.setattr(family, "_FAMILIES", dict(family._FAMILIES))
    monkeypatch.setattr(config_files, "_user_folder", None)
    monkeypatch.setattr(plugins, "_config_folders", [])


@pytest.fixture
def in_folder(tmp_path, monkeypatch):
    """A function that makes the files of a page and works in their folder."""

    def make(page):
        for name, text in files(page).items():
            path = tmp_path / name
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_text(text)
        (tmp_path / "results").symlink_to(ROOT / "results")
        monkeypatch.chdir(tmp_path)
        monkeypatch.syspath_prepend(str(tmp_path))
        return tmp_path

    before = set(sys.modules)
    yield make
    for name in set(sys.modules) - before:
        if str(tmp_path) in str(getattr(sys.modules[name], "__file__", "")):
            del sys.modules[name]


@pytest.mark.filterwarnings("ignore:.*torch.jit:DeprecationWarning")
@pytest.mark.parametrize(
    ("page", "code"),
    [
        pytest.param(page, code, id=page, marks=[pytest.mark.slow] if TAKES_LONG(code) else [])
        for page in PAGES
        for code in blocks("python", page)
    ],
)
def test_python_code_runs(page, code, in_folder):
    folder = in_folder(page)
    (folder / "example.py").write_text(code)  # TorchScript reads the source of what it compiles
    runpy.run_path("example.py", run_name="__main__")


def test_there_is_code_to_run():
    assert len(blocks("python", "README.md")) >= 2
    assert len(commands("zipf.train")) >= 20
    assert {"bandit.py", "configs/experiments/bandit.yaml"} <= set(files("docs/your_own_env.md"))


def overrides_of(arguments: list[str]) -> list[str]:
    """The overrides of a train command; its `--config-dir` is added."""
    words = [word for word in arguments if word not in FLAGS]
    for flag in {"--cfg", "--explain"} & set(words):  # at the end
        words = words[: words.index(flag)]
    if "--config-dir" in words:
        i = words.index("--config-dir")
        config_files.use_folder(words[i + 1])
        del words[i : i + 2]
    # Launchers are of the command, not of its jobs.
    return [word for word in words if not word.startswith("hydra")]


def of_page(page: str) -> dict[str, list[str]]:
    """The arguments of the train commands of a page, by what one would type."""
    found = commands("zipf.train").items()
    return {name: arguments for name, (where, arguments) in found if where == page}


def jobs_of(arguments: list[str]) -> list[sweeps.PlannedJob]:
    """The jobs of a train command; none of one that asks for help."""
    overrides = overrides_of(arguments)
    if (asked := search.asked(overrides)) is not None:
        return asked.jobs
    ready_made = sweeps.named(overrides)  # test_config.py checks what they choose
    if ready_made and not any(word.startswith("seed=") for word in overrides):
        overrides = [*overrides, "seed=0"]  # composing all seeds takes three times as long
    return sweeps.check(overrides, is_finished=lambda _: ready_made).jobs if overrides else []


COMMANDS = {page: len(of_page(page)) for page in PAGES if of_page(page)}


@pytest.mark.parametrize(
    "page", slow_but(COMMANDS, *(page for page, count in COMMANDS.items() if count < 9))
)
def test_train_commands_are_accepted(page, in_folder, monkeypatch):
    in_folder(page)
    monkeypatch.setattr(feasibility, "_no_pretrained", lambda *_: ())  # the reader's own runs
    for name, arguments in of_page(page).items():
        with naming(name):
            assert (len(jobs_of(arguments)) > 1) == ("-m" in arguments)


@pytest.mark.slow
@pytest.mark.parametrize("page", [page for page in PAGES if of_page(page) and files(page)])
def test_commands_that_name_a_file_of_their_page_train(page, in_folder):
    """For one update: the first job of a sweep."""
    in_folder(page)
    for name, arguments in of_page(page).items():
        with naming(name):
            named = any(Path(file).stem in word for file in files(page) for word in arguments)
            if named and "--config-dir" in arguments:  # there are other sweeps than `sweep.yaml`'s
                (job, *_) = jobs_of(arguments)
                short = ["updates=1", "schedule.window=[0,1]", "collector.num_envs=8"]
                short += ["evaluation.episodes=5", "evaluation.num_envs=5"]
                short += ["evaluation.chance_episodes=0"]
                assert runner.train(loading.load([*job.overrides, *short])) == 0


def test_evaluate_commands_are_accepted():
    for name, (_, arguments) in commands("zipf.evaluate").items():
        with naming(name):
            options = command_line.read_options(EvaluateOptions, arguments)
            assert options.run or (options.policy and envs.split(str(options.split)))


def test_play_commands_are_accepted():
    for name, (_, arguments) in commands("zipf.play").items():
        with naming(name):
            if arguments != ["--help"]:
                options = command_line.read_options(PlayOptions, arguments)
                assert options.run or envs.keys(options.level)


def test_report_commands_are_accepted(monkeypatch):
    calls = []

    def report(folders, output, window, **named):
        calls.append((folders, output, window and parse_window(window), named))

    monkeypatch.setattr(zipf.report, "report", report)
    monkeypatch.setattr(zipf.report, "_asked_for", lambda *given: ([], [], []))
    monkeypatch.setattr(videos, "record_videos", lambda *given: None)
    found = commands("zipf.report")
    for name, (_, arguments) in found.items():
        with naming(name):
            assert zipf.report.main(arguments) == 0
    assert len(calls) == len(found)


def test_make_commands_exist():
    targets = set(re.findall(r"^([a-z]+):", (ROOT / "Makefile").read_text(), re.MULTILINE))
    named = {
        target
        for page in PAGES
        for target in re.findall(r"(?:^|`)make ([a-z]+)", TEXT[page], re.MULTILINE)
    }
    assert {"demo", "test"} <= named <= targets


def anchors(path: Path) -> set[str]:
    """The anchors of a page's headings, as GitHub makes them."""
    text = re.sub(r"^```.*?^```$", "", path.read_text(encoding="utf-8"), flags=re.M | re.S)
    headings = re.findall(r"^#+ (.+)$", text, re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", one.lower()).replace(" ", "-") for one in headings}


def test_links_and_paths_exist():
    missing = []
    for page in PAGES:
        for link in re.findall(r"\]\(([^):\s]+)\)", TEXT[page]):
            path, _, anchor = link.partition("#")
            target = (ROOT / page).parent / path if path else ROOT / page
            if not target.exists() or (anchor and anchor not in anchors(target)):
                missing.append(f"{page}: {link}")
        spans = [word for span in re.findall(r"`([^`\n]+)`", TEXT[page]) for word in span.split()]
        words = [word for block in blocks("sh", page) for word in block.split()]
        paths = {word for word in spans + words if word.startswith(FOLDERS)} - NOT_PATHS
        for path in paths - set(files(page)):
            if not list(ROOT.glob(re.sub(r"<[^>]+>", "*", path).rstrip("/"))):
                missing.append(f"{page}: {path}")
    assert not missing


def test_names_in_the_code_exist():
    for page in (page for page in PAGES if page != "CHANGELOG.md"):
        for name in sorted(set(re.findall(r"`(zipf(?:\.\w+)+)[`(]", TEXT[page]))):
            with naming(f"{name} in {page}"):
                parts = name.split(".")
                found = importlib.import_module("zipf")
                for i, part in enumerate(parts[1:], 2):
                    if not hasattr(found, part):
                        importlib.import_module(".".join(parts[:i]))
                    found = getattr(found, part)


OF_THE_RECORD = [
    path
    for path in write_tables.pages()
    if re.search("<!-- (tail|numbers|comparison)", path.read_text(encoding="utf-8"))
]


def check_tables(paths):
    for path in paths:
        text = path.read_text(encoding="utf-8")
        assert write_tables.rewritten(text) == text, path


def test_tables_are_up_to_date():
    """If this fails: python scripts/write_tables.py"""
    check_tables(path for path in write_tables.pages() if path not in OF_THE_RECORD)


@pytest.mark.slow
def test_tables_of_the_record_are_up_to_date():
    """If this fails: python scripts/write_tables.py"""
    check_tables(OF_THE_RECORD)


def test_families_and_parts_of_agents_have_pages():
    """If this fails: python scripts/write_tables.py"""
    assert write_tables.new_pages() == {}


def test_every_package_is_in_the_map_of_the_code():
    packages = {path.parent.relative_to(ROOT).as_posix() for path in ROOT.glob("zipf/**/*.py")}
    assert packages == set(re.findall(r"<!-- modules (\S+) -->", TEXT["docs/design.md"]))


# What each part may import of the rest, as docs/design.md says: a room of `zipf.experiments` those
# below it, which stand before it here.
COMMON = {
    "zipf.options",
    "zipf.compiled",
    "zipf.protocol",
    "zipf.errors",
    "zipf.lazy",
    "zipf.output",
    "zipf.registry",
}
MAY_IMPORT = {
    "zipf/envs": {"zipf.envs"},
    "zipf/agents": {"zipf.agents"},
    "zipf/adapters": {"zipf.adapters", "zipf.envs"},
    "zipf/experiments/records": {"zipf.experiments.records"},
}
ROOMS = [
    "records",
    "hooks",
    "loggers",
    "options",
    "building",
    "reporting",
    "evaluation",
    "playing",
    "training",
    "cluster",
    "sweeping",
]
for i, room in enumerate(ROOMS[1:], 1):
    below = {f"zipf.experiments.{name}" for name in ROOMS[: i + 1]}
    MAY_IMPORT[f"zipf/experiments/{room}"] = {"zipf.agents", "zipf.envs", "zipf.plugins", *below}
MAY_IMPORT["zipf/experiments/reporting"] = {
    f"zipf.experiments.{room}" for room in ("records", "reporting")
}


@pytest.mark.parametrize("part", MAY_IMPORT)
def test_imports_run_one_way(part):
    allowed = tuple(MAY_IMPORT[part] | COMMON)
    for path in (ROOT / part).rglob("*.py"):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            names = []
            if isinstance(node, ast.ImportFrom):
                assert node.level == 0, f"{path}: a relative import"
                names = [node.module]
                if node.module in ("zipf", "zipf.experiments"):
                    names = [f"{node.module}.{alias.name}" for alias in node.names]
            elif isinstance(node, ast.Import):
                names = [alias.name for alias in node.names if alias.name != "zipf"]
            for name in names:
                assert not name.startswith("zipf") or name.startswith(allowed), (path, name)
                torch = name.startswith("torch") and path.name != "tensor.py"
                assert part != "zipf/envs" or not torch, (path, name)


def test_every_room_has_its_place():
    rooms = {path.parent.name for path in ROOT.glob("zipf/experiments/*/__init__.py")}
    assert rooms == set(ROOMS)


def test_parts_whose_compiled_code_is_kept_apart_do_not_import_each_other():
    for part in compiled.APART:
        assert MAY_IMPORT[f"zipf/{part}"] == {f"zipf.{part}"}


def test_the_options_of_the_table_exist():
    rows = re.findall(r"^\| (`[^|]+`) \|", section("docs/configuration.md", "Options"), re.M)
    rows = rows[: next(i for i, row in enumerate(rows) if "`schedule.log_every`" in row) + 1]
    named = {option for row in rows for option in re.findall(r"`([^`]+)`", row)}
    known = {*Config.model_fields, "name", "without_instruction"}  # the last two become others
    assert {option.split(".")[0] for option in named} == known
    for option in named:
        group, _, name = option.partition(".")
        if name:
            annotation = Config.model_fields[group].annotation
            assert annotation is not None
            assert name in annotation.model_fields, option


@pytest.mark.parametrize("group", [part for part in config_files.parts() if part != "agent"])
def test_the_table_explains_every_choice(group):
    row = re.search(rf"^\| `{group}` \| group(.*)$", TEXT["docs/configuration.md"], re.M)
    assert row
    assert all(f"`{choice}`" in row[1] for choice in command_line.choices(group))


def test_the_readme_is_short():
    assert len(TEXT["README.md"].splitlines()) <= 220
    linked = set(re.findall(r"\]\((docs/[\w/-]+\.md)\)", TEXT["README.md"])) - {RECORD}
    families = {f"docs/environments/{name}.md" for name in envs.families()}
    others = {"docs/library/overview.md"}
    assert linked == {page for page in DOCS if page.count("/") == 1} | families | others


def test_the_demo_has_one_table():
    """The README and the documentation's first page show the same."""
    tables = [
        re.findall(r"^┏.*?┛$|^┏.*?┘$", TEXT[page], re.M | re.S)
        for page in ("README.md", "docs/index.md")
    ]
    assert tables[0]
    assert tables[0] == tables[1]


def test_the_picture_is_small():
    assert (ROOT / "docs" / "gridworld.png").stat().st_size < 300_000
