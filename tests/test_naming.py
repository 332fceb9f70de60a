"""Names of rows: what shells need no quotes for, and no two runs share."""

import re

import pytest

from zipf.experiments.building import loading
from zipf.experiments.options.naming import LONGEST, RowName

OPTIONS = ("agent.discount", "memory.size", "network.size", "environment.levels", "pretrained.run")
SAFE = re.compile(r"[\w.+-]+", re.ASCII)


def folder(**changes):
    changes = {name.replace("__", "."): value for name, value in changes.items()}
    return RowName("impala", changes, OPTIONS).folder


@pytest.mark.parametrize(
    ("changes", "name"),
    [
        ({}, "impala"),
        ({"agent__discount": 0.9}, "impala-discount_0.9"),
        ({"agent__discount": 1e-05}, "impala-discount_1e-05"),
        ({"memory__size": 64, "network__size": 8}, "impala-memory.size_64-network.size_8"),
        ({"memory": "mlp"}, "impala-memory_mlp"),
        ({"environment__levels": ["a_b", "c"]}, "impala-levels_a_b+c"),
        ({"environment__levels": [2, None, True]}, "impala-levels_2+null+true"),
        ({"pretrained__run": "demo_first"}, "impala-pretrained_demo_first"),
    ],
)
def test_a_name_is_short_where_it_can_be(changes, name):
    assert folder(**changes) == name


def test_what_cannot_be_shown_as_it_is_has_a_hash():
    values = ["a,b", "a b", "a=b", "a'b", 'a"b', "a/b", "a:b", "a-b", [["a"], "b"], [], "é", "a_b"]
    values += [["a", "b"], ["a_b", "c d"]]
    names = [folder(environment__levels=value) for value in values]
    assert len({*names}) == len(values)
    assert all(SAFE.fullmatch(name) for name in names)
    assert sum(bool(re.search(r"-[0-9a-f]{6}$", name)) for name in names) == len(values) - 2


def test_a_long_name_is_cut_and_stays_its_own():
    one, other = (folder(environment__levels=["level"] * 40 + [last]) for last in ("a", "b"))
    assert one != other
    assert len(one) == len(other) == LONGEST
    assert one.startswith("impala-levels_level+level+level")


def test_titles_of_rows_have_the_options_in_full():
    config = loading.read(["experiment=demo", "agent.discount=0.9", "environment.num_rooms=[1,2]"])
    assert config.row.title == "IMPALA + MLP, environment.num_rooms=[1,2], agent.discount=0.9"
    assert config.folder.parent.name == "impala_mlp-num_rooms_1+2-discount_0.9"
