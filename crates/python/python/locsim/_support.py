"""What the compiled part asks of Python: JSON, progress bars, warnings."""

from __future__ import annotations

import contextlib
import importlib
import importlib.util
import json
import sys
import warnings
from typing import Any


def _plain(value: Any) -> Any:
    """A number or an array of numpy, or a path, as JSON knows it."""
    if hasattr(value, "tolist"):
        return value.tolist()
    if hasattr(value, "__fspath__"):
        return value.__fspath__()
    raise TypeError(f"{type(value).__name__} is not allowed; dicts, lists, numbers, text, booleans")


def to_json(value: Any) -> str:
    """The value as JSON.

    Raises:
        TypeError: It holds something that JSON can't.
        ValueError: It holds a number that is not finite.
    """
    return json.dumps(value, default=_plain, allow_nan=False)


def _in_notebook() -> bool:
    ipython = sys.modules.get("IPython")
    return ipython is not None and type(ipython.get_ipython()).__name__ == "ZMQInteractiveShell"


class Bars:
    """The progress of a call: one bar for each stage, by tqdm where it is installed.

    Args:
        progress: Whether to draw; `None` draws where standard error is a terminal or a notebook is.
    """

    def __init__(self, progress: bool | None) -> None:
        self._bar: Any = None
        self._tqdm: Any = None
        if progress if progress is not None else _in_notebook() or sys.stderr.isatty():
            # Bars of a notebook need ipywidgets; without them tqdm.auto warns.
            module = "tqdm.auto" if importlib.util.find_spec("ipywidgets") else "tqdm.std"
            with contextlib.suppress(ImportError):
                self._tqdm = importlib.import_module(module).tqdm

    def stage(self, name: str, total: int) -> None:
        self.finish()
        if self._tqdm is not None:
            self._bar = self._tqdm(total=total, desc=name, leave=False)

    def advance(self, n: int) -> None:
        if self._bar is not None:
            self._bar.update(n)

    def finish(self) -> None:
        if self._bar is not None:
            self._bar.close()
            self._bar = None

    def note(self, text: str) -> None:
        if self._tqdm is not None:
            self._tqdm.write(text, file=sys.stderr)

    def warn(self, text: str) -> None:
        warnings.warn(text, stacklevel=3)
