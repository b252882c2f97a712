"""From LLVM's language to machine code, and from machine code to a function that can be called."""

import ctypes
import functools
from collections.abc import Callable
from typing import Any

from jaxrl_tab.lanes.target import Target

CALLED = ctypes.CFUNCTYPE(None, ctypes.c_int64, ctypes.c_void_p)
_KERNEL = ctypes.CFUNCTYPE(None, ctypes.c_int64, ctypes.c_int64, *[ctypes.c_void_p] * 4, CALLED)


@functools.cache
def _llvm() -> Any:
    """llvmlite, ready to make code for this kind of processor."""
    from llvmlite import binding

    binding.initialize_native_target()
    binding.initialize_native_asmprinter()
    return binding


@functools.cache
def _llvm_for(triple: str) -> Any:
    """llvmlite, ready to make code for some kind of processor."""
    llvm = _llvm()
    if triple != llvm.get_process_triple():  # all others: that takes a millisecond
        llvm.initialize_all_targets()
        llvm.initialize_all_asmprinters()
    return llvm


def version() -> str:
    """Of LLVM. Raises ImportError without llvmlite."""
    return ".".join(map(str, _llvm().llvm_version_info))


def _machine(target: Target) -> Any:
    return (
        _llvm_for(target.triple)
        .Target.from_triple(target.triple)
        .create_target_machine(cpu=target.cpu, features=target.features, opt=target.effort, jit=True)
    )


def object_code(text: str, target: Target) -> bytes:
    """The machine code of a module, as an object file."""
    return _machine(target).emit_object(_module(text))


def assembly(text: str, target: Target) -> str:
    """The same, to be read."""
    return _machine(target).emit_assembly(_module(text))


def _module(text: str) -> Any:
    module = _llvm().parse_assembly(text)
    module.verify()
    return module


def loaded(code: bytes, target: Target) -> Callable[..., None]:
    """The kernel in an object file, as a function of `emit.PARAMETERS`; it lets other threads run Python."""
    llvm = _llvm()
    engine = llvm.create_mcjit_compiler(llvm.parse_assembly(""), _machine(target))
    engine.add_object_file(llvm.ObjectFileRef.from_data(code))
    engine.finalize_object()
    function = _KERNEL(engine.get_function_address("kernel"))
    function.engine = engine  # pyright: ignore[reportAttributeAccessIssue] (the code lives as long as this does)
    return function
