"""Arithmetic expressions in campaign files: parsed without running code, evaluated on NumPy arrays."""

import ast
import operator
import re
import sys
import unicodedata
from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from activefail.space.space import Constraint

CONSTANTS = {"pi": float(np.pi), "g": 9.81}
"""Named constants; g is the acceleration of free fall [m/s²]."""

_OPERATORS: dict[type[ast.AST], Callable[..., Any]] = {
    ast.Add: operator.add,
    ast.Sub: operator.sub,
    ast.Mult: operator.mul,
    ast.Div: operator.truediv,
    ast.Pow: operator.pow,
    ast.UAdd: operator.pos,
    ast.USub: operator.neg,
}

FUNCTIONS = ("sqrt", "exp", "log", "sin", "cos", "tan", "arctan", "tanh", "abs", "minimum", "maximum")
"""Functions of expressions; the last two take two arguments, the others one."""

_LONGEST = 1000
"""Most characters in an expression."""

_DEEPEST = 500
"""Most levels of nesting: more would exhaust the stack."""


@dataclass(frozen=True)
class Expression:
    """An arithmetic expression of named quantities."""

    text: str
    _tree: ast.expr
    _constants: Mapping[str, float] = field(default_factory=lambda: CONSTANTS)

    @property
    def names(self) -> frozenset[str]:
        """The names of quantities that it contains, as Python's parser normalises them."""
        nodes = [*ast.walk(self._tree)]
        called = [node.func for node in nodes if isinstance(node, ast.Call)]
        named = (node.id for node in nodes if isinstance(node, ast.Name) and node not in called)
        return frozenset(named) - {*self._constants}

    def __call__(self, quantities: Mapping[str, Any]) -> Any:
        """The value for numbers or arrays."""
        named = {parsed_name(name): value for name, value in quantities.items()}
        return _value(self._tree, {**self._constants, **named})


def parsed_name(name: str) -> str:
    """A name as Python's parser normalises it: µ, the micro sign of keyboards, becomes the Greek letter μ."""
    return unicodedata.normalize("NFKC", name)


def _number(value: float) -> Any:
    # A NumPy number: a power of Python integers may have millions of digits, one of Python floats may be complex.
    return np.float64(value)


def parse_expression(text: str, known: Collection[str] | None) -> Expression:
    """An expression of numbers, `+ - * / **`, FUNCTIONS, CONSTANTS and known names.

    Args:
        text: the expression.
        known: names of quantities; None if every name is one, also those of CONSTANTS.

    Raises:
        ValueError: naming the part that is none of these.
    """
    if len(text) > _LONGEST:
        raise ValueError(f"must have at most {_LONGEST} characters, got {len(text)}")
    try:
        tree = ast.parse(text.strip(), mode="eval").body
    except (SyntaxError, ValueError, MemoryError, RecursionError) as error:
        # Without the file and the line, which an expression does not have.
        reason = error.msg if isinstance(error, SyntaxError) else error
        raise ValueError(f"must be an arithmetic expression, got {text!r} ({reason})") from None
    depth = 0
    level: list[ast.AST] = [tree]
    while level:
        depth, level = depth + 1, [child for node in level for child in ast.iter_child_nodes(node)]
    if depth > _DEEPEST:
        raise ValueError(f"must have at most {_DEEPEST} levels of nesting, got {depth}; in {text!r}")
    if known is None:
        _check(tree, text, None)
        return Expression(text, tree, {})
    names: dict[str, str] = {}
    for name in known:
        other = names.setdefault(parsed_name(name), name)
        if other != name:
            raise ValueError(f"cannot distinguish {other!a} from {name!a}, the same name in Python; rename one")
    _check(tree, text, {*names, *CONSTANTS})
    return Expression(text, tree)


def outputs_of(expressions: Mapping[str, Expression]) -> tuple[str, ...]:
    """The outputs of a simulator that expressions of them, by margin, contain."""
    return tuple(dict.fromkeys(name for one in expressions.values() for name in sorted(one.names)))


def check_no_texts(expression: Expression, texts: Collection[str]) -> None:
    """Check that an expression takes no variable whose choices are texts.

    Args:
        expression: the expression.
        texts: the names of these variables.

    Raises:
        ValueError: naming it.
    """
    if taken := expression.names & {*map(parsed_name, texts)}:
        raise ValueError(f"{min(taken)!r} has texts as choices, which no expression takes; in {expression.text!r}")


_RELATION = re.compile(r"<=|>=|<|>")


def parse_constraint(
    text: str, known: Collection[str], carriers: Mapping[str, str], texts: Collection[str]
) -> Constraint:
    """A constraint: two expressions of known names with <=, >=, < or > between them.

    Args:
        text: the constraint.
        known: names of variables and fixed quantities.
        carriers: names of the variables that features follow from, by the features' names.
        texts: names of the variables whose choices are texts.

    Raises:
        ValueError: naming the part that is neither.
    """
    relations = _RELATION.findall(text)
    if len(relations) != 1:
        raise ValueError(f"must be two expressions with one of <=, >=, <, > between them, got {text!r}")
    left, right = (parse_expression(side, (*known, *carriers)) for side in text.split(relations[0]))
    if relations[0].startswith(">"):
        left, right = right, left
    for side in (left, right):
        check_no_texts(side, texts)
    names = {name for name in (*known, *carriers) if parsed_name(name) in left.names | right.names}
    return Constraint(text, frozenset(carriers.get(name, name) for name in names), left, right, "=" not in relations[0])


def _check(node: ast.expr, text: str, known: Collection[str] | None) -> None:
    match node:
        case ast.Constant(value=bool()):
            pass
        case ast.Constant(value=int() | float() as value):
            if abs(value) > sys.float_info.max:
                raise ValueError(f"may contain numbers up to {sys.float_info.max:g}; in {text!r}")
            return
        case ast.Name(id=name):
            if known is not None and name not in known:
                raise ValueError(f"unknown name {name!r}; known names are {', '.join(sorted(known))}; in {text!r}")
            return
        case ast.BinOp(left=left, op=op, right=right) if type(op) in _OPERATORS:
            _check(left, text, known)
            _check(right, text, known)
            return
        case ast.UnaryOp(op=op, operand=operand) if type(op) in _OPERATORS:
            _check(operand, text, known)
            return
        case ast.Call(func=ast.Name(id=function), args=arguments, keywords=[]) if function in FUNCTIONS:
            arity = 2 if function in FUNCTIONS[-2:] else 1
            if len(arguments) != arity:
                raise ValueError(f"{function} takes {arity} argument{'s' * (arity > 1)}, got {len(arguments)}")
            for argument in arguments:
                _check(argument, text, known)
            return
    raise ValueError(
        f"may contain numbers, names, + - * / **, parentheses and {', '.join(FUNCTIONS)}; "
        f"got {ast.get_source_segment(text.strip(), node)!r} in {text!r}"
    )


def _value(node: ast.expr, quantities: Mapping[str, Any]) -> Any:
    match node:
        case ast.Constant(value=value):
            return _number(value)  # type: ignore[arg-type]
        case ast.Name(id=name):
            quantity = quantities[name]
            return _number(quantity) if isinstance(quantity, float) else quantity
        case ast.BinOp(left=left, op=op, right=right):
            return _OPERATORS[type(op)](_value(left, quantities), _value(right, quantities))
        case ast.UnaryOp(op=op, operand=operand):
            return _OPERATORS[type(op)](_value(operand, quantities))
        case ast.Call(func=ast.Name(id=function), args=arguments):
            return getattr(np, function)(*(_value(argument, quantities) for argument in arguments))
    raise AssertionError(ast.dump(node))
