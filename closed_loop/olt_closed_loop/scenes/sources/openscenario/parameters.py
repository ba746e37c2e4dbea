"""Parameters and expressions of OpenSCENARIO (1.1, section 9.1), and a tree in which they stand with their values."""

import ast
import math
import operator
import re
from collections.abc import Callable, Mapping
from xml.etree.ElementTree import Element

from olt_generator.errors import InputError

_LONGEST = 300
_NAME = re.compile(r"\$([A-Za-z_]\w*)")
_BINARY: dict[type, Callable[[float, float], float]] = {
    ast.Add: operator.add,
    ast.Sub: operator.sub,
    ast.Mult: operator.mul,
    ast.Div: operator.truediv,
    ast.Mod: math.fmod,
}
_FUNCTIONS: dict[str, Callable[..., float]] = {
    "round": lambda value: float(round(value)),
    "floor": lambda value: float(math.floor(value)),
    "ceil": lambda value: float(math.ceil(value)),
    "sqrt": math.sqrt,
    "pow": math.pow,
}


def declared(element: Element, known: Mapping[str, str]) -> dict[str, str]:
    """The parameters that hold inside an element: known ones and those that it declares.

    Raises:
        InputError: a declaration has no name or value, or its value cannot be evaluated.
    """
    values = dict(known)
    for one in element.findall("ParameterDeclarations/ParameterDeclaration"):
        name, value = one.get("name"), one.get("value")
        if not name or value is None:
            raise InputError("a ParameterDeclaration without name or value")
        values[name] = substitute(value, values)
    return values


def resolve(element: Element, known: Mapping[str, str]) -> Element:
    """A copy of a tree in which every attribute has its value in place of parameters and expressions."""
    values = declared(element, known)
    # A condition's name is a label that nothing refers to; esmini's are no expressions.
    label = {"name"} if element.tag == "Condition" else set[str]()
    copy = Element(
        element.tag,
        {name: value if name in label else substitute(value, values) for name, value in element.attrib.items()},
    )
    copy.text = element.text
    copy.extend([resolve(part, values) for part in element if part.tag != "ParameterDeclarations"])
    return copy


def substitute(text: str, values: Mapping[str, str]) -> str:
    """The value of an attribute: of a parameter `$name`, of an expression `${...}`, or as it is.

    Raises:
        InputError: a parameter is not declared, or an expression is none or has no finite value.
    """
    if text.startswith("${") and text.endswith("}"):
        return repr(evaluate(text[2:-1], values))
    match = _NAME.fullmatch(text)
    return _value(match[1], values) if match else text


def evaluate(expression: str, values: Mapping[str, str]) -> float:
    """The value of an arithmetic expression.

    Raises:
        InputError: see `substitute`.
    """
    if len(expression) > _LONGEST:
        raise InputError(f"an expression of {len(expression)} characters; up to {_LONGEST} are read")
    text = _NAME.sub(lambda match: f"({_number(match[1], values)!r})", expression)
    try:
        result = _compute(ast.parse(text.strip(), mode="eval").body, expression)
    except InputError:
        raise
    except (SyntaxError, ValueError, ArithmeticError, RecursionError, MemoryError, TypeError) as error:
        raise InputError(f"expression {expression!r:.80} cannot be evaluated") from error
    if not math.isfinite(result):
        raise InputError(f"expression {expression!r:.80} has no finite value")
    return result


def _compute(node: ast.expr, expression: str) -> float:
    if isinstance(node, ast.Constant) and isinstance(node.value, int | float):
        return float(node.value)
    if isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.USub | ast.UAdd):
        value = _compute(node.operand, expression)
        return -value if isinstance(node.op, ast.USub) else value
    if isinstance(node, ast.BinOp) and type(node.op) in _BINARY:
        return _BINARY[type(node.op)](_compute(node.left, expression), _compute(node.right, expression))
    if isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and node.func.id in _FUNCTIONS:
        return _FUNCTIONS[node.func.id](*(_compute(one, expression) for one in node.args))
    raise InputError(f"expression {expression!r:.80} uses what is not read; +, -, *, /, %, round, floor, sqrt, pow are")


def _value(name: str, values: Mapping[str, str]) -> str:
    if name not in values:
        raise InputError(f"parameter ${name:.60} is not declared")
    return values[name]


def _number(name: str, values: Mapping[str, str]) -> float:
    try:
        return float(_value(name, values))
    except ValueError as error:
        raise InputError(f"parameter ${name:.60} is no number, and stands in an expression") from error
