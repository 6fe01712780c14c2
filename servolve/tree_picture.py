"""A controller's expressions as a picture: one SVG, trees side by side, laid out by their leaves."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final
from xml.sax.saxutils import escape

from controller import Controller
from controller.decimals import format_decimal
from controller.source import Apply, Constant, Expression, Last, Name

_ROW_PX: Final = 46
_NODE_PX: Final = 22
_LETTER_PX: Final = 6.6
_GAP_PX: Final = 10.0
_TITLE_PX: Final = 34
_COLOURS: Final = {"operation": "#e8eef6", "terminal": "#e3f2ec", "constant": "#f4f0e6"}


@dataclass
class _Node:
    """Hold one node while its place is being found."""

    label: str
    kind: str
    depth: int
    children: list[_Node]
    x: float = 0.0

    @property
    def width(self) -> float:
        return max(_NODE_PX, _LETTER_PX * len(self.label) + 12)


def tree_svg(controller: Controller) -> str:
    """Draw a controller's expressions as trees, in the order of its definitions and outputs.

    Args:
        controller: the controller

    Returns:
        an SVG element that may stand alone; the same controller gives the same text
    """
    titled = [(name, expression) for name, expression in controller.source.definitions]
    titled += [
        (f"{output.name} [{output.unit}]", expression)
        for output, expression in zip(controller.outputs, controller.source.outputs, strict=True)
    ]
    parts: list[str] = []
    left, height = _GAP_PX, 0.0
    for title, expression in titled:
        nodes = _nodes(expression)
        right = _place(nodes, left, title)
        parts.append(f'<text x="{left:.1f}" y="20" class="title">{escape(title)}</text>')
        parts += [_edge(node, child) for node in nodes for child in node.children]
        parts += [_box(node) for node in nodes]
        height = max(height, _TITLE_PX + _ROW_PX * (1 + max(node.depth for node in nodes)))
        left = right + 3 * _GAP_PX
    width = left - 2 * _GAP_PX
    style = (
        ".trees text { font: 11px Helvetica, Arial, 'Liberation Sans', sans-serif; fill: #30343b; text-anchor: middle }"
        " .trees .title { font-weight: 600; font-size: 13px; text-anchor: start }"
        " .trees path { fill: none; stroke: #9aa0a8 } .trees rect { stroke: #9aa0a8 }"
    )
    body = "\n".join(parts)
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" class="trees" viewBox="0 0 {width:.0f} {height:.0f}" role="img"'
        f' aria-label="Expression trees of {escape(controller.name)}" style="width: {width:.0f}px">\n'
        f"<style>{style}</style>\n{body}\n</svg>\n"
    )


def _nodes(root: Expression) -> list[_Node]:
    """Return a tree's nodes, parents before children, from left to right."""
    first = _node(root, 0)
    pending, nodes = [(root, first)], []
    while pending:
        expression, node = pending.pop()
        nodes.append(node)
        if isinstance(expression, Apply):
            node.children = [_node(operand, node.depth + 1) for operand in expression.operands]
            pending += reversed(list(zip(expression.operands, node.children, strict=True)))
    return nodes


def _node(expression: Expression, depth: int) -> _Node:
    match expression:
        case Apply(operation=operation):
            return _Node(operation, "operation", depth, [])
        case Constant():
            return _Node(format_decimal(expression.value), "constant", depth, [])
        case Name(name=name):
            return _Node(name, "terminal", depth, [])
        case Last(name=name):
            return _Node(f"last {name}", "terminal", depth, [])


def _place(nodes: list[_Node], left: float, title: str) -> float:
    """Give every node its x, parents over the middle of their children, subtrees as near as their outlines allow.

    Source: Reingold & Tilford 1981.
    """
    outlines: dict[int, list[tuple[float, float]]] = {}  # of each subtree by depth below it, seen from its root
    for node in reversed(nodes):
        below: list[tuple[float, float]] = []
        for child in node.children:
            outline = outlines.pop(id(child))
            # to the right of its elder siblings: x holds where a child is, seen from the eldest, and then the parent
            child.x = max((high - low for (_, high), (low, _) in zip(below, outline, strict=False)), default=0.0)
            moved = [(low + child.x, high + child.x) for low, high in outline]
            below = [(old[0], new[1]) for old, new in zip(below, moved, strict=False)] + (
                below[len(moved) :] or moved[len(below) :]
            )
        middle = (node.children[0].x + node.children[-1].x) / 2 if node.children else 0.0
        for child in node.children:
            child.x -= middle
        half = (node.width + _GAP_PX) / 2
        outlines[id(node)] = [(-half, half), *((low - middle, high - middle) for low, high in below)]
    outline = outlines[id(nodes[0])]
    leftmost = min(low for low, _ in outline)
    nodes[0].x = left - leftmost
    for node in nodes:
        for child in node.children:
            child.x += node.x
    return left + max(max(high for _, high in outline) - leftmost, 1.2 * _LETTER_PX * len(title))


def _edge(node: _Node, child: _Node) -> str:
    top, bottom = _y(node.depth) + _NODE_PX / 2, _y(child.depth) - _NODE_PX / 2
    middle = (top + bottom) / 2
    curve = f"C{node.x:.1f} {middle:.1f} {child.x:.1f} {middle:.1f} {child.x:.1f} {bottom:.1f}"
    return f'<path d="M{node.x:.1f} {top:.1f}{curve}"/>'


def _box(node: _Node) -> str:
    x, y = node.x - node.width / 2, _y(node.depth) - _NODE_PX / 2
    size = f'width="{node.width:.1f}" height="{_NODE_PX}" rx="5" fill="{_COLOURS[node.kind]}"'
    return f'<rect x="{x:.1f}" y="{y:.1f}" {size}/><text x="{node.x:.1f}" y="{y + 15:.1f}">{escape(node.label)}</text>'


def _y(depth: int) -> float:
    return _TITLE_PX + _ROW_PX * (depth + 0.5)
