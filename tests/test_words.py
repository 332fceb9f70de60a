"""The prose of the project: British spelling, and terms of the field instead of paraphrases.

Prose is the text of Markdown pages outside code, and comments, docstrings and messages.
"""

import ast
import io
import re
import subprocess
import tokenize
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).parent.parent
PARAPHRASES = (
    r"\bwhat (sees|learns|remembers)\b",  # the encoder, the learner, the memory
    r"\bso says\b",
    r"\bnothing is known of\b",
    r"\bgoes without saying\b",
    r"\bnothing to say about\b",
    r"\bis younger than\b",
    r"\bnothing to set aside\b",
    r"\b[GM]B of memory\b|\bout of memory\b|\bmemory cop(y|ies)\b",  # memory is the agent's; RAM
)
AMERICAN = (
    r"\b(un)?colou?r(?<=color)\w*",
    r"\b(behavior|neighbor|favor|labeled|modeling|gray|center)(s|ed|ing|al)?\b",
    r"\b(re|de|un)?(normal|optim|initial|organ|recogn|general|regular|summar|vector|discret|quant"
    r"|token|standard|visual|serial|synchron|priorit|minim|maxim|random|paralleli|categor"
    r"|synthes|penal|equal|util|final|material|special)iz(e|ed|es|er|ers|ing|ation|ations)\b",
)
BANNED = re.compile("|".join((*PARAPHRASES, *AMERICAN)), re.IGNORECASE)


def tracked(*patterns: str) -> list[Path]:
    listed = subprocess.run(
        ["git", "ls-files", "-z", *patterns], cwd=ROOT, capture_output=True, text=True, check=True
    )
    return [ROOT / name for name in listed.stdout.split("\0") if name]


def of_markdown(text: str) -> Iterator[str]:
    text = re.sub(r"^```.*?^```$", "", text, flags=re.MULTILINE | re.DOTALL)
    yield from re.sub(r"\]\([^)]*\)", "]", text).splitlines()


def of_python(text: str) -> Iterator[str]:
    """Comments, strings of several words, and names of functions, classes and arguments."""
    for token in tokenize.generate_tokens(io.StringIO(text).readline):
        if token.type == tokenize.COMMENT:
            yield token.string
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, ast.Constant) and isinstance(node.value, str):
            if len(node.value.split()) > 3:  # shorter ones may be a library's, "lower center"
                yield from node.value.splitlines()
        elif isinstance(node, ast.FunctionDef | ast.ClassDef):
            yield node.name.replace("_", " ")
        elif isinstance(node, ast.arg):
            yield node.arg.replace("_", " ")


def of_comments(text: str) -> Iterator[str]:
    yield from re.findall(r"#.*", text)


FILES = {
    **dict.fromkeys(tracked("*.md", ":!docs/record.md"), of_markdown),
    **dict.fromkeys(tracked("*.py", ":!tests/test_words.py"), of_python),
    **dict.fromkeys(tracked("configs", "examples/**/*.yaml", "Makefile", ".ci"), of_comments),
}


def test_prose_is_plain_and_british():
    found = []
    for path, lines_of in FILES.items():
        for line in lines_of(path.read_text(encoding="utf-8")):
            prose = re.sub(r"`[^`]*`", "", line)  # code is spelt as it is
            if BANNED.search(prose):
                found.append(f"{path.relative_to(ROOT)}: {prose.strip()}")
    assert not found


def test_the_check_finds_these_and_nothing_else():
    for text in ("What sees is compiled.", "a colored block", "normalized returns", "the behavior"):
        assert BANNED.search(text), text
    for text in ("coloured", "normalise", "the size of an optimiser", "agent"):
        assert not BANNED.search(text), text
