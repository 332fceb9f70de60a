"""Damaged run folders: no run goes on beside a damaged file, and nothing is lost without a word."""

import json

import pytest
from conftest import contents, slow_but

from zipf import report
from zipf.errors import UserError
from zipf.experiments.building import loading, run_folder
from zipf.experiments.records.result_table import TABLES, ResultTable, check_table
from zipf.experiments.training import runner


def edit(old: bytes, new: bytes):
    return lambda content: content.replace(old, new)


def of_json(change):
    return lambda content: json.dumps(change(json.loads(content))).encode()


DAMAGED = {
    "emptied": lambda content: b"",
    "deleted": None,
    "header only": lambda content: content[: content.index(b"\n") + 1],
    "header renamed": edit(b"update,", b"updates,"),
    "last row gone": lambda content: content[: content[:-1].rindex(b"\n") + 1],
    "first row gone": lambda content: b"\n".join(
        line for i, line in enumerate(content.split(b"\n")) if i != 1
    ),
    "cut": lambda content: content[:-9],
    "a word for a number": edit(b"\n2,", b"\nabc,"),
    "byte 0x80": edit(b"\n2,", b"\n2,\x80"),
    "carriage return": edit(b"\n2,", b"\n2,\r"),
    "a huge number": edit(b"\n2,", b"\n" + b"9" * 400 + b","),
    "another number": edit(b"\n2,", b"\n2,1"),
    "a cell more": edit(b"\n2,", b"\n2,,"),
    "nul": edit(b"\n2,", b"\n2,\0"),
    "random": lambda content: bytes(range(256)) * 4,
    "blank lines": lambda content: b"\n" * len(content),
}
DESCRIPTIONS = {
    "emptied": lambda content: b"",
    "deleted": None,
    "cut": lambda content: content[:-9],
    "byte 0x80": edit(b"demo", b"d\x80mo"),
    "a list": of_json(lambda described: [described]),
    "null": lambda content: b"null",
    "no levels": of_json(lambda described: {**described, "levels": 5}),
    "empty levels": of_json(lambda described: {**described, "levels": [{}]}),
    "levels of another run": of_json(
        lambda described: {
            **described,
            "levels": [{**one, "level": "x"} for one in described["levels"]],
        }
    ),
    "another seed": of_json(lambda described: {**described, "seed": 7}),
    "no situation": of_json(lambda described: {**described, "situation": {}}),
    "no references": of_json(
        lambda described: {
            **described,
            "levels": [{**one, "references": None} for one in described["levels"]],
        }
    ),
    "resumed by a number": of_json(lambda described: {**described, "resumed": 5}),
}
OPTIONS = {
    "emptied": lambda content: b"",
    "deleted": None,
    "cut": lambda content: content[:-30],
    "byte 0x80": edit(b"demo", b"d\x80mo"),
    "a list": lambda content: b"- 5\n",
    "no yaml": lambda content: b"{[",
    "plugins are a number": edit(b"plugins: []", b"plugins: 5"),
    "another discount": edit(b"discount: 0.99", b"discount: 0.9"),
}
OF_ALL_TABLES = {
    "emptied": DAMAGED["emptied"],
    "deleted": None,
    "byte 0x80": lambda content: content.replace(b",", b"\x80", 1),
    "another first update": lambda content: content.replace(b"\n", b"\nx", 1)[:-1],
}
DAMAGE = [
    *((name, how, change) for name in TABLES for how, change in OF_ALL_TABLES.items()),
    *(("run.json", how, change) for how, change in DESCRIPTIONS.items()),
    *(("config.yaml", how, change) for how, change in OPTIONS.items()),
]


@pytest.mark.parametrize(("how", "change"), DAMAGED.items(), ids=DAMAGED)
def test_a_damaged_table_is_refused_and_kept(how, change, tmp_path):
    path = tmp_path / "table.csv"
    table = ResultTable(path)
    for update in range(3):
        table.append([{"update": update, "seconds": update / 3, "episode": 7.5}])
    length = table.length()
    content = path.read_bytes()
    check_table(path, 2, length)
    if change is None:
        path.unlink()
    else:
        assert change(content) != content
        path.write_bytes(change(content))
    before = contents(tmp_path)
    with pytest.raises(UserError, match=r"^.*table\.csv.*$"):
        check_table(path, 2, length)
    assert contents(tmp_path) == before


QUICK = {
    "metrics.csv": OF_ALL_TABLES,
    "run.json": ("deleted", "cut", "levels of another run", "another seed"),
    "config.yaml": ("deleted", "cut", "no yaml", "another discount"),
}


@pytest.mark.parametrize("updates", slow_but([2, 3], 3))
@pytest.mark.parametrize(
    ("name", "how", "change"),
    slow_but(DAMAGE, *(one for one in DAMAGE if one[1] in QUICK.get(one[0], ()))),
)
def test_no_run_goes_on_beside_a_damaged_file(trained, name, how, change, updates):
    """Nor is a finished one accepted; one line names the file, and nothing is written."""
    config = loading.load([*trained, f"updates={updates}"])
    path = config.folder / name
    content = path.read_bytes()
    if change is None:
        path.unlink()
    else:
        assert change(content) != content
        path.write_bytes(change(content))
    before = contents(config.folder)
    with pytest.raises(UserError) as error:
        runner.train(config)
    assert contents(config.folder) == before
    assert name in str(error.value)
    assert len(str(error.value).splitlines()) == 1


@pytest.mark.parametrize(
    "content",
    [b"update,frames\n0,0\nabc,1\n", b"\x80\n\x81,\n", b"update\n" + b"9" * 400 + b"\n"],
    ids=["word", "no text", "huge"],
)
def test_rows_without_their_checkpoint_are_kept_however_damaged(content, trained):
    config = loading.load(trained)
    folder = config.folder
    (folder / "checkpoint.pt").unlink()
    (folder / "metrics.csv").write_bytes(content)
    (folder / "evaluations.csv").unlink()
    with pytest.raises(UserError, match=r"metrics\.csv: holds results"):
        runner.train(config)
    assert (folder / "metrics.csv").read_bytes() == content


BY_WINDOWS = {
    "line ends": lambda content: content.replace(b"\n", b"\r\n"),
    "line ends and a mark": lambda content: b"\xef\xbb\xbf" + content.replace(b"\n", b"\r\n"),
}


@pytest.mark.parametrize("how", BY_WINDOWS)
def test_a_run_goes_on_from_files_that_a_program_of_windows_has_written(how, trained, tmp_path):
    config = loading.load(trained)
    for path in config.folder.iterdir():
        if path.suffix in (".csv", ".json", ".yaml"):
            path.write_bytes(BY_WINDOWS[how](path.read_bytes()))
    assert run_folder.is_finished(config)
    assert report.report([config.folder], tmp_path / "report", "last").files
    assert runner.train(loading.load([*trained, "updates=3"])) == 0
    for name in TABLES:
        assert b"\r" not in (config.folder / name).read_bytes()


def test_utf_16_is_told(trained, tmp_path):
    folder = loading.load(trained).folder
    for name in ("run.json", "metrics.csv"):
        path = folder / name
        before = path.read_bytes()
        path.write_bytes(before.decode().encode("utf-16"))
        with pytest.raises(UserError, match=rf"{name}: is UTF-16 text; should be UTF-8"):
            report.report([folder], tmp_path / "report", "last")
        path.write_bytes(before)
