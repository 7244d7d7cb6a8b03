"""Every message that docs/troubleshooting.md explains is one that the program can print."""

import ast
import re
from collections.abc import Iterator
from functools import cache

import pytest

from tests.docs.page_code import ROOT
from tests.test_repository import modules

PAGE = (ROOT / "docs" / "troubleshooting.md").read_text()
SYMPTOMS = re.findall(r"^### `(.*)`$", PAGE, re.MULTILINE)


@cache
def messages() -> tuple[str, ...]:
    """Texts of the program, with … in the place of values."""
    trees = (ast.parse(path.read_text()) for path in modules())
    return tuple(text for tree in trees for text in map(literal, nodes_of(tree)) if text)


def nodes_of(tree: ast.Module) -> Iterator[ast.expr]:
    """Literals of a module, its docstrings left out."""
    docstrings = {id(node.value) for node in ast.walk(tree) if isinstance(node, ast.Expr)}
    for node in ast.walk(tree):
        if id(node) not in docstrings and isinstance(node, ast.Constant | ast.JoinedStr | ast.BinOp):
            yield node


def literal(node: ast.expr) -> str:
    """The text of an expression, neighbouring parts of an addition joined; what is no literal is …"""
    match node:
        case ast.Constant(value=str(text)):
            return re.sub(r"%(?:s|d|\.\d[fg])|\{[^}]*\}", "…", text)
        case ast.JoinedStr(values=parts):
            return "".join(literal(part) if isinstance(part, ast.Constant) else "…" for part in parts)
        case ast.BinOp(left=left, op=ast.Add(), right=right):
            return (literal(left) or "…") + (literal(right) or "…")
    return ""


@pytest.mark.parametrize("symptom", SYMPTOMS)
def test_the_program_has_this_message(symptom: str) -> None:
    pattern = re.compile(".*".join(re.escape(part) for part in symptom.split("…")), re.DOTALL)
    assert any(pattern.search(message) for message in messages()), symptom
    # what is left out is values, not the message
    assert len(symptom.replace("…", "")) > 12, symptom
