"""What MkDocs asks of us when it builds the documentation: a hook of mkdocs.yml.

The pages in docs/ are read in the repository as well as on the site. So the site's own pages (those
of the API, and those that stand at the top of the repository) are made here, and links are turned
into the site's. A site that would fetch anything from the network is an error.
"""

import os
import posixpath
import re
import tomllib
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

from mkdocs.exceptions import PluginError
from mkdocs.structure.files import File

ROOT = Path(__file__).parent.parent
TOP = {
    "CONTRIBUTING.md": "contributing.md",
    "CHANGELOG.md": "changelog.md",
    "RESULTS.md": "our-runs.md",
}
"""Pages at the top of the repository, and what they are called on the site."""
LINK = re.compile(r"(?<!!)\[([^\]]*)\]\((?!\w+:)([^)#\s]*)(#[^)\s]*)?\)")
REMOTE = re.compile(r"\s*(?:https?:)?//", re.IGNORECASE)
STYLES = re.compile(r"(?:url\(\s*[\"']?|@import\s+[\"'])((?:https?:)?//[^\"')\s]+)", re.IGNORECASE)


def on_config(config: Any) -> Any:
    """Links to the repository, whose address pyproject.toml has."""
    with open(ROOT / "pyproject.toml", "rb") as file:
        config.repo_url = tomllib.load(file)["project"]["urls"]["Repository"]
    config.repo_name = config.site_name
    return config


def on_files(files: Any, config: Any) -> Any:
    """Adds the pages that are not in docs/."""
    for path in re.findall(r"'(api/[^']+)'", str(config.nav)):
        module = Path(path).name.removesuffix(".md")
        text = f"# {module}\n\n::: {module}\n"
        files.append(File.generated(config, path, content=text))
    for name, path in TOP.items():
        text = (ROOT / name).read_text(encoding="utf-8")
        files.append(File.generated(config, path, content=text))
    return files


def on_page_markdown(markdown: str, page: Any, **_: Any) -> str:
    """The page with the site's links."""
    return with_site_links(markdown, page.file.src_uri)


def with_site_links(markdown: str, page: str) -> str:
    """A page's text, with links to the site's pages instead of the repository's files; a file that
    is not on the site is named without a link."""
    sources = {path: name for name, path in TOP.items()}
    source = sources.get(page, f"docs/{page}")

    def link(match: re.Match[str]) -> str:
        text, path, anchor = match.groups()
        if not path:
            return match[0]
        target = posixpath.normpath(posixpath.join(posixpath.dirname(source), path))
        if target in TOP:
            target = TOP[target]
        elif target.startswith("docs/"):
            target = target.removeprefix("docs/")
        else:
            return text
        found = posixpath.relpath(target, posixpath.dirname(page) or ".")
        return f"[{text}]({found}{anchor or ''})"

    parts = re.split(r"(^```.*?^```$)", markdown, flags=re.MULTILINE | re.DOTALL)
    return "".join(one if one.startswith("```") else LINK.sub(link, one) for one in parts)


class _Sources(HTMLParser):
    """The addresses that a page makes a browser fetch."""

    def __init__(self) -> None:
        super().__init__()
        self.found: list[str] = []

    def handle_starttag(self, tag: str, attributes: list[tuple[str, str | None]]) -> None:
        for name, value in attributes:
            fetches = name in ("src", "srcset", "poster", "data", "xlink:href")
            fetches |= name == "href" and tag in ("link", "use", "image")
            if value and fetches and REMOTE.match(value):
                self.found.append(value)
            if value and name == "style":
                self.found += STYLES.findall(value)


def remote(text: str, suffix: str) -> list[str]:
    """The addresses in the network that a page (`.html`) or a style sheet (`.css`) fetches."""
    if suffix == ".css":
        return STYLES.findall(text)
    sources = _Sources()
    sources.feed(text)
    styles = "".join(re.findall(r"<style.*?</style>", text, re.DOTALL))
    return sources.found + STYLES.findall(styles)


def on_post_build(config: Any) -> None:
    """Refuses a site that fetches anything from the network."""
    for folder, _, names in os.walk(config.site_dir):
        for path in (Path(folder) / name for name in names):
            if path.suffix in (".html", ".css"):
                found = remote(path.read_text(encoding="utf-8"), path.suffix)
                if found:
                    raise PluginError(f"{path}: fetches {', '.join(found)}")
