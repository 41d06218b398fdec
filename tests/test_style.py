"""What the tools do not check: long functions name the steps of their algorithm."""

import ast
import io
import tokenize

import pytest
from test_imports import MODULES

LONG = 18
"""Lines of a body from which a function is long; a table within it, over however many lines, counts as one."""
TABLES = ast.Dict | ast.List | ast.Set | ast.Tuple
SIMPLE = ast.Return | ast.Assign | ast.AnnAssign | ast.Expr


def steps_of(function: ast.FunctionDef) -> list[ast.stmt]:
    """Return the statements of a function behind its docstring, without imports."""
    body = function.body[1:] if ast.get_docstring(function) is not None else function.body
    return [statement for statement in body if not isinstance(statement, ast.Import | ast.ImportFrom)]


def length(body: list[ast.stmt]) -> int:
    """Return how many lines statements take; one simple statement alone is a table, however long."""
    if not body or (len(body) == 1 and isinstance(body[0], SIMPLE)):
        return len(body)
    lines = set(range(body[0].lineno, body[-1].end_lineno + 1))
    for statement in body:
        for node in ast.walk(statement):
            if isinstance(node, TABLES):
                lines -= set(range(node.lineno + 1, node.end_lineno + 1))
    return len(lines)


def unexplained(source: str) -> list[str]:
    """Return the names of the long functions of a module that hold no comment."""
    tokens = tokenize.generate_tokens(io.StringIO(source).readline)
    comments = {
        token.start[0]
        for token in tokens
        if token.type == tokenize.COMMENT and not token.line[: token.start[1]].strip()
    }
    found = []
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.FunctionDef) and length(steps_of(node)) >= LONG:
            if comments.isdisjoint(range(node.lineno, node.end_lineno + 1)):
                found.append(node.name)
    return found


@pytest.mark.parametrize("name", sorted(MODULES))
def test_long_functions_name_their_steps(name):
    assert not unexplained(MODULES[name].read_text())


def test_a_long_function_is_one_of_many_statements_not_a_table():
    steps = "\n".join(f"    a{i} = {i}" for i in range(LONG))
    table = "\n".join(f"        {i}," for i in range(2 * LONG))
    assert unexplained(f"def long():\n    '''Say.'''\n{steps}\n") == ["long"]
    assert unexplained(f"def named():\n    '''Say.'''\n    # Assign.\n{steps}\n") == []
    assert unexplained(f"def table():\n    a = 1\n    return [\n{table}\n    ]\n") == []
    assert unexplained(f"def loop():\n    while True:\n{steps.replace('    ', '        ')}\n") == ["loop"]
    assert unexplained(f"def call():\n    return max(\n{table}\n    )\n") == []
