"""What Numba does to compile a kernel or a helper, without what they have no use for.

Numba makes machine code of every function, with what manages memory, though a helper is only ever called by kernels: it
is linked into them, and what is run is made there. So of a helper no more is made here than what is linked. And kernels
are loops over numbers: what only serves closures, arithmetic of whole arrays or inlining before there are types is left
out.

Numba counts who refers to an array, whenever a row is taken out of one or an array out of a tuple. Threads that share
an array wait for each other at its count, in some loops longer than all else takes. The arrays that a kernel is given
outlive it: so functions that make no arrays count nothing.
"""

from __future__ import annotations

from typing import Any

from numba import _dynfunc  # type: ignore[attr-defined]
from numba.core import ir, types
from numba.core.codegen import JITCodeLibrary
from numba.core.compiler import CompilerBase, DefaultPassBuilder
from numba.core.compiler_machinery import PassManager, register_pass
from numba.core.runtime.nrt import rtsys
from numba.core.typed_passes import NativeLowering, NopythonRewrites
from numba.core.untyped_passes import InlineClosureLikes, InlineInlinables

UNUSED = (InlineClosureLikes, InlineInlinables, NopythonRewrites)
"""Passes of Numba that find nothing to do in a kernel, which takes them a twentieth of the time."""


MAKING = ("call", "binop", "inplace_binop", "unary", "build_list", "build_set", "build_map")
"""Expressions that may make an array, or what else lies in memory of its own."""
VIEWS = ("array.reshape", "array.view")
"""Methods whose outcome lies in the memory of the array that they are of."""


def _makes_arrays(state: Any) -> bool:
    """Return whether a function makes arrays, or hands on such as others have made."""
    kinds, models = state.typemap, state.targetctx.data_model_manager

    def holds_memory(kind: types.Type) -> bool:
        return bool(models[kind].contains_nrt_meminfo())

    def makes(statement: ir.Stmt) -> bool:
        # What is assigned to a part of an array is copied first, in case it lies in the same memory.
        if isinstance(statement, (ir.SetItem, ir.StaticSetItem)):
            return isinstance(kinds[statement.value.name], types.Array)
        if not isinstance(statement, ir.Assign) or not holds_memory(kinds[statement.target.name]):
            return False
        value = statement.value
        if not isinstance(value, ir.Expr):
            return False
        # So are elements that are chosen by an array.
        if value.op == "getitem":
            return isinstance(kinds[value.index.name], types.Array)
        is_view = value.op == "call" and getattr(kinds[value.func.name], "typing_key", None) in VIEWS
        return value.op in MAKING and not is_view

    statements = (each for block in state.func_ir.blocks.values() for each in block.body)
    return holds_memory(state.return_type) or any(map(makes, statements))


@register_pass(mutates_CFG=True, analysis_only=False)
class _KernelLowering(NativeLowering):
    """Numba's, without counting references where no arrays are made."""

    _name = "kernel_lowering"

    def run_pass(self, state: Any) -> bool:
        if not _makes_arrays(state):
            state.targetctx = state.targetctx.subtarget(enable_nrt=False)
            # Where an array is made all the same, this is an error.
            vars(state.targetctx).pop("nrt", None)
        return bool(super().run_pass(state))


class _HelperCode(JITCodeLibrary):
    """The code of a helper: no machine code, and optimised once, without the passes for counting references."""

    def finalize(self) -> None:
        for library in dict.fromkeys(self._linking_libraries):
            self._reload_init.update(library._reload_init)
            # What manages memory is linked into each kernel anyway.
            if library is not rtsys.library:
                self._final_module.link_in(library._get_module_for_linking(), preserve=True)
        optimise, builder = self._codegen._module_pass_manager()
        optimise.run(self._final_module, builder)
        self._finalized = True

    def _optimize_functions(self, _: Any) -> None:
        """Leave single functions as they are: all are optimised together."""


@register_pass(mutates_CFG=True, analysis_only=False)
class _HelperLowering(_KernelLowering):
    """That of kernels, without machine code; helpers may be called by kernels, and raise nothing."""

    _name = "helper_lowering"

    def run_pass(self, state: Any) -> bool:
        state.library = _HelperCode(state.targetctx.codegen(), state.func_id.func_qualname)
        state.flags.no_compile = True
        super().run_pass(state)
        lowered = state.cr
        # Kernels know what they call by a function, though nobody can enter it from Python.
        module = lowered.fndesc.lookup_module()
        entrance = _dynfunc.make_function(module, state.func_id.func_name, "", 0, lowered.env, (state.library,))
        state.targetctx.insert_user_function(entrance, lowered.fndesc, [state.library])
        state.cr = lowered._replace(cfunc=entrance)
        return True


class KernelCompiler(CompilerBase):
    """How kernels are compiled: Numba's ``pipeline_class``."""

    lowering: type[NativeLowering] = _KernelLowering

    def define_pipelines(self) -> list[PassManager]:
        """Return Numba's passes without those that are `UNUSED`."""
        passes = PassManager("kernel")
        for each, description in DefaultPassBuilder.define_nopython_pipeline(self.state).passes:
            if each not in UNUSED:
                passes.add_pass(self.lowering if each is NativeLowering else each, description)
        passes.finalize()
        return [passes]


class HelperCompiler(KernelCompiler):
    """The same for helpers, which nothing but kernels call."""

    lowering = _HelperLowering
