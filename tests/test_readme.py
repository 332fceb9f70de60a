"""The pages keep their word: their code runs, their commands are accepted, their paths exist."""

import re
import runpy
import shlex
from pathlib import Path

import pytest

import zipf.report
from zipf import envs
from zipf.experiments import command_line
from zipf.experiments.config import Config, EvaluateOptions
from zipf.experiments.playing.playing import PlayOptions

ROOT = Path(__file__).parent.parent
DOCS = sorted(path.relative_to(ROOT).as_posix() for path in (ROOT / "docs").glob("*.md"))
PAGES = ("README.md", "CONTRIBUTING.md", "CHANGELOG.md", *DOCS)
TEXT = {page: (ROOT / page).read_text(encoding="utf-8") for page in PAGES}
README = TEXT["README.md"]
ENVIRONMENTS = {"zipf/Gridworld-v0", "zipf/Playroom-v0"}  # look like paths
FOLDERS = ("configs/", "docs/", "scripts/", "tests/", "zipf/")
ASKING = {"-m", "--multirun", "--help"}


def blocks(language: str, page: str = "README.md") -> list[str]:
    return re.findall(rf"^```{language}\n(.*?)^```$", TEXT[page], re.MULTILINE | re.DOTALL)


def commands(module: str) -> list[list[str]]:
    """The arguments of every `python -m <module>` line of every page."""
    lines = [line for page in PAGES for block in blocks("sh", page) for line in block.splitlines()]
    spans = [span for page in PAGES for span in re.findall(r"`(python -m [^`\n]+)`", TEXT[page])]
    called = [shlex.split(line, comments=True) for line in lines + spans]
    return [words[3:] for words in called if words[:3] == ["python", "-m", module] and words[3:]]


def section(heading: str) -> str:
    """The text of a second-level section."""
    return re.split(r"^## ", README.split(f"\n## {heading}\n")[1], flags=re.MULTILINE)[0]


@pytest.mark.filterwarnings("ignore:.*torch.jit:DeprecationWarning")
@pytest.mark.parametrize(
    "code",
    [pytest.param(code, id=page) for page in PAGES for code in blocks("python", page)],
)
def test_python_code_runs(code, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "results").symlink_to(ROOT / "results")
    (tmp_path / "example.py").write_text(code)  # TorchScript reads the source of what it compiles
    runpy.run_path("example.py", run_name="__main__")


def test_there_is_code_to_run():
    assert len(blocks("python")) >= 5
    assert len(commands("zipf.train")) >= 8


@pytest.mark.parametrize("arguments", commands("zipf.train"), ids=" ".join)
def test_train_commands_are_accepted(arguments):
    overrides = [word for word in arguments if word not in ASKING]
    if "--cfg" in overrides:
        overrides = overrides[: overrides.index("--cfg")]
    # Launchers are parts of the extra `sweep`, which the tests do not install.
    jobs = [word for word in overrides if not word.startswith("hydra")]
    if jobs:
        assert (len(command_line.check_command_line(jobs)) > 1) == ("-m" in arguments)


@pytest.mark.parametrize("arguments", commands("zipf.evaluate"), ids=" ".join)
def test_evaluate_commands_are_accepted(arguments):
    command_line.read_options(EvaluateOptions, arguments)


@pytest.mark.parametrize("arguments", commands("zipf.play"), ids=" ".join)
def test_play_commands_are_accepted(arguments):
    if arguments != ["--help"]:
        options = command_line.read_options(PlayOptions, arguments)
        assert options.run or envs.keys(options.level)


@pytest.mark.parametrize("arguments", commands("zipf.report"), ids=" ".join)
def test_report_commands_are_accepted(arguments, monkeypatch):
    calls = []

    def report(folders, output, window, *, record):
        from zipf.experiments.reporting.windows import parse_window

        calls.append((folders, output, window and parse_window(window), record))

    monkeypatch.setattr(zipf.report, "report", report)
    assert zipf.report.main(arguments) == 0
    assert len(calls) == 1


def test_make_commands_exist():
    targets = set(re.findall(r"^([a-z]+):", (ROOT / "Makefile").read_text(), re.MULTILINE))
    named = {
        target
        for page in PAGES
        for target in re.findall(r"(?:^|`)make ([a-z]+)", TEXT[page], re.MULTILINE)
    }
    assert {"demo", "test"} <= named <= targets


@pytest.mark.parametrize("page", PAGES)
def test_links_and_paths_exist(page):
    links = re.findall(r"\]\(([^)#:\s]+)\)", TEXT[page])
    spans = [word for span in re.findall(r"`([^`\n]+)`", TEXT[page]) for word in span.split()]
    scripts = [word for block in blocks("sh", page) for word in block.split()]
    paths = {word for word in spans + scripts if word.startswith(FOLDERS)} - ENVIRONMENTS
    missing = [path for path in [*links, *paths] if not list(ROOT.glob(path.rstrip("/")))]
    assert not missing


def test_the_map_of_the_code_is_true():
    tree = re.search(r"^```\n(zipf/\n.*?)^```$", section("What is where"), re.M | re.S)
    assert tree
    above: list[str] = []
    for line in tree[1].splitlines():
        depth = (len(line) - len(line.lstrip())) // 2
        # Names, one space apart, and after two spaces or more what they are.
        names = re.split(r"\s{2,}", line.strip())[0].split()
        for name in names:
            assert (ROOT / "".join([*above[:depth], name])).exists(), line
        above = [*above[:depth], names[0]]


def test_the_options_of_the_table_exist():
    rows = re.findall(r"^\| (`[^|]+`) \|", section("Configuration").split("| File |")[0], re.M)
    named = {option for row in rows for option in re.findall(r"`([^`]+)`", row)}
    known = {*Config.model_fields, "name"}  # which becomes the condition's
    assert {option.split(".")[0] for option in named} == known
    for option in named:
        group, _, name = option.partition(".")
        if name:
            annotation = Config.model_fields[group].annotation
            assert annotation is not None
            assert name in annotation.model_fields, option


@pytest.mark.parametrize(
    "group", ["experiment", "agent", "memory", "network", "auxiliary", "exploration"]
)
def test_the_table_names_every_choice(group):
    row = re.search(rf"^\| `{group}` \|(.*)$", README, re.M)
    assert row
    assert all(f"`{choice}`" in row[1] for choice in command_line.choices(group))


def test_the_picture_is_small():
    assert (ROOT / "docs" / "gridworld.png").stat().st_size < 300_000


def test_every_condition_is_named():
    section = README.split("### Conditions")[1].split("###")[0]
    assert all(f"`{condition}`" in section for condition in command_line.choices("condition"))
