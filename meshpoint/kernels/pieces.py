"""Pieces of kernels: functions that compiled code alone calls, copied into each kernel that does.

numba makes machine code of every function it compiles, after all of LLVM's optimisation. A piece is
one of two hundred of which nothing is kept but a copy within some thirty kernels, and there it is
optimised again. Here a piece ends as the text for LLVM as it was lowered.

Loads numba: only where kernels are compiled at all.
"""

# numba is typed only in part.
# mypy: disable-error-code="no-untyped-call,attr-defined,misc,assignment,has-type"

from __future__ import annotations

from typing import Any, Final

from numba.core import compiler
from numba.core.codegen import JITCodeLibrary
from numba.core.compiler_lock import require_global_compiler_lock
from numba.core.dispatcher import _FunctionCompiler
from numba.core.registry import CPUDispatcher

import meshpoint.kernels.target  # noqa: F401  # before the first piece

_INNER: Final = {"no_cpython_wrapper": True, "no_cfunc_wrapper": True}
"""Nobody calls a piece from outside compiled code, and the two doors for that take a seventh of the
time to compile a kernel."""


def piece_of_kernels(function: Any, **options: Any) -> Any:
    """A function that kernels call, compiled into them with these options of numba's."""
    return _Piece(function, None, {"nopython": True, "boundscheck": None, **_INNER, **options})


class _PieceLibrary(JITCodeLibrary):
    """Holds a piece as it was lowered, to be linked into kernels."""

    def finalize(self) -> None:
        """Links what it calls; neither optimises it nor makes machine code."""
        require_global_compiler_lock()
        self._raise_if_finalized()
        for library in dict.fromkeys(self._linking_libraries):
            self._reload_init.update(library._reload_init)  # noqa: SLF001  # as numba does it
            self._final_module.link_in(library._get_module_for_linking(), preserve=True)  # noqa: SLF001
        self._final_module.verify()
        self._finalize_dynamic_globals()
        self._verify_declare_only_symbols()
        self._finalized = True


class _PieceCompiler(_FunctionCompiler):
    """Compiles a piece as far as it is needed."""

    def _compile_core(self, args: Any, return_type: Any) -> Any:
        flags = compiler.Flags()
        self.targetdescr.options.parse_as_flags(flags, self.targetoptions)
        flags.no_compile = True
        context = self.targetdescr.target_context
        result = compiler.compile_extra(
            self.targetdescr.typing_context,
            context,
            self.py_func,
            args=args,
            return_type=return_type,
            flags=flags,
            locals=self.locals,
            library=_PieceLibrary(context.codegen(), self.py_func.__qualname__),
            pipeline_class=self.pipeline_class,
        )
        # numba knows a compiled function by its entry point; one without gets a name for one.
        result = result._replace(entry_point=object())
        context.insert_user_function(result.entry_point, result.fndesc, [result.library])
        return result


class _Piece(CPUDispatcher):
    """A piece has no door for Python. Who calls it from there all the same, as tests do, gets the
    same function compiled once more, with one."""

    _with_door: Any = None

    def __init__(self, function: Any, *arguments: Any) -> None:
        super().__init__(function, *arguments)
        whole = self._compiler
        self._compiler = _PieceCompiler(
            function, whole.targetdescr, whole.targetoptions, whole.locals, whole.pipeline_class
        )

    def add_overload(self, cres: Any) -> None:
        """Notes what was compiled, for kernels; there is nothing that Python could call."""
        self.overloads[tuple(cres.signature.args)] = cres

    def __call__(self, *arguments: Any) -> Any:
        if self._with_door is None:
            options = {key: value for key, value in self.targetoptions.items() if key not in _INNER}
            self._with_door = CPUDispatcher(self.py_func, None, options)
        return self._with_door(*arguments)
