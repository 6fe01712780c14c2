"""Docstrings say what signatures say: the names under `Args:` are the parameters, in order, all of them."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent
PACKAGES = ("controller", "sim_models", "evolve", "deploy", "firmware_gen", "servolve")
FILES = sorted(file for package in PACKAGES for file in (ROOT / package).rglob("*.py"))


def documented_names(docstring: str) -> list[str] | None:
    """Return the names under `Args:`, or None where there is no such section."""
    section = re.search(r"^Args:\n((?:[ \t]+\S.*\n?|[ \t]*\n)+)", docstring, re.M)
    if section is None:
        return None
    names = []
    for line in section.group(1).splitlines():
        entry = re.match(r"^ {4}(\*{0,2}\w+(?:, \*{0,2}\w+)*):", line)
        if entry:
            names += [name.strip().lstrip("*") for name in entry.group(1).split(",")]
    return names


def parameters(node: ast.FunctionDef | ast.AsyncFunctionDef) -> list[str]:
    """Return the parameter names of a function, without self and cls."""
    arguments = node.args
    names = [a.arg for a in (*arguments.posonlyargs, *arguments.args)]
    names += [arguments.vararg.arg] if arguments.vararg else []
    names += [a.arg for a in arguments.kwonlyargs]
    names += [arguments.kwarg.arg] if arguments.kwarg else []
    return [name for name in names if name not in ("self", "cls")]


def class_parameters(node: ast.ClassDef) -> list[str]:
    """Return the field names of a dataclass, or the parameters of a class's __init__."""
    for statement in node.body:
        if isinstance(statement, ast.FunctionDef) and statement.name == "__init__":
            return parameters(statement)
    return [
        statement.target.id
        for statement in node.body
        if isinstance(statement, ast.AnnAssign)
        and isinstance(statement.target, ast.Name)
        and "ClassVar" not in ast.unparse(statement.annotation)
        and not statement.target.id.startswith("_")
    ]


def definitions(tree: ast.Module) -> Iterator[tuple[ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef, list[str]]]:
    """Yield each class and function with what its `Args:` should name."""
    for node in ast.walk(tree):
        if isinstance(node, ast.ClassDef):
            yield node, class_parameters(node)
        elif isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
            yield node, parameters(node)


@pytest.mark.parametrize("file", FILES, ids=lambda file: str(file.relative_to(ROOT)))
def test_args_match_the_signature(file: Path):
    wrong = []
    for node, expected in definitions(ast.parse(file.read_text())):
        names = documented_names((ast.get_docstring(node) or "") + "\n")
        if names is not None and names != expected:
            wrong.append(f"{file.name}:{node.lineno} {node.name}: Args say {names}, the signature says {expected}")
    assert not wrong, "\n".join(wrong)


@pytest.mark.parametrize("file", FILES, ids=lambda file: str(file.relative_to(ROOT)))
def test_a_docstring_begins_with_one_sentence(file: Path):
    tree = ast.parse(file.read_text())
    assert ast.get_docstring(tree), f"{file} has no docstring"
    for node, _ in definitions(tree):
        docstring = ast.get_docstring(node)
        if docstring:
            first = docstring.split("\n\n")[0]
            assert first.rstrip().endswith((".", ":", "?", "`")), f"{file.name}:{node.lineno} {node.name}: {first!r}"


def test_the_check_sees_a_wrong_name():
    tree = ast.parse('def f(a, b):\n    """Do.\n\n    Args:\n        a: one\n        c: two\n    """\n')
    node, expected = next(iter(definitions(tree)))
    assert documented_names(ast.get_docstring(node) + "\n") == ["a", "c"] != expected == ["a", "b"]
