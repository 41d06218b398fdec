"""What studies take of the package is there: names, constants that they replace, arguments, options of commands."""

import ast
import importlib
import inspect
import re
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType

import click
import pytest

from spreadlets.cli.main import cli
from spreadlets.runtime.options import RenderOptions

TOP = "spreadlets"
BENCHMARKS = Path(__file__).resolve().parent.parent / "benchmarks"
COMMAND = "spreadlets.cli.main"
"""What a study names that runs commands."""
OPTION = re.compile(r"--[a-z][a-z-]+")
OF_OTHERS = {
    "ps": {"--ppid"},
    "dask": {"--scheduler-file", "--no-dashboard", "--host", "--port", "--nthreads", "--no-nanny"},
    "chromium": {"--headless", "--no-sandbox"},
}
"""Options of other programs that studies run."""


def of_package(module: str) -> bool:
    return module.split(".")[0] == TOP


def programs(tree: ast.AST) -> list[ast.AST]:
    """Return the nodes of the programs that a study holds as texts, to run them in processes of their own."""
    nodes = []
    for node in ast.walk(tree):
        if isinstance(node, ast.Constant) and isinstance(node.value, str) and f"\nimport {TOP}" in node.value:
            nodes += ast.walk(ast.parse(node.value))
    return nodes


def options(command: click.Command) -> set[str]:
    """Return the options of a command and of those below it."""
    found = {name for parameter in command.params for name in (*parameter.opts, *parameter.secondary_opts)}
    return found.union(*map(options, getattr(command, "commands", {}).values()))


def is_own(call: ast.Call) -> bool:
    """Whether a call declares an option of the study."""
    return isinstance(call.func, ast.Attribute) and call.func.attr == "add_argument"


class Study:
    """The text of a study, what its names stand for in the package, and what it takes that is not there."""

    def __init__(self, text: str) -> None:
        tree = ast.parse(text)
        self.nodes = [*ast.walk(tree), *programs(tree)]
        self.faults: list[str] = []
        self.known: dict[str, object] = {}
        for node in self.nodes:
            self.learn(node)
        # A name that also stands for something else may be that.
        for node in self.nodes:
            if isinstance(node, ast.arg):
                self.known.pop(node.arg, None)
            elif isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store):
                self.known.pop(node.id, None)
        self.keywords = {
            node.targets[0].id: [key.value if isinstance(key, ast.Constant) else None for key in node.value.keys]
            for node in tree.body
            if isinstance(node, ast.Assign)
            and isinstance(node.targets[0], ast.Name)
            and isinstance(node.value, ast.Dict)
        }
        # Each of these adds to the faults.
        self.look_at_attributes()
        self.look_at_patches()
        self.look_at_calls()
        self.look_at_options(text)

    def learn(self, node: ast.AST) -> None:
        """Take note of what an import makes known of the package."""
        if isinstance(node, ast.Import):
            for alias in node.names:
                if of_package(alias.name):
                    module = importlib.import_module(alias.name)
                    self.known[alias.asname or "spreadlets"] = module if alias.asname else importlib.import_module(TOP)
        elif isinstance(node, ast.ImportFrom) and of_package(node.module or ""):
            for alias in node.names:
                self.known[alias.asname or alias.name] = self.member(str(node.module), alias.name)

    def member(self, module: str, name: str) -> object:
        """Return what a module calls so, itself or a module below it; add a fault if there is no such thing."""
        try:
            owner = importlib.import_module(module)
            return getattr(owner, name) if hasattr(owner, name) else importlib.import_module(f"{module}.{name}")
        except ImportError:
            self.faults.append(f"{module} has no {name}")
            return None

    def meant(self, node: ast.AST) -> object:
        """Return what an expression names of the package, or None."""
        if isinstance(node, ast.Attribute):
            return getattr(self.meant(node.value), node.attr, None)
        return self.known.get(node.id) if isinstance(node, ast.Name) else None

    def calls(self, *named: str) -> Iterator[ast.Call]:
        """Yield the calls of such functions, or of all."""
        for node in self.nodes:
            if isinstance(node, ast.Call) and (not named or ast.unparse(node.func) in named):
                yield node

    def names_given(self, call: ast.Call) -> list[str | None]:
        """Return the keywords of a call; None among them stands for some that the text does not tell."""
        names: list[str | None] = []
        for each in call.keywords:
            names += [each.arg] if each.arg else self.keywords.get(ast.unparse(each.value), [None])
        return names

    def look_at_attributes(self) -> None:
        """Whatever is read from a module, or set in it, must be there."""
        for node in self.nodes:
            if isinstance(node, ast.Attribute) and isinstance(owner := self.meant(node.value), ModuleType):
                self.member(owner.__name__, node.attr)

    def look_at_patches(self) -> None:
        """What is replaced for a while must be there."""
        for call in self.calls("patch.multiple", "patch.object"):
            if isinstance(owner := self.meant(call.args[0]), ModuleType):
                named = [each.value for each in call.args[1:2] if isinstance(each, ast.Constant)]
                for name in named or self.names_given(call):
                    self.member(owner.__name__, str(name))

    def look_at_calls(self) -> None:
        """Functions and classes must be given the arguments that they take."""
        for call in self.calls():
            called = self.meant(call.func)
            if not inspect.isfunction(called) and not inspect.isclass(called):
                continue
            places = [each for each in call.args if not isinstance(each, ast.Starred)]
            names = self.names_given(call)
            signature = inspect.signature(called)
            bind = signature.bind_partial if None in names or len(places) < len(call.args) else signature.bind
            try:
                given = bind(*places, **{name: name for name in names if name})
            except TypeError as error:
                self.faults.append(f"{called.__qualname__}: {error}")
                continue
            for name, parameter in signature.parameters.items():
                if str(parameter.annotation) == "Unpack[RenderOptions]":
                    unknown = given.arguments.get(name, {}).keys() - RenderOptions.__annotations__.keys()
                    self.faults += [f"{called.__qualname__} has no option {each}" for each in sorted(unknown)]

    def look_at_options(self, text: str) -> None:
        """What a study that runs commands writes as an option must be one, of a command or of its own."""
        if COMMAND not in text:
            return
        own = {each.value for call in self.calls() if is_own(call) for each in call.args}
        allowed = own | options(cli) | set().union(*OF_OTHERS.values())
        written = {node.value for node in self.nodes if isinstance(node, ast.Constant) and isinstance(node.value, str)}
        self.faults += [f"no command has {each}" for each in sorted(written - allowed) if OPTION.fullmatch(each)]


@pytest.mark.parametrize("path", sorted(BENCHMARKS.glob("*.py")), ids=lambda path: path.stem)
def test_what_a_study_takes_is_there(path):
    assert Study(path.read_text()).faults == []


@pytest.mark.parametrize(
    ("text", "fault"),
    [
        ("from spreadlets.psf.model import Grid", "spreadlets.psf.model has no Grid"),
        ("from spreadlets.gone import PsfGrid", "spreadlets.gone has no PsfGrid"),
        ("import spreadlets as sp\nsp.metrics.ssim_of", "spreadlets.metrics has no ssim_of"),
        ("import spreadlets as sp\nsp.synthesize(frame)", "synthesize: missing a required argument: 'camera'"),
        ("import spreadlets as sp\nsp.synthesize(*both, layer=3)", "synthesize has no option layer"),
        (
            "from spreadlets.precompute.sparsify import sparsify\nNEW = {'PRICE': 1}\npatch.multiple(sparsify, **NEW)",
            "spreadlets.precompute.sparsify.sparsify has no PRICE",
        ),
        (
            "from spreadlets.precompute.sparsify import direct\npatch.object(direct, 'anneal', same)",
            "spreadlets.precompute.sparsify.direct has no anneal",
        ),
        ("PROGRAM = '''\nimport spreadlets as sp\nsp.read_frames()\n'''", "spreadlets has no read_frames"),
        (f"run('-m', '{COMMAND}', 'synth', '--camera', '--frozen')", "no command has --frozen"),
    ],
)
def test_what_is_not_there_is_noticed(text, fault):
    assert Study(text).faults == [fault]
