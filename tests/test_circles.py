"""No modules import each other in a circle, those that only name a type included."""

import ast
from graphlib import TopologicalSorter
from pathlib import Path

ROOT = Path(__file__).parent.parent


def test_no_modules_of_the_environments_import_each_other_in_a_circle() -> None:
    modules = {
        ".".join(path.relative_to(ROOT).with_suffix("").parts).removesuffix(".__init__"): path
        for path in (ROOT / "zipf/envs").rglob("*.py")
    }
    imports: dict[str, set[str]] = {}
    for module, path in modules.items():
        imports[module] = set()
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.ImportFrom):
                assert node.module is not None
                named = {f"{node.module}.{alias.name}" for alias in node.names}
                if not named <= modules.keys():
                    named.add(node.module)
                imports[module] |= named & modules.keys()
    TopologicalSorter(imports).prepare()  # raises CycleError
