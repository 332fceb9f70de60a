"""The documentation's site: what is on it, its links, and that it fetches nothing."""

import importlib
import re
from types import SimpleNamespace

import pytest
import site_pages
import yaml
from mkdocs.exceptions import PluginError
from pages import DOCS, RECORD, ROOT

from zipf import envs


class Loader(yaml.SafeLoader):
    """Reads `mkdocs.yml`, in which some values name functions."""


Loader.add_multi_constructor("tag:yaml.org,2002:python/", lambda loader, suffix, node: suffix)
CONFIG = yaml.load((ROOT / "mkdocs.yml").read_text(encoding="utf-8"), Loader)


def places(nav) -> list[str]:
    """The pages that are named in the navigation, in order."""
    if isinstance(nav, str):
        return [nav]
    within = nav.values() if isinstance(nav, dict) else nav
    return [page for one in within for page in places(one)]


PLACES = places(CONFIG["nav"])
API = [page for page in PLACES if page.startswith("api/")]


def test_every_page_has_its_place():
    ours = [page.removeprefix("docs/") for page in (*DOCS, RECORD)]
    assert sorted(PLACES) == sorted([*ours, *API, *site_pages.TOP.values()])


def test_the_gallery_shows_every_level():
    """If this fails: python scripts/write_tables.py, and python scripts/gallery.py"""
    page = ROOT / "docs" / "gallery.md"
    text = page.read_text(encoding="utf-8")
    for name, family in envs.families().items():
        assert [level for level in family.levels if f"`{name}/{level}`" not in text] == []
    shown = set(re.findall(r"\]\((gallery/\S+\.jpg)\)", text))
    assert shown == {f"gallery/{path.name}" for path in (page.parent / "gallery").iterdir()}


def test_every_script_is_named_where_a_maintainer_looks():
    pages = [ROOT / name for name in ("README.md", "CONTRIBUTING.md", "RESULTS.md", "Makefile")]
    text = "".join(page.read_text() for page in [*pages, *(ROOT / "docs").glob("**/*.md")])
    scripts = [one for one in (ROOT / "scripts").glob("*.py") if "__main__" in one.read_text()]
    assert len(scripts) > 10
    assert not [script.name for script in scripts if script.name not in text]


def test_a_familys_page_has_a_picture_and_all_tables():
    for name in envs.families():
        text = (ROOT / f"docs/environments/{name}.md").read_text(encoding="utf-8")
        assert re.search(r"!\[[^\]]{20,}\]\(\.\./\w+\.png\)", text), name
        for block in ("family", "constructor_options"):
            assert f"<!-- {block} {name} -->" in text
        assert f"<!-- levels {name} -->" in text or f"<!-- {name}_baselines -->" in text, name


def test_the_api_has_what_the_pages_name():
    """Modules whose functions and classes the pages tell people to call."""
    assert len(API) > 15
    for page in API:
        module = importlib.import_module(page.removeprefix("api/").removesuffix(".md"))
        assert module.__doc__
    called = {"zipf.envs", "zipf.envs.vector", "zipf.evaluate", "zipf.agents.agent", "zipf.plugins"}
    assert {f"api/{module}.md" for module in called} <= set(API)


def test_a_link_that_leads_nowhere_stops_the_build():
    levels = [level for part in CONFIG["validation"].values() for level in part.values()]
    assert levels == ["warn"] * 7
    assert re.search(r"\n\t.*mkdocs build --strict", (ROOT / "Makefile").read_text("utf-8"))


@pytest.mark.parametrize(
    ("page", "link", "expected"),
    [
        ("play.md", "[a](protocol.md#scores)", "[a](protocol.md#scores)"),
        ("play.md", "[a](../CONTRIBUTING.md#words)", "[a](contributing.md#words)"),
        ("agents/agent.md", "[a](../../RESULTS.md)", "[a](../our-runs.md)"),
        ("agents/agent.md", "[a](../extending.md)", "[a](../extending.md)"),
        ("contributing.md", "[a](docs/design.md#the-parts)", "[a](design.md#the-parts)"),
        ("contributing.md", "[a](CHANGELOG.md)", "[a](changelog.md)"),
        ("configuration.md", "[train.yaml](../configs/train.yaml)", "train.yaml"),
        ("play.md", "[a](#here)", "[a](#here)"),
        ("play.md", "[a](https://example.org/x.md)", "[a](https://example.org/x.md)"),
        ("play.md", "![a](gridworld.png)", "![a](gridworld.png)"),
        ("play.md", "```sh\n[a](../LICENSE)\n```", "```sh\n[a](../LICENSE)\n```"),
    ],
)
def test_links_are_the_sites(page, link, expected):
    assert site_pages.with_site_links(f"See {link}.\n" if "\n" not in link else link, page) in (
        f"See {expected}.\n",
        expected,
    )


@pytest.mark.parametrize(
    ("text", "suffix"),
    [
        ('<script src="https://a.org/b.js"></script>', ".html"),
        ('<link rel="stylesheet" href="//a.org/b.css">', ".html"),
        ('<img alt="" src="HTTP://a.org/b.png">', ".html"),
        ('<p style="background: url(https://a.org/b.png)">', ".html"),
        ("<style>@import 'https://a.org/b.css';</style>", ".html"),
        ("a { background: url(//a.org/b.png) }", ".css"),
    ],
)
def test_what_would_be_fetched_stops_the_build(tmp_path, text, suffix):
    (tmp_path / f"page{suffix}").write_text(text)
    with pytest.raises(PluginError, match=r"a\.org"):
        site_pages.on_post_build(SimpleNamespace(site_dir=tmp_path))


@pytest.mark.parametrize(
    ("text", "suffix"),
    [
        ('<a href="https://a.org">a</a><img src="b.png"><link href="c.css">', ".html"),
        ('<svg xmlns="http://www.w3.org/2000/svg"></svg>', ".html"),
        ("a { background: url(data:image/svg+xml;charset=utf-8) }", ".css"),
    ],
)
def test_links_to_follow_do_not(text, suffix, tmp_path):
    (tmp_path / f"page{suffix}").write_text(text)
    site_pages.on_post_build(SimpleNamespace(site_dir=tmp_path))
