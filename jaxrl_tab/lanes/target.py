"""The processor for which code is made."""

import functools
from typing import NamedTuple

from jaxrl_tab.lanes.text import Function


class Target(NamedTuple):
    """A processor.

    Attributes:
        triple: its kind and the operating system, as LLVM writes them.
        cpu: its model.
        features: what it can do and what not: "+avx2,-avx512f,...".
        effort: of LLVM, from 0 to 3, in choosing and ordering instructions; before that no passes are gone through.
            It changes no bit of what the code gives.
    """

    triple: str
    cpu: str
    features: str
    effort: int = 2

    def has(self, *features: str) -> bool:
        return set(self.features.split(",")) >= {f"+{name}" for name in features}

    def without(self, feature: str) -> "Target":
        """The same processor, as if it could not do something."""
        kept = [x for x in self.features.split(",") if x.lstrip("+-") != feature]
        return self._replace(features=",".join([*kept, f"-{feature}"]))

    @property
    def is_x86(self) -> bool:
        return self.triple.startswith(("x86_64", "i386", "i686"))

    @property
    def is_arm(self) -> bool:
        return self.triple.startswith(("aarch64", "arm64"))

    @property
    def width(self) -> int:
        """How many numbers of 32 bits a vector holds."""
        return 16 if self.has("avx512f", "avx512vl", "avx512dq") else 8 if self.has("avx2") else 4

    @property
    def registers(self) -> int:
        """How many vectors it has at hand."""
        return 32 if self.is_arm or self.width == 16 else 16

    @property
    def fuses(self) -> bool:
        """Whether a product and a sum are rounded once."""
        return self.is_arm or self.has("fma")

    def flush_subnormals(self, function: Function) -> str:
        """From here on numbers too small for full precision are 0, as in XLA's code.

        That is asked of the processor by bits of a control word of the thread. Returns the name of the word as it
        was, for `restore`.
        """
        if self.is_x86:
            before = function.entry("alloca i32")
            wanted = function.entry("alloca i32")
            function.do("llvm.x86.sse.stmxcsr", ("ptr", before))
            word = function.value(f"load i32, ptr {before}")
            function.line(f"store i32 {function.value(f'or i32 {word}, {1 << 15 | 1 << 6}')}, ptr {wanted}")
            function.do("llvm.x86.sse.ldmxcsr", ("ptr", wanted))
            return before
        if self.is_arm:
            before = function.call("llvm.aarch64.get.fpcr", "i64")
            wanted = function.value(f"or i64 {before}, {1 << 24}")
            function.do("llvm.aarch64.set.fpcr", ("i64", wanted))
            return before
        return ""

    def restore(self, function: Function, before: str) -> None:
        """Gives the thread its control word back."""
        if self.is_x86:
            function.do("llvm.x86.sse.ldmxcsr", ("ptr", before))
        elif self.is_arm:
            function.do("llvm.aarch64.set.fpcr", ("i64", before))


@functools.cache
def host() -> Target:
    """The processor that this runs on. Raises ImportError without llvmlite."""
    from llvmlite import binding

    features = binding.get_host_cpu_features().flatten()
    return Target(binding.get_process_triple(), binding.get_host_cpu_name(), features)
