"""Messages that docs/troubleshooting.md explains and functions that docs/life_of_a_pair.md names exist."""

import ast
import re
from collections.abc import Iterator
from functools import cache

import pytest

from tests.docs.page_code import ROOT
from tests.test_repository import modules

SYMPTOMS = re.findall(r"^### `(.*)`$", (ROOT / "docs" / "troubleshooting.md").read_text(), re.MULTILINE)


@cache
def messages() -> tuple[str, ...]:
    """Texts of the program, with … in the place of values."""
    return tuple(text for path in modules() for text in literals(ast.parse(path.read_text())) if text)


def literals(tree: ast.Module) -> Iterator[str]:
    """Of a module, its docstrings left out."""
    docstrings = {id(node.value) for node in ast.walk(tree) if isinstance(node, ast.Expr)}
    for node in ast.walk(tree):
        if id(node) not in docstrings and isinstance(node, ast.Constant | ast.JoinedStr | ast.BinOp):
            yield literal(node)


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


def test_functions_of_the_life_of_a_pair_are_in_the_files_that_it_names() -> None:
    page = (ROOT / "docs" / "life_of_a_pair.md").read_text()
    found = re.findall(r"((?:`\w+`(?:, )?)+) in \[`[\w.]+`\]\(\.\./([\w/.]+)\)", page)
    assert len(found) > 12
    for names, path in found:
        text = (ROOT / path).read_text()
        assert [name for name in re.findall(r"\w+", names) if f"def {name}(" not in text] == [], path
