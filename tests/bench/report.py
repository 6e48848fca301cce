"""Tables, aligned to be read in a terminal and valid as Markdown."""

from __future__ import annotations

from dataclasses import dataclass, field
from statistics import median


class Table:
    """Columns with headings; the first is aligned left, the others right."""

    def __init__(self, *headings: str) -> None:
        self._rows = [list(headings)]

    def row(self, *cells: object) -> None:
        self._rows.append([str(cell) for cell in cells])

    def markdown(self) -> str:
        widths = [max(map(len, column)) for column in zip(*self._rows, strict=True)]
        lines = [self._line(row, widths) for row in self._rows]
        rules = ["-" * width if at == 0 else "-" * (width - 1) + ":" for at, width in enumerate(widths)]
        lines.insert(1, f"| {' | '.join(rules)} |")
        return "\n".join(lines)

    @staticmethod
    def _line(row: list[str], widths: list[int]) -> str:
        cells = [
            cell.ljust(w) if at == 0 else cell.rjust(w) for at, (cell, w) in enumerate(zip(row, widths, strict=True))
        ]
        return f"| {' | '.join(cells)} |"


@dataclass
class Aim:
    """An aim with the measured value."""

    promise: str
    measured: str
    met: bool


@dataclass
class Section:
    """The results of one part."""

    title: str
    blocks: list[str] = field(default_factory=list)
    aims: list[Aim] = field(default_factory=list)

    def say(self, text: str) -> None:
        self.blocks.append(text)

    def table(self, table: Table) -> None:
        self.blocks.append(table.markdown())

    def aim(self, promise: str, measured: str, met: bool) -> None:
        self.aims.append(Aim(promise, measured, met))

    def markdown(self) -> str:
        return "\n\n".join([f"## {self.title}", *self.blocks])


def aims_table(sections: list[Section]) -> str:
    """Returns the table of the aims of all parts."""
    table = Table("aim", "seen", "")
    for section in sections:
        for aim in section.aims:
            table.row(aim.promise, aim.measured, "met" if aim.met else "MISSED")
    return table.markdown()


def size(count: int) -> str:
    """Formats a number of bytes, such as 1000 as `1 kB`."""
    for unit, factor in (("MB", 1_000_000), ("kB", 1_000)):
        if count >= factor:
            return f"{count / factor:g} {unit}"
    return f"{count} B"


def rate(per_second: float) -> str:
    return f"{per_second:,.0f}"


def micros(seconds: float | None) -> str:
    """Formats microseconds as `136` or `0.41`; an en dash stands for no value."""
    if seconds is None:
        return "–"
    value = seconds * 1e6
    return f"{value:,.0f}" if abs(value) >= 10 else f"{value:.2f}"


def times(ratio: float) -> str:
    return f"{ratio:.2f} ×"


def ratio(ours: list[float], theirs: list[float]) -> float:
    """Returns the median of the ratios of each repeat: a disturbance of a whole repeat affects both sides."""
    return median(a / b for a, b in zip(ours, theirs, strict=True))
