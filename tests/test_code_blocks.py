"""Every fenced block of the documentation is covered by a check; none is left out in silence.

`test_readme.py` executes the Python blocks, and checks (or executes) the commands of this package.
Here each block has to fall under a rule, and the blocks and lines that are left are checked.
"""

import argparse
import re
import runpy
import sys
import tomllib
from importlib.metadata import entry_points
from pathlib import Path

import pytest
import yaml
from packaging.requirements import Requirement
from pages import BLOCKS, PAGES, PLACEHOLDER, ROOT, TEXT, Block, command, commands, fenced, lines
from ray.scripts import scripts
from torch.distributed import run as torchrun

from zipf.experiments.building import loading
from zipf.experiments.sweeping import sweeps

PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
COMMANDS = {"zipf.train", "zipf.evaluate", "zipf.play", "zipf.report"}
"""Those that `test_readme.py` checks."""


class Parsed(BaseException):
    """A script has understood its arguments."""


def shell(block: Block, monkeypatch: pytest.MonkeyPatch) -> None:
    for line in lines(block):
        words = command(line)
        assert not set(words) & {"|", "&&", "||", ";", ">", "&"}, f"{line}: one command a line"
        match words:
            case []:
                pass
            case ["python", "-m", module, *arguments]:
                assert not PLACEHOLDER.search(" ".join(arguments)), f"{line}: is not complete"
                assert module in COMMANDS, line
                assert " ".join(arguments) in commands(module), line
            case ["torchrun", *arguments]:
                starts(arguments)
            case ["python", script, *arguments]:
                accepts(script, arguments, monkeypatch)
            case ["pip", "install", *arguments]:
                installs(arguments)
            case ["make", target]:
                assert f"\n{target}:" in (ROOT / "Makefile").read_text(encoding="utf-8"), line
            case [".ci/run"]:
                assert (ROOT / ".ci/run").is_file()
            case ["source", ".venv/bin/activate"]:  # of the environment that make creates
                assert "VENV ?= .venv\n" in (ROOT / "Makefile").read_text(encoding="utf-8")
            case ["ray", subcommand, *arguments]:
                scripts.cli.commands[subcommand].make_context(subcommand, arguments)
            case ["tensorboard", "--logdir", "runs"]:
                assert entry_points(group="console_scripts", name="tensorboard")
            case _:
                pytest.fail(f"{block}: no rule covers the command {line!r}")


def accepts(script: str, arguments: list[str], monkeypatch: pytest.MonkeyPatch) -> None:
    """Asserts that a script of the repository understands its arguments."""
    path = ROOT / script
    assert path.is_file(), script
    parse = argparse.ArgumentParser.parse_args

    def parsed(parser, *args, **kwargs):
        parse(parser, *args, **kwargs)
        raise Parsed

    if "ArgumentParser" not in path.read_text(encoding="utf-8"):
        assert not arguments, script
        return
    with monkeypatch.context() as patch:
        patch.setattr(argparse.ArgumentParser, "parse_args", parsed)
        patch.setattr(sys, "argv", [script, *arguments])
        patch.syspath_prepend(str(path.parent))
        with pytest.raises(Parsed):
            runpy.run_path(str(path), run_name="__main__")


def starts(arguments: list[str]) -> None:
    """Asserts that torchrun starts as many learners of a possible run as that has."""
    options = torchrun.get_args_parser().parse_args(arguments)
    assert options.module
    assert options.training_script == "zipf.train"
    config = loading.load(options.training_script_args)
    assert config.runtime.name == "torchrun"
    machines = int(options.nnodes.rpartition(":")[2])  # as in 2, or 1:4 for up to four
    assert machines * int(options.nproc_per_node) == config.learners


def installs(arguments: list[str]) -> None:
    """Asserts that pip is told of this project, or of what it needs, with extras that there are."""
    needed = [name for extra in PROJECT["optional-dependencies"].values() for name in extra]
    known = {Requirement(one).name for one in [*PROJECT["dependencies"], *needed]}
    words = iter(arguments)
    for word in words:
        if word in ("--index-url", "--constraint"):
            next(words)
            continue
        project = word.startswith(".")
        found = Requirement(word.replace(".", PROJECT["name"], 1) if project else word)
        assert found.name in known | {PROJECT["name"]}, word
        if found.name == PROJECT["name"]:
            assert found.extras <= set(PROJECT["optional-dependencies"]), word


def yaml_file(block: Block, monkeypatch: pytest.MonkeyPatch) -> None:
    """A file of the repository, a sweep, or a file that `test_readme.py` makes and trains with."""
    assert block.title, f"{block}: no title names the file"
    if (ROOT / block.title).is_file():
        assert block.text in (ROOT / block.title).read_text(encoding="utf-8")
        return
    assert_named_in_the_text(block)
    if block.title.endswith("/sweep.yaml"):
        for parts in yaml.safe_load(block.text).values():
            for part in parts:
                sweeps.read_block(Path(block.title), part)
    else:
        assert isinstance(yaml.safe_load(block.text), dict)
        used = [words for page, words in commands("zipf.train").values() if page == block.page]
        assert any("--config-dir" in words for words in used), f"{block}: is used by no command"


def executed(block: Block, monkeypatch: pytest.MonkeyPatch) -> None:
    """`test_readme.py` runs it; here only that it is Python."""
    compile(block.text, str(block), "exec")
    if block.title:
        assert_named_in_the_text(block)


def assert_named_in_the_text(block: Block) -> None:
    """The text above a file to make names it, because GitHub does not show titles."""
    above = "\n".join(TEXT[block.page].splitlines()[: block.line - 1])
    paragraphs = re.sub(r"<!-- .* -->", "", above).strip().split("\n\n")
    assert re.search(rf"Save this as\s+`{re.escape(block.title)}`", paragraphs[-1]), str(block)


def output(block: Block, monkeypatch: pytest.MonkeyPatch) -> None:
    """What a command prints: nothing that one could type."""
    for line in block.text.splitlines():
        assert not line.startswith(("$ ", "python ", "pip ", "make ", ">>> ")), f"{block}: {line}"


def toml(block: Block, monkeypatch: pytest.MonkeyPatch) -> None:
    """An entry point for plugins."""
    assert set(tomllib.loads(block.text)["project"]["entry-points"]) == {"zipf.plugins"}


def bibtex(block: Block, monkeypatch: pytest.MonkeyPatch) -> None:
    """The paper, as CITATION.cff names it."""
    (paper,) = yaml.safe_load((ROOT / "CITATION.cff").read_text(encoding="utf-8"))["references"]
    assert f"{{{paper['title']}}}" in block.text
    assert f"{{{paper['year']}}}" in block.text
    assert all(
        f"{one['family-names']}, {one['given-names']}" in block.text for one in paper["authors"]
    )


REFUSED = (Exception, SystemExit, pytest.fail.Exception)
"""What a rule raises; scripts exit, and `pytest.fail` is no `Exception`."""
RULES = {
    "": output,
    "bibtex": bibtex,
    "python": executed,
    "sh": shell,
    "toml": toml,
    "yaml": yaml_file,
}


def test_every_block_is_covered(monkeypatch):
    uncovered = []
    for block in BLOCKS:
        assert block.language in RULES, f"{block}: no rule covers ```{block.language}"
        try:
            RULES[block.language](block, monkeypatch)
        except REFUSED as error:
            uncovered.append(f"{block}: {error!r}")
    assert not uncovered, "\n".join(uncovered)


def test_the_blocks_are_there():
    languages = [block.language for block in BLOCKS]
    assert languages.count("python") >= 25
    assert languages.count("sh") >= 35
    assert {block.page for block in BLOCKS} >= {"README.md", "docs/index.md", "docs/how-to.md"}
    assert set(languages) == set(RULES)
    assert len(PAGES) > 20


def test_a_block_that_cannot_be_covered_is_an_error():
    for text in (
        "- a list\n\n  ```sh\n  make demo\n  ```\n",
        "~~~sh\nmake demo\n~~~\n",
        "```sh {.x}\nmake demo\n```\n",
        "```sh\nmake demo\n",
        "```sh\nmake demo\n```sh\n",
    ):
        with pytest.raises(ValueError, match=r"page\.md"):
            fenced("page.md", text)


@pytest.mark.parametrize(
    ("language", "text"),
    [
        ("sh", "python -m zipf.train experiment=<name>"),
        ("sh", "python -m zipf.train experiment=not_in_any_page"),
        ("sh", "python -m pytest"),
        ("sh", "python scripts/not_there.py"),
        ("sh", "python scripts/benchmark_envs.py --not-an-option"),
        ("sh", "pip install zipf-rl[not_an_extra]"),
        ("sh", "pip install flask"),
        ("sh", "torchrun --nproc-per-node=2 -m zipf.train experiment=demo"),
        ("sh", "torchrun --nproc-per-node=3 -m zipf.train experiment=demo runtime=torchrun"),
        ("sh", "make not_a_target"),
        ("sh", "make demo && make test"),
        ("sh", "rm -rf runs"),
        ("", "make demo"),
        ("python", "for"),
        ("yaml", "a: 1"),
        ("yaml", "- 1"),
    ],
)
def test_a_block_that_no_rule_covers_is_an_error(language, text, monkeypatch):
    with pytest.raises(REFUSED):
        RULES[language](Block("README.md", 1, language, "", text + "\n"), monkeypatch)
