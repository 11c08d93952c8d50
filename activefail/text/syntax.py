"""The syntax of Python sources: what of a source decides what it does."""

import ast
from contextlib import suppress

_WITH_DOCSTRING = ast.Module | ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef


def syntax_of(source: bytes) -> ast.Module | None:
    """The syntax tree of a source without docstrings; None if it cannot be parsed."""
    # The import reports a source that cannot be parsed.
    with suppress(SyntaxError, ValueError, RecursionError, MemoryError):
        tree = ast.parse(source)
        for node in ast.walk(tree):
            if isinstance(node, _WITH_DOCSTRING) and ast.get_docstring(node, clean=False) is not None:
                node.body = node.body[1:]
        return tree
    return None


def dumped(tree: ast.AST) -> str:
    """A syntax tree as text, without places and without what is empty, which differs between versions of Python.

    Unlike `ast.dump` it does not recurse: how deep a tree it can take must not depend on the caller's depth.
    """
    parts: list[str] = []
    pending: list[object] = [tree]
    while pending:
        match pending.pop():
            case ast.AST() as node:
                parts.append(type(node).__name__)
                fields = [(name, value) for name, value in ast.iter_fields(node) if value not in (None, [])]
                pending += [one for name, value in reversed(fields) for one in (value, name)]
            case list() as nodes:
                pending += ["]", *reversed(nodes), "["]
            case int() as number:
                parts.append(f"{type(number).__name__} {number:x}")  # decimal digits are limited
            case value:
                parts.append(repr(value))
    return " ".join(parts)
