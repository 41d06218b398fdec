"""What Numba does to compile a kernel or a helper, without what they have no use for.

Numba makes machine code of every function, with what manages memory, though a helper is only ever called by kernels: it
is linked into them, and what is run is made there. So of a helper no more is made here than what is linked. And kernels
are loops over numbers: what only serves closures, arithmetic of whole arrays or inlining before there are types is left
out.
"""

from __future__ import annotations

from typing import Any

from numba import _dynfunc  # type: ignore[attr-defined]
from numba.core.codegen import JITCodeLibrary
from numba.core.compiler import CompilerBase, DefaultPassBuilder
from numba.core.compiler_machinery import PassManager, register_pass
from numba.core.runtime.nrt import rtsys
from numba.core.typed_passes import NativeLowering, NopythonRewrites
from numba.core.untyped_passes import InlineClosureLikes, InlineInlinables

UNUSED = (InlineClosureLikes, InlineInlinables, NopythonRewrites)
"""Passes of Numba that find nothing to do in a kernel, which takes them a twentieth of the time."""


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


@register_pass(mutates_CFG=True, analysis_only=False)
class _HelperLowering(NativeLowering):
    """Numba's, without machine code; helpers may be called by kernels, and raise nothing."""

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

    lowering: type[NativeLowering] = NativeLowering

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
