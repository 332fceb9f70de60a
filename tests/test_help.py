"""What `--help` of the commands says: usage, purpose, examples that are accepted, every default."""

import contextlib
import re
import shlex
import subprocess
import sys

import pytest
from conftest import run, slow_but

import zipf.__main__
import zipf.evaluate
import zipf.play
import zipf.report
import zipf.train
from zipf import envs
from zipf.experiments.options import catalogue, command_line
from zipf.experiments.options.schema import EvaluateOptions
from zipf.experiments.playing.playing import PlayOptions
from zipf.experiments.reporting.windows import parse_window
from zipf.experiments.sweeping import search, sweeps
from zipf.report import ReportOptions

OPTIONS = {zipf.evaluate: EvaluateOptions, zipf.play: PlayOptions, zipf.report: ReportOptions}
"""The commands with few options."""


def shown(module, monkeypatch, capsys) -> str:
    """What the command prints for `--help`."""
    monkeypatch.setattr(sys, "argv", [module.__name__, "--help"])
    monkeypatch.setenv("COLUMNS", "100")
    with pytest.raises(SystemExit) as ended:
        sys.exit(module.main())
    assert not ended.value.code
    return capsys.readouterr().out


def examples(text: str, module) -> list[list[str]]:
    """The arguments of the examples in a help text."""
    lines = re.findall(rf"^ +(python -m {module.__name__} .*)$", text, re.MULTILINE)
    return [words[3:] for words in map(shlex.split, lines) if not re.search("=[A-Z]+$", words[3])]


@pytest.mark.parametrize("module", OPTIONS, ids=lambda module: module.__name__)
def test_help_has_usage_purpose_and_examples(module, monkeypatch, capsys):
    text = shown(module, monkeypatch, capsys)
    usage, purpose, *_ = text.split("\n\n")
    assert usage.startswith(f"usage: python -m {module.__name__} ")
    assert len(purpose.split()) > 15
    assert len(examples(text, module)) >= 3
    assert max(map(len, text.splitlines())) <= 100


def train(words, monkeypatch, capsys):
    """The exit code of `python -m zipf.train`, and what it prints."""
    monkeypatch.setattr(sys, "argv", ["zipf.train", *words])
    with pytest.raises(SystemExit) as ended:
        zipf.train.main()
    return ended.value.code, capsys.readouterr()


FLAGS = [
    (["experiment=demo", "updates=7", "--info"], "Defaults List"),
    (["experiment=demo", "--info", "updates=7"], "Defaults List"),
    (["-i", "experiment=demo", "updates=7"], "Defaults List"),
    (["experiment=demo", "--info", "searchpath", "updates=7"], "Search path"),
    (["experiment=demo", "--cfg", "job", "updates=7"], "updates: 7"),
    (["experiment=demo", "updates=7", "--hydra-help"], "Hydra (1."),
    (["experiment=demo", "name=mine", 'row.title="Mine"', "--cfg", "job"], "title: Mine"),
    (["experiment=demo", "name=mine", "row.title=My agent", "--cfg", "job"], "title: My agent"),
    (["experiment=demo", "name=mine", "++row.order=3", "--cfg", "job"], "order: 3"),
]


@pytest.mark.parametrize(("words", "shown"), slow_but(FLAGS, FLAGS[1], FLAGS[6]))
def test_flags_stand_anywhere(words, shown):
    said = run(*words)
    assert said.returncode == 0, said.stderr
    assert shown in said.stdout


@pytest.mark.parametrize(
    ("words", "told"),
    [
        (["experiment=demo", "--cfg"], "--cfg/-c: expected one argument"),
        (["experiment=demo", "--cfg", "updates=7"], "--cfg/-c: invalid choice: 'updates=7'"),
        (["experiment=demo", "--info=updates"], "--info/-i: invalid choice: 'updates'"),
        (["--config-dir"], "--config-dir/-cd: expected one argument"),
        (["experiment=demo", "--shell-completion"], "goes with install="),
        (["experimnt=demo"], "experimnt: no such option; did you mean experiment?"),
        (["-m", "experimnt=demo,gridworld"], "experimnt: no such option; did you mean experiment?"),
        (["experimnt=demo", "--help"], "experimnt: no such option; did you mean experiment?"),
        (
            ["experiment=demo", "updats=7", "--help"],
            "updats: no such option; did you mean updates?",
        ),
        (["-m", "swep=demo"], "swep: no such option; did you mean sweep?"),
    ],
)
def test_a_mistake_in_the_command_is_one_line(words, told, monkeypatch, capsys):
    code, said = train(words, monkeypatch, capsys)
    assert (code, said.out, said.err.count("\n")) == (2, "", 1)
    assert told in said.err


@pytest.mark.parametrize(
    ("module", "words", "told"),
    [
        (zipf.evaluate, ["."], ".: not of the form option=value; did you mean run=.?"),
        (zipf.evaluate, ["seed=1", "seed=2"], "seed=1 and seed=2: choose one"),
        (zipf.evaluate, ["episodes=1e3"], "episodes=1e3: should be a whole number"),
        (zipf.play, ["levl=a"], "levl: no such option; did you mean level?"),
        (zipf.report, ["run=here"], "run=here: folders have no name here: python -m zipf.report"),
        (zipf.report, ["lr=0.1"], "lr=0.1: to name this folder, write ./lr=0.1"),
    ],
)
def test_a_mistake_in_a_small_command_is_one_line(
    module, words, told, tmp_path, monkeypatch, capsys
):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "lr=0.1").mkdir()
    monkeypatch.setattr(sys, "argv", [module.__name__, *words])
    with contextlib.suppress(SystemExit):
        assert module.main() == 2
    said = capsys.readouterr()
    assert (said.out, said.err.count("\n")) == ("", 1)
    assert told in said.err


@pytest.mark.parametrize("module", [*OPTIONS, zipf.train], ids=lambda m: m.__name__)
def test_every_command_tells_its_version(module, monkeypatch, capsys):
    monkeypatch.setattr(sys, "argv", [module.__name__, "--version"])
    with contextlib.suppress(SystemExit):
        module.main()
    assert capsys.readouterr().out == f"zipf {zipf.__version__}\n"


@pytest.mark.parametrize("module", OPTIONS, ids=lambda module: module.__name__)
def test_help_has_every_option_and_its_default(module, monkeypatch, capsys):
    text = shown(module, monkeypatch, capsys).split("Options:\n")[1]
    parts = re.split(r"^    (\w+)=([A-Z]+)", text, flags=re.MULTILINE)[1:]
    told = {name: " ".join(rest.split()) for name, _, rest in zip(*[iter(parts)] * 3, strict=True)}
    fields = OPTIONS[module].model_fields
    assert set(told) == set(fields)
    for name, field in fields.items():
        if field.default not in (None, ""):
            default = field.default
            if isinstance(default, tuple):
                default = "x".join(map(str, default))
            assert f"default: {str(default).lower()}" in told[name]
        elif name not in ("run", "split", "level", "policy"):  # the usage says which are needed
            assert "default: " in told[name]


@pytest.mark.parametrize("module", OPTIONS, ids=lambda module: module.__name__)
def test_examples_are_accepted(module, monkeypatch, capsys):
    for arguments in examples(shown(module, monkeypatch, capsys), module):
        words = [word for word in arguments if "=" in word or module is not zipf.report]
        options = command_line.read_options(OPTIONS[module], words)
        if window := getattr(options, "window", None):
            parse_window(window)
        for name, known in (("split", envs.all_splits()), ("plugins", {"": None})):
            assert getattr(options, name, None) in (None, *known)
        level = getattr(options, "level", None)
        assert level in (None, *envs.KINDS) or envs.find_level(level)


@pytest.mark.parametrize(
    "words",
    [
        ["-m", "sweep=tail", "--help"],
        ["--help", "sweep=tail,demo"],
        ["experiment=demo", "-h", "condition=impala,vmpo", "-m", "seed=range(3)"],
    ],
    ids=str,
)
def test_train_tells_its_options_in_the_words_of_a_sweep(words, monkeypatch, capsys):
    monkeypatch.setattr(sys, "argv", ["zipf.train", *words])
    with contextlib.suppress(SystemExit):
        zipf.train.main()
    told, error = capsys.readouterr()
    assert error == ""
    assert re.search(r"^  impala_mlp +\S", told, re.MULTILINE)
    assert ("updates: 500" in told) == ("experiment=demo" in words)


def test_examples_of_train_are_accepted():
    """Those at the head of its help."""
    found = re.findall(
        r"^ +python -m zipf\.train (.*)$", catalogue.HELP.split("Examples:")[1], re.M
    )
    assert len(found) >= 2
    for arguments in map(shlex.split, found):
        words = arguments[: arguments.index("--explain")] if "--explain" in arguments else arguments
        overrides = [word for word in words if word != "-m"]
        asked = search.asked(overrides)
        assert asked.jobs if asked else sweeps.check(overrides).jobs


LIGHT = """
import sys
import zipf.train
sys.argv = ["zipf.train", *sys.argv[1:]]
try:
    zipf.train.main()
finally:
    heavy = {"torch", "numba", "tensordict", "pandas", "matplotlib"} & sys.modules.keys()
    assert not heavy, heavy
"""


@pytest.mark.parametrize(
    ("words", "code", "told"),
    [
        (["--help"], 0, "impala_mlp "),
        (["--version"], 0, f"zipf {zipf.__version__}"),
        (["experiment=demo", "seeed=1"], 2, "error: seeed: no such option; did you mean seed"),
        (["experiment=gridworld_compact", "agent.discoun=1"], 2, "did you mean agent.discount"),
        (["experiment=demo", "agent.burn_in=1"], 2, "no such option; agent=r2d2 has it"),
        (["experiment=gridwrld"], 2, "no such experiment; did you mean gridworld"),
        (["experiment=demo", "x=1", "updates=many"], 2, "error: updates=many: should be"),
    ],
    ids=str,
)
def test_help_and_misspelt_names_are_answered_without_pytorch(words, code, told):
    command = [sys.executable, "-c", LIGHT, *words]
    done = subprocess.run(command, capture_output=True, text=True)
    assert done.returncode == code, done.stderr
    assert told in done.stdout + done.stderr
    assert "Traceback" not in done.stderr


def test_zipf_is_all_commands(monkeypatch, capsys):
    """`zipf report --help` is `python -m zipf.report --help`, and a name that is none is told."""

    def command(*words):
        monkeypatch.setattr(sys, "argv", ["zipf", *words])
        try:
            code = zipf.__main__.main()
        except SystemExit as ended:
            code = ended.code
        return code or 0, *capsys.readouterr()

    code, out, _ = command()
    assert code == 0
    assert all(f"    {name} " in out for name in ("train", "evaluate", "report", "play"))
    for module in OPTIONS:
        assert command(module.__name__.removeprefix("zipf."), "--help")[:2] == (
            0,
            shown(module, monkeypatch, capsys),
        )
    assert command("--version") == (0, f"zipf {zipf.__version__}\n", "")
    code, out, error = command("trian", "experiment=demo")
    assert (code, out) == (2, "")
    assert error == "error: zipf trian: no such command; choose train, evaluate, report, play\n"
