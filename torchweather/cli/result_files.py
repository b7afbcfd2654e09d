"""Where the results of ``torchweather apply`` go: nothing is overwritten but older results."""

from __future__ import annotations

from pathlib import Path

from torchweather.core.exceptions import InputValueError

__all__ = ["ResultFiles"]


class ResultFiles:
    """Names that results may take.

    Args:
        inputs: files to be read, none of which may be overwritten.
        out: folder of the results.
    """

    def __init__(self, inputs: list[Path], out: Path) -> None:
        self.out = out
        self.inputs = {path.resolve() for path in inputs}
        self.taken: dict[Path, str] = {}

    def free(self, target: Path, source: str, *, keep: bool) -> None:
        """Refuse a name that is an input's or that another result has; keep it for ``source``."""
        resolved = target.resolve()
        if resolved in self.inputs:
            raise InputValueError(f"apply: {target} would be overwritten; give another folder to --out.")
        if keep:
            if resolved in self.taken:
                raise InputValueError(f"apply: {self.taken[resolved]} and {source} would both be written to {target}.")
            self.taken[resolved] = source
