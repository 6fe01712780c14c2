"""The program text: the papers' S-expressions, read and printed without recursion, everything bounded."""

from __future__ import annotations

import difflib
import re
from collections.abc import Callable, Collection, Iterable, Sequence
from dataclasses import dataclass, field
from typing import Final, NoReturn

from controller.decimals import DECIMAL, format_decimal, parse_decimal
from controller.errors import InputError
from controller.operations import BY_NAME, OPERATIONS, RESERVED
from controller.source import Apply, Constant, Expression, Last, Name, Source

TEXT_MAX: Final = 1 << 20
"""Characters of a program text."""

DEPTH_MAX: Final = 1000
"""Nested operations."""

LINE_MAX: Final = 100
"""Characters of a printed line, where a list can be broken."""

NAME: Final = re.compile(r"[A-Za-z_][A-Za-z0-9_.-]{0,63}")
NAME_RULE: Final = "use a letter or _, then up to 63 letters, digits or any of _ . -"

_TOKEN: Final = re.compile(r"[()]|[^\s();]+|;[^\n]*")
_NOT_FINITE: Final = re.compile(r"[+-]?(nan|inf|infinity)", re.IGNORECASE)
_TEXT_OPERATIONS: Final = tuple(operation.name for operation in OPERATIONS if not operation.internal)


@dataclass(frozen=True)
class Place:
    """Hold where a program text begins, for errors.

    Args:
        origin: how errors call it, as a file's name
        line: line of its first character, from 1
        column: column of its first character, from 1
    """

    origin: str = "program"
    line: int = 1
    column: int = 1


@dataclass(frozen=True)
class _Tokens:
    """Hold a text cut into tokens; ends with an empty token at the end of the text."""

    place: Place
    text: str
    words: list[str]
    offsets: list[int]

    def fail(self, at: int, message: str) -> NoReturn:
        """Raise the error for token `at`."""
        _fail(self.place, self.text, self.offsets[at], message)

    def expect(self, at: int, word: str, why: str) -> int:
        """Return the index after a token that must be `word`."""
        if self.words[at] != word:
            self.fail(at, f"found {_quoted(self.words[at])} where '{word}' should stand; {why}")
        return at + 1


@dataclass
class _Scope:
    """Hold the names that an expression may use, and the uses of `last` that are checked at the end."""

    inputs: Collection[str]
    defined: set[str] = field(default_factory=set)
    lasts: list[tuple[str, int]] = field(default_factory=list)


def parse(text: str, inputs: Sequence[str], place: Place = Place()) -> Source:
    """Parse a program text.

    Args:
        text: ``(list e1 … en)`` or ``(let ((n1 e1) …) (list e1 … en))``; a ``;`` starts a comment
        inputs: names of the terminals
        place: where the text stands, for errors

    Returns:
        the program as written

    Raises:
        InputError: the text is no program; says line and column
    """
    tokens = _tokenize(text, place)
    scope = _Scope(inputs)
    definitions: list[tuple[str, Expression]] = []
    how = "write (list e1 … en), one expression for each output"
    at = tokens.expect(0, "(", how)
    is_let = tokens.words[at] == "let"
    if is_let:
        at = _definitions(tokens, at + 1, scope, definitions)
        at = tokens.expect(at, "(", "write (let ((name expression) …) (list e1 … en))")
    at = tokens.expect(at, "list", how)
    outputs: list[Expression] = []
    while tokens.words[at] not in (")", ""):
        expression, at = _expression(tokens, at, scope)
        outputs.append(expression)
    for _ in range(1 + is_let):
        at = tokens.expect(at, ")", "close every parenthesis")
    if tokens.words[at]:
        tokens.fail(at, f"found {_quoted(tokens.words[at])} after the end of the program; remove it")
    if not outputs:
        tokens.fail(at - 1, "the list is empty; write one expression for each output")
    for name, where in scope.lasts:
        if name not in scope.defined:
            what = "a terminal, not a definition" if name in scope.inputs else "not defined"
            hint = f"write (delay {name})" if name in scope.inputs else _suggest(name, scope.defined)
            tokens.fail(where, f"(last {name}): '{name}' is {what}; {hint}")
    return Source(tuple(outputs), tuple(definitions))


def _fail(place: Place, text: str, offset: int, message: str) -> NoReturn:
    line = text.count("\n", 0, offset)
    column = offset - (text.rfind("\n", 0, offset) + 1)
    first = place.column if line == 0 else 1
    raise InputError(f"{place.origin}, line {place.line + line}, column {first + column}: {message}")


def _tokenize(text: str, place: Place) -> _Tokens:
    if len(text) > TEXT_MAX:
        _fail(place, "", 0, f"the program has {len(text)} characters; write at most {TEXT_MAX}")
    words: list[str] = []
    offsets: list[int] = []
    for match in _TOKEN.finditer(text):
        if text[match.start()] != ";":
            words.append(match.group())
            offsets.append(match.start())
    words.append("")
    offsets.append(len(text))
    return _Tokens(place, text, words, offsets)


def _definitions(tokens: _Tokens, at: int, scope: _Scope, definitions: list[tuple[str, Expression]]) -> int:
    """Read ``((n1 e1) …)`` into `definitions`; return the index after it."""
    how = "write (let ((name expression) …) (list e1 … en))"
    at = tokens.expect(at, "(", how)
    while tokens.words[at] != ")":
        at = tokens.expect(at, "(", how)
        name, where = tokens.words[at], at
        if not NAME.fullmatch(name):
            tokens.fail(at, f"{_quoted(name)} can not name a definition; {NAME_RULE}")
        for taken, what in ((RESERVED, "a word of the language"), (scope.inputs, "a terminal")):
            if name in taken:
                tokens.fail(at, f"'{name}' is {what}; give the definition another name")
        expression, at = _expression(tokens, at + 1, scope)
        at = tokens.expect(at, ")", f"a definition is one expression: ({name} expression)")
        if name in scope.defined:
            tokens.fail(where, f"'{name}' is defined twice; give each definition its own name")
        scope.defined.add(name)
        definitions.append((name, expression))
    return at + 1


def _expression(tokens: _Tokens, at: int, scope: _Scope) -> tuple[Expression, int]:
    """Read one expression; return it and the index after it."""
    # each open operation: its token, and its operands so far
    open_at: list[int] = []
    operands: list[list[Expression]] = []
    while True:
        word = tokens.words[at]
        if word == "(":
            head = tokens.words[at + 1] if at + 1 < len(tokens.words) else ""
            if head == "last":
                value, at = _last(tokens, at + 1, scope)
            else:
                _check_operation(tokens, at + 1)
                if len(open_at) >= DEPTH_MAX:
                    tokens.fail(at, f"expressions are nested more than {DEPTH_MAX} deep; name parts of it with let")
                open_at.append(at + 1)
                operands.append([])
                at += 2
                continue
        elif word == ")" and open_at:
            operation = BY_NAME[tokens.words[open_at[-1]]]
            if len(operands[-1]) != operation.arity:
                tokens.fail(open_at[-1], _arity_message(operation.name, operation.arity, len(operands[-1])))
            open_at.pop()
            value = Apply(operation.name, tuple(operands.pop()))
            at += 1
        elif word == "" and open_at:
            tokens.fail(open_at[-1] - 1, f"({tokens.words[open_at[-1]]} is not closed; add the missing )")
        elif word in ("", ")"):
            tokens.fail(at, "an expression is missing; write a number, a name or (operation …)")
        else:
            value = _atom(tokens, at, scope)
            at += 1
        if not open_at:
            return value, at
        operands[-1].append(value)


def _check_operation(tokens: _Tokens, at: int) -> None:
    word = tokens.words[at] if at < len(tokens.words) else ""
    operation = BY_NAME.get(word)
    if operation is not None and not operation.internal:
        return
    if word == "list" or word == "let":
        tokens.fail(at, f"'{word}' can not stand inside an expression; a program has one let and one list, outermost")
    if word in ("", "(", ")"):
        tokens.fail(min(at, len(tokens.words) - 1), "an operation is missing after (; write (operation operand …)")
    tokens.fail(at, f"{_quoted(word)} is no operation; {_suggest(word, _TEXT_OPERATIONS)}")


def _last(tokens: _Tokens, at: int, scope: _Scope) -> tuple[Expression, int]:
    name = tokens.words[at + 1] if tokens.words[at] else ""
    if not NAME.fullmatch(name):
        tokens.fail(at, "last takes the name of a definition; write (last name)")
    scope.lasts.append((name, at + 1))
    return Last(name), tokens.expect(at + 2, ")", "last takes one name: (last name)")


def _atom(tokens: _Tokens, at: int, scope: _Scope) -> Expression:
    word = tokens.words[at]
    if word in scope.inputs or word in scope.defined:
        return Name(word)
    if DECIMAL.fullmatch(word):
        try:
            return Constant(parse_decimal(word))
        except OverflowError:
            tokens.fail(at, f"{_quoted(word)} is beyond the largest float, 3.40282347e38; write a smaller number")
    if _NOT_FINITE.fullmatch(word):
        tokens.fail(at, f"'{word}' is not finite; write a finite decimal number")
    if word in RESERVED:
        tokens.fail(at, f"'{word}' is a word of the language, not a value; write ({word} …)")
    if word[0].isdigit() or (word[0] in "+-." and word[1:2].isdigit()):
        tokens.fail(at, f"{_quoted(word)} is no decimal number; write it as -12.5 or 1e-3")
    known = (*scope.inputs, *scope.defined)
    tokens.fail(at, f"unknown terminal {_quoted(word)}; {_suggest(word, known)}")


def _arity_message(name: str, arity: int, found: int) -> str:
    operands = " ".join("abc"[:arity])
    return f"({name} …) has {found} operand{'s' * (found != 1)}; write ({name} {operands})"


def _quoted(word: str) -> str:
    if not word:
        return "the end of the text"
    return f"'{word}'" if len(word) <= 70 else f"'{word[:60]}…'"


def _suggest(word: str, known: Iterable[str]) -> str:
    listed = list(known)
    close = difflib.get_close_matches(word[:70], listed, n=1, cutoff=0.5)
    if close:
        return f"did you mean '{close[0]}'?"
    if not listed:
        return "there is none to name here"
    return f"known: {' '.join(listed[:40])}{' …' if len(listed) > 40 else ''}"


def format_source(source: Source) -> str:
    """Print a program: the same source gives the same text, and the text reads back as the same source.

    Args:
        source: the program

    Returns:
        one line, or one line for each definition and output where it would exceed `LINE_MAX`
    """
    outputs = [format_expression(output) for output in source.outputs]
    definitions = [f"({name} {format_expression(expression)})" for name, expression in source.definitions]
    line = f"(list {' '.join(outputs)})"
    if definitions:
        line = f"(let ({' '.join(definitions)}) {line})"
    if len(line) <= LINE_MAX:
        return line
    if not definitions:
        return "\n  ".join(["(list", *outputs]) + ")"
    return "\n    ".join(["(let (", *definitions]) + ")\n  " + "\n    ".join(["(list", *outputs]) + "))"


def format_expression(expression: Expression, atom: Callable[[Expression], str] | None = None) -> str:
    """Print one expression on one line.

    Args:
        expression: the expression
        atom: how to print a leaf, or None for the program text's way

    Returns:
        the text
    """
    atom = atom or _format_atom
    parts: list[str] = []
    todo: list[Expression | str] = [expression]
    push, pop = todo.append, todo.pop
    while todo:
        item = pop()
        if isinstance(item, str):
            parts.append(item)
        elif isinstance(item, Apply):
            parts.append(f" ({item.operation}")
            push(")")
            todo.extend(item.operands[::-1])
        else:
            parts.append(" " + atom(item))
    return "".join(parts)[1:]


def _format_atom(expression: Expression) -> str:
    if isinstance(expression, Name):
        return expression.name
    if isinstance(expression, Constant):
        return format_decimal(expression.value)
    assert isinstance(expression, Last)
    return f"(last {expression.name})"
