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
    return tuple(text for path in modules() for text in texts(ast.parse(path.read_text())))


def texts(tree: ast.Module) -> Iterator[str]:
    """Literals of a module, its docstrings left out; neighbouring parts of an addition are joined."""
    docstrings = {id(node.value) for node in ast.walk(tree) if isinstance(node, ast.Expr)}
    for node in ast.walk(tree):
        if id(node) not in docstrings and isinstance(node, ast.Constant | ast.JoinedStr | ast.BinOp):
            text = literal(node)
            if text:
                yield text


def literal(node: ast.expr) -> str:
    """The text of an expression; what is no literal is …"""
    match node:
        case ast.Constant(value=str(text)):
            return re.sub(r"%(?:s|d|\.\d[fg])|\{[^}]*\}", "…", text)
        case ast.JoinedStr(values=parts):
            return "".join(literal(part) if isinstance(part, ast.Constant) else "…" for part in parts)
        case ast.BinOp(left=left, op=ast.Add(), right=right):
            return (literal(left) or "…") + (literal(right) or "…")
    return ""


def test_the_page_has_symptoms() -> None:
    assert len(SYMPTOMS) > 30 and len(set(SYMPTOMS)) == len(SYMPTOMS)
    assert PAGE.count("\n### ") == len(SYMPTOMS)


@pytest.mark.parametrize("symptom", SYMPTOMS)
def test_the_program_has_this_message(symptom: str) -> None:
    pattern = re.compile(".*".join(re.escape(part) for part in symptom.split("…")), re.DOTALL)
    assert any(pattern.search(message) for message in messages()), symptom
    # what is left out is values, not the message
    assert len(symptom.replace("…", "")) > 12, symptom


@pytest.mark.parametrize("symptom", SYMPTOMS)
def test_each_symptom_is_explained(symptom: str) -> None:
    explanation = PAGE.partition(f"### `{symptom}`\n")[2].partition("\n#")[0].strip()
    assert len(explanation.split()) >= 3
