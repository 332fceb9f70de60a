"""The package's metadata agree with each other: versions, extras, pins, citation, checks."""

import re
import tomllib
from pathlib import Path

import pytest
import yaml
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

import zipf

ROOT = Path(__file__).parent.parent
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
EXTRAS = PROJECT["optional-dependencies"]
PINS = {
    canonicalize_name(pin.name): pin
    for pin in map(Requirement, re.findall(r"^\w.*$", (ROOT / "constraints.txt").read_text(), re.M))
}


def pinned(name: str) -> str:
    """The version of a package in constraints.txt."""
    (specifier,) = PINS[canonicalize_name(name)].specifier
    assert specifier.operator == "=="
    return specifier.version


@pytest.mark.parametrize("extra", ["", *EXTRAS])
def test_what_an_extra_needs_is_pinned_within_its_bounds(extra):
    for needed in map(Requirement, EXTRAS[extra] if extra else PROJECT["dependencies"]):
        if needed.name == PROJECT["name"]:  # extras that contain others
            assert needed.extras <= set(EXTRAS)
        else:
            assert needed.specifier.contains(pinned(needed.name)), needed


def test_the_documentation_lists_every_extra():
    table = (ROOT / "docs" / "index.md").read_text(encoding="utf-8").split("| Extra | For |")[1]
    assert set(re.findall(r"^\| `(\w+)` \|", table.split("\n\n")[0], re.M)) == set(EXTRAS)


def test_versions_agree():
    citation = yaml.safe_load((ROOT / "CITATION.cff").read_text(encoding="utf-8"))
    assert zipf.__version__ == PROJECT["version"] == citation["version"]


def test_the_citation_is_complete():
    """The fields that the schema of CFF 1.2.0 requires, and the paper."""
    citation = yaml.safe_load((ROOT / "CITATION.cff").read_text(encoding="utf-8"))
    assert citation["cff-version"] == "1.2.0"
    assert citation["type"] == "software"
    assert citation["license"] == PROJECT["license"]
    assert citation["message"]
    assert citation["title"]
    assert citation["authors"]
    (paper,) = citation["references"]
    names = [author["family-names"] for author in paper["authors"]]
    assert names == ["Chan", "Lampinen", "Richemond", "Hill"]
    assert paper["year"] == 2022
    assert paper["title"] in (ROOT / "README.md").read_text(encoding="utf-8")
    assert paper["type"] == "conference-paper"


def test_checks_before_a_commit_have_the_pinned_versions():
    config = yaml.safe_load((ROOT / ".pre-commit-config.yaml").read_text(encoding="utf-8"))
    hooks = {hook["id"]: (repo, hook) for repo in config["repos"] for hook in repo["hooks"]}
    assert set(hooks) == {"ruff-check", "ruff-format", "mypy"}
    for name in ("ruff-check", "ruff-format"):
        assert hooks[name][0]["rev"] == f"v{pinned('ruff')}"
    assert hooks["mypy"][1]["entry"] == "make types"  # the one that make installs with the pins


def test_the_workflow_runs_what_the_project_runs():
    workflow = yaml.safe_load((ROOT / ".github/workflows/ci.yml").read_text(encoding="utf-8"))
    (job,) = workflow["jobs"].values()
    promised = [one.rpartition(" ")[2] for one in PROJECT["classifiers"] if "Python :: 3." in one]
    assert job["strategy"]["matrix"]["python"] == promised
    assert [step["run"] for step in job["steps"] if "run" in step] == [".ci/run"]


def test_types_are_shipped():
    assert (Path(zipf.__file__).parent / "py.typed").is_file()
