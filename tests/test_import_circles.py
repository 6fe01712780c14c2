"""No module imports, even by a detour or for types alone, one that imports it."""

import ast
from pathlib import Path

ROOT = Path(__file__).parent.parent
PACKAGES = ("controller", "sim_models", "evolve", "deploy", "firmware_gen", "servolve")


def imports(sources):
    """Return module => modules of ours that its source imports, anywhere in it."""
    graph = {}
    for name, text in sources.items():
        found = set()
        for node in ast.walk(ast.parse(text)):
            if isinstance(node, ast.Import):
                found |= {alias.name for alias in node.names}
            elif isinstance(node, ast.ImportFrom) and node.module:
                found |= {node.module} | {f"{node.module}.{alias.name}" for alias in node.names}
        graph[name] = found & set(sources) - {name}
    return graph


def circle(graph):
    """Return modules that import each other in a ring, [] if there are none."""
    done, path = set(), []

    def walk(name):
        if name in path:
            return [*path[path.index(name) :], name]
        if name in done:
            return []
        path.append(name)
        for other in sorted(graph[name]):
            if found := walk(other):
                return found
        done.add(path.pop())
        return []

    return next((found for name in sorted(graph) if (found := walk(name))), [])


def test_there_is_no_circle():
    files = [path for package in PACKAGES for path in (ROOT / package).rglob("*.py") if path.name != "__init__.py"]
    sources = {".".join(path.relative_to(ROOT).with_suffix("").parts): path.read_text() for path in files}
    assert len(sources) > 100
    assert circle(imports(sources)) == []


def test_a_circle_is_found():
    sources = {"a": "from b import x", "b": "def f():\n    import c", "c": "import d\nimport a", "d": ""}
    assert circle(imports(sources)) == ["a", "b", "c", "a"]
