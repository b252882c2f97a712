"""The text of a function in LLVM's language: lines, and names that are numbered through the whole function."""

import itertools
from collections.abc import Iterator, Sequence


class Writer:
    """Writes lines of one piece of a function.

    Attributes:
        lines: what was written.
        block: the label under which the next line stands.
        declared: the functions of LLVM that are called, each declared once for the whole module.
    """

    def __init__(self, numbers: Iterator[int], declared: set[str], block: str):
        self.numbers, self.declared, self.block = numbers, declared, block
        self.lines: list[str] = []

    def line(self, text: str) -> None:
        self.lines.append(f"  {text}")

    def fresh(self, name: str = "v") -> str:
        """A name that nothing else has."""
        return f"%{name}{next(self.numbers)}"

    def label(self, name: str) -> str:
        return self.fresh(name)[1:]

    def value(self, text: str) -> str:
        """The name of what an instruction gives."""
        name = self.fresh()
        self.line(f"{name} = {text}")
        return name

    def call(self, function: str, kind: str, *args: tuple[str, str]) -> str:
        """The result, of type `kind`, of a function of LLVM for arguments with their types."""
        types, passed = ", ".join(t for t, _ in args), ", ".join(f"{t} {x}" for t, x in args)
        self.declared.add(f"declare {kind} @{function}({types})")
        return self.value(f"call {kind} @{function}({passed})")

    def do(self, function: str, *args: tuple[str, str]) -> None:
        """Calls a function of LLVM that gives nothing."""
        types, passed = ", ".join(t for t, _ in args), ", ".join(f"{t} {x}" for t, x in args)
        self.declared.add(f"declare void @{function}({types})")
        self.line(f"call void @{function}({passed})")

    def begin(self, label: str) -> None:
        self.lines.append(f"{label}:")
        self.block = label

    def whole(self) -> Sequence[str]:
        """All that was written, when it is finished."""
        return self.lines


class Function(Writer):
    """A function: what is done at its entry, and then pieces of code one after another."""

    def __init__(self, name: str, parameters: str):
        super().__init__(itertools.count(), set(), "start")
        self.head = f"define void @{name}({parameters}) {{"
        self.at_entry = Writer(self.numbers, self.declared, "entry")
        self.pieces: list[Writer] = []
        self.lines_before: list[list[str]] = []

    def entry(self, text: str) -> str:
        """The name of what an instruction at the entry gives."""
        return self.at_entry.value(text)

    def insert(self, piece: Writer, after: str) -> None:
        """Puts a piece of code here, which is written at its own pace, and goes on under the label `after`."""
        self.pieces.append(piece)
        self.lines_before.append(self.lines)
        self.lines = []
        self.begin(after)

    def text(self) -> str:
        body: list[str] = []
        for lines, piece in zip(self.lines_before, self.pieces, strict=True):
            body += [*lines, *piece.whole()]
        return "\n".join(
            [
                *sorted(self.declared),
                self.head,
                "entry:",
                *self.at_entry.lines,
                "  br label %start",
                "start:",
                *body,
                *self.lines,
                "}",
                "!0 = !{}",
            ]
        )
