"""The pages of the documentation, and the code in them."""

import re
import shlex
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).parent.parent
RECORD = "docs/record.md"  # which the report writes
FOUND = sorted(path.relative_to(ROOT).as_posix() for path in (ROOT / "docs").rglob("*.md"))
DOCS = [page for page in FOUND if page != RECORD]
PAGES = ("README.md", "CONTRIBUTING.md", "CHANGELOG.md", "RESULTS.md", *DOCS)
TEXT = {page: (ROOT / page).read_text(encoding="utf-8") for page in PAGES}
PLACEHOLDER = re.compile(r"<|\.\.\.|[A-Z]{4}")  # as in run=<folder>, which is no command to try


@dataclass(frozen=True)
class Block:
    """A fenced block: its page, the number of its first line, language, title, and text."""

    page: str
    line: int
    language: str
    title: str
    text: str

    def __str__(self) -> str:
        return f"{self.page}:{self.line}"


def fenced(page: str, text: str) -> list[Block]:
    """Every fenced block of a page, in order.

    Raises:
        ValueError: a fence that is not three backticks at the start of a line, with a language and
            at most a title behind it; or the last block does not end.
    """
    found: list[Block] = []
    opened: tuple[int, str, str] | None = None
    inside: list[str] = []
    for number, line in enumerate(text.splitlines(keepends=True), 1):
        if not re.match(r"\s*(?:>\s*)*(?:```|~~~)", line):
            inside.append(line)
        elif opened is None:
            match = re.fullmatch(r'```(\w*)(?: title="([^"]+)")?\n', line)
            if match is None:
                raise ValueError(f"{page}:{number}: cannot tell what this block is: {line!r}")
            opened, inside = (number, match[1], match[2] or ""), []
        elif line.rstrip("\n") == "```":
            found.append(Block(page, *opened, "".join(inside)))
            opened = None
        else:
            raise ValueError(f"{page}:{number}: the block from line {opened[0]} is still open")
    if opened is not None:
        raise ValueError(f"{page}: the block from line {opened[0]} does not end")
    return found


BLOCKS = [block for page in PAGES for block in fenced(page, TEXT[page])]


def blocks(language: str, page: str) -> list[str]:
    """The texts of a page's blocks in a language."""
    return [one.text for one in BLOCKS if (one.page, one.language) == (page, language)]


def files(page: str) -> dict[str, str]:
    """The blocks of a page whose title is the name of a file to make, by that name, as they stand.

    Titles that name files of the repository say where a block is from.
    """
    return {
        one.title: one.text
        for one in BLOCKS
        if one.page == page and one.title and not (ROOT / one.title).is_file()
    }


def command(line: str) -> list[str]:
    """The words of a line of a shell, without comment and without variables set before them."""
    words = shlex.split(line, comments=True)
    while words and re.fullmatch(r"[A-Z_]+=.*", words[0]):
        del words[0]
    return words


def lines(block: Block) -> list[str]:
    """The commands of a block, with continued lines joined."""
    return block.text.replace("\\\n", " ").splitlines()


def commands(module: str) -> dict[str, tuple[str, list[str]]]:
    """Page and arguments of every `python -m <module>` that is complete, by the arguments."""
    found: dict[str, tuple[str, list[str]]] = {}
    for page in PAGES:
        shown = [
            line
            for one in BLOCKS
            if one.page == page and one.language == "sh"
            for line in lines(one)
        ]
        spans = re.findall(r"`(python -m [^`\n]+)`", TEXT[page])
        for words in map(command, shown + spans):
            arguments = " ".join(words[3:])
            if words[:3] == ["python", "-m", module] and not PLACEHOLDER.search(arguments or "<"):
                found.setdefault(arguments, (page, words[3:]))
    return found
