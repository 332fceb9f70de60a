"""The cache of compiled code: it notices every change that matters, and does without a folder."""

import os
import pickle
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from conftest import ANNOUNCED, slow_but

from zipf import compiled

HELPERS = """
from small.compiled import compiled
from small.constants import FACTOR

@compiled()
def scaled(x):
    return FACTOR * x
"""
KERNELS = """
from small.compiled import compiled
from small.helpers import scaled

@compiled(error_model="numpy")
def kernel(x):
    return scaled(x) + 1
"""


@pytest.fixture
def small(tmp_path: Path) -> Path:
    """A package with a constant, a compiled function that uses it, and one that calls that."""
    package = tmp_path / "small"
    package.mkdir()
    shutil.copy(Path(compiled.__file__), package)
    for name, source in (
        ("__init__", ""),
        ("constants", "FACTOR = 2\n"),
        ("helpers", HELPERS),
        ("kernels", KERNELS),
    ):
        (package / f"{name}.py").write_text(source)
    return package


def start(package: Path, program: str, **environment: str) -> subprocess.Popen[str]:
    kept = {name: value for name, value in os.environ.items() if name != "NUMBA_CACHE_DIR"}
    return subprocess.Popen(
        [sys.executable, "-W", "always", "-c", f"from small.kernels import kernel\n{program}"],
        env={**kept, "PYTHONPATH": str(package.parent), **environment},
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )


def finish(process: subprocess.Popen[str]) -> tuple[str, str]:
    output, errors = process.communicate(timeout=120)
    assert process.returncode == 0, errors
    return output.strip(), errors


HITS = "; print(sum(kernel.stats.cache_hits.values()))"


def saved(package: Path) -> set[str]:
    return {path.name for path in (package / "__pycache__").glob("*.nbc")}


def test_a_changed_imported_constant_is_noticed(small: Path) -> None:
    program = f"print(kernel(5)){HITS}"
    assert finish(start(small, program))[0] == "11\n0"
    assert finish(start(small, program))[0] == "11\n1"
    before = saved(small)
    assert len(before) == 2
    (small / "constants.py").write_text("FACTOR = 3\n")
    assert finish(start(small, program))[0] == "16\n0"
    # Code that was compiled from the old sources has been deleted.
    assert len(saved(small)) == 2
    assert saved(small).isdisjoint(before)


def test_the_laboratory_can_change_without_compiling_again(small: Path) -> None:
    program = f"print(kernel(5)){HITS}"
    finish(start(small, program))
    (small / "experiments").mkdir()
    (small / "experiments" / "tables.py").write_text("WIDTH = 80\n")
    os.utime(small / "kernels.py")  # as a fresh clone has other times
    assert finish(start(small, program))[0] == "11\n1"


@pytest.mark.slow
def test_worlds_and_agents_can_change_apart(small: Path) -> None:
    """A function in one of the folders is compiled again when that changes, or what is beside
    both; one of the laboratory's when either does."""
    program = "from small.{0}.kernels import {0} as kernel; print(kernel(5), *hits(kernel))"
    program = f"hits = lambda one: one.stats.cache_hits.values(); {program}"
    everywhere = ("agents", "envs", "experiments")
    for part in everywhere:
        (small / part).mkdir()
        kernel = HELPERS.replace("scaled", part).replace("small.constants", f"small.{part}.other")
        (small / part / "kernels.py").write_text(kernel)
        (small / part / "other.py").write_text("FACTOR = 2\n")

    def outputs(*parts: str) -> list[str]:
        running = [start(small, program.format(one)) for one in parts or everywhere]
        return [finish(one)[0] for one in running]

    assert outputs() == ["10", "10", "10"]
    (small / "agents" / "other.py").write_text("FACTOR = 3\n")
    assert outputs() == ["15", "10 1", "10"]
    (small / "envs" / "other.py").write_text("FACTOR = 4\n")
    assert outputs() == ["15 1", "20", "10"]
    (small / "constants.py").write_text("FACTOR = 5\n")
    assert outputs() == ["15", "20", "10"]
    (small / "experiments" / "tables.py").write_text("WIDTH = 80\n")
    assert outputs("experiments") == ["10 1"]


def test_code_outside_the_package_is_compiled_again_when_its_file_changes(small: Path) -> None:
    own = small.parent / "own.py"
    program = "from own import doubled; print(doubled(5), sum(doubled.stats.cache_hits.values()))"
    source = "from small.compiled import compiled\n@compiled()\ndef doubled(x): return 2 * x\n"
    own.write_text(source)
    assert finish(start(small, program))[0] == "10 0"
    assert finish(start(small, program))[0] == "10 1"
    own.write_text(source.replace("2 *", "20 *"))
    assert finish(start(small, program))[0] == "100 0"


def test_compiled_code_depends_on_no_file_of_the_laboratory_but_its_own() -> None:
    package = Path(compiled.__file__).parent
    for path in package.rglob("*.py"):
        source = path.read_text()
        in_laboratory = package / "experiments" in path.parents
        if not in_laboratory or "zipf.compiled" in source:
            commands = path.parent == package  # they start the laboratory, and compile nothing
            assert commands or "zipf.experiments" not in source, path


def test_where_no_folder_can_be_written_there_is_one_warning_and_no_cache(small: Path) -> None:
    # Files in the place of folders: permissions would not stop root.
    (small / "__pycache__").write_text("")
    home = small.parent / "home"
    home.write_text("")
    places = {name: str(home) for name in ("HOME", "XDG_CACHE_HOME", "LOCALAPPDATA")}
    output, errors = finish(start(small, f"print(kernel(5)){HITS}", **places))
    assert output == "11\n0"
    assert errors.count("RuntimeWarning") == 1
    assert "NUMBA_CACHE_DIR" in errors


def test_compiling_is_announced_once_for_a_state_of_the_sources(small: Path) -> None:
    assert finish(start(small, "kernel(1); kernel(1.5)"))[1] == ANNOUNCED
    assert finish(start(small, "kernel(1j)"))[1] == ""
    (small / "constants.py").write_text("FACTOR = 4\n")
    silenced = "import logging; logging.getLogger('zipf').setLevel('ERROR'); kernel(1)"
    assert finish(start(small, silenced))[1] == ""
    (small / "constants.py").write_text("FACTOR = 5\n")
    assert finish(start(small, "kernel(1)"))[1] == ANNOUNCED


DAMAGES = {
    "empty": lambda content: b"",
    "garbage": lambda content: b"garbage",
    "a number": lambda content: b"\x80\x04K\x05.",
    "a pair": lambda content: pickle.dumps((1, 2)),
    "of no module": lambda content: b"cnowhere\nnothing\n.",
    "cut": lambda content: content[:-100],
    "code of before": lambda content: content[32:],
    "a bit": lambda content: content[:3000] + bytes([content[3000] ^ 1]) + content[3001:],
}


@pytest.mark.parametrize("how", slow_but(DAMAGES, "a bit"))
def test_damaged_code_is_compiled_again(small: Path, how: str) -> None:
    finish(start(small, "kernel(5)"))
    for path in (small / "__pycache__").glob("*.nbc"):
        path.write_bytes(DAMAGES[how](path.read_bytes()))
    output, errors = finish(start(small, f"print(kernel(5)){HITS}"))
    assert (output, errors) == ("11\n0", "")
    assert finish(start(small, f"print(kernel(5)){HITS}")) == ("11\n1", "")


def test_code_that_cannot_be_replaced_is_compiled_with_one_warning(small: Path) -> None:
    finish(start(small, "kernel(5)"))
    for path in list((small / "__pycache__").glob("*.nbc")):
        path.unlink()
        path.mkdir()
    output, errors = finish(start(small, f"print(kernel(5)){HITS}"))
    assert output == "11\n0"
    assert "Traceback" not in errors
    assert errors.count("RuntimeWarning") == 1


def test_where_the_disk_is_full_there_is_one_warning_and_no_cache(small: Path) -> None:
    limit = "import resource; resource.setrlimit(resource.RLIMIT_FSIZE, (0, 0))"
    output, errors = finish(start(small, f"{limit}; print(kernel(5)){HITS}"))
    assert output == "11\n0"
    assert errors.count("RuntimeWarning") == 1


@pytest.mark.slow
def test_processes_that_compile_at_the_same_time_save_all_signatures(small: Path) -> None:
    calls = ["kernel(1); kernel(1.5)", "kernel(1.5); kernel(1)", "kernel(1j); kernel(1)"]
    for process in [start(small, call) for call in calls]:
        finish(process)
    assert len(saved(small)) == 2 * 3
    program = f"print(kernel(1), kernel(1.5), kernel(1j)){HITS}"
    assert finish(start(small, program))[0] == "3 4.0 (1+2j)\n3"


def test_functions_can_be_pickled(small: Path) -> None:
    path = small.parent / "function"
    finish(start(small, f"import pickle; pickle.dump(kernel, open({str(path)!r}, 'wb'))"))
    program = f"import pickle; print(pickle.load(open({str(path)!r}, 'rb'))(5))"
    assert finish(start(small, program))[0] == "11"


def test_the_package_compiles_nothing_in_another_way() -> None:
    package = Path(compiled.__file__).parent
    users = {path.name for path in package.rglob("*.py") if "njit" in path.read_text()}
    assert users == {"compiled.py"}
