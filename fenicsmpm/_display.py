# SPDX-License-Identifier: MIT
"""What a notebook shows of a value, and what a terminal prints instead."""

from __future__ import annotations

import base64
import html
import mimetypes
import os
from pathlib import Path
from typing import TypeAlias

Facts: TypeAlias = list[tuple[str, str]]


class Described:
    """Something that is printed as lines, and shown by a notebook as a table of the same facts.

    One rank may be printed alone, so that the facts are those of this rank and no others.
    """

    def _facts(self) -> Facts:
        """What is to be said: pairs of a name and a text. Not collective."""
        raise NotImplementedError

    def __str__(self) -> str:
        """The class, and a line for each fact."""
        facts = self._facts()
        width = max(len(name) for name, _ in facts)
        return "\n".join(
            [type(self).__name__, *(f"  {name:<{width}}  {text}" for name, text in facts)]
        )

    def _repr_html_(self) -> str:
        """A table with a row for each fact."""
        left = ' style="text-align: left"'
        rows = "".join(
            f"<tr><th{left}>{html.escape(name)}</th><td{left}>{html.escape(text)}</td></tr>"
            for name, text in self._facts()
        )
        return f"<table><caption{left}>{type(self).__name__}</caption>{rows}</table>"


class Picture(os.PathLike[str]):
    """A picture that was drawn: a notebook shows it, `print` names its file.

    It can be given wherever the path of a file is expected, such as a frame of `io.animate`.

    Args:
        path: The file; None for a picture that was drawn without a file.
        content: The PNG of a picture without a file; None on the ranks that did not draw it.
    """

    def __init__(self, path: str | Path | None, content: bytes | None = None) -> None:
        """Keep the path; the file is read when somebody looks."""
        self.path = None if path is None else Path(path)
        self._content = content

    def __fspath__(self) -> str:
        """The path of the file.

        Raises:
            ValueError: If the picture was drawn without a file.
        """
        if self.path is None:
            raise ValueError("the picture has no file: give io.picture a path")
        return str(self.path)

    def __str__(self) -> str:
        """The path of the file."""
        return "picture without a file" if self.path is None else str(self.path)

    def __repr__(self) -> str:
        """The path of the file, as in `Picture('tip.png')`."""
        return f"Picture({None if self.path is None else str(self.path)!r})"

    def _read(self) -> bytes | None:
        if self.path is None:
            return self._content
        return self.path.read_bytes() if self.path.is_file() else None

    def _repr_png_(self) -> bytes | None:
        """What a notebook shows of a PNG; None for other files."""
        return self._read() if self.path is None or self.path.suffix == ".png" else None

    def _repr_html_(self) -> str | None:
        """What a notebook shows of an animation, or of another format that a browser knows."""
        kind = mimetypes.guess_type(str(self))[0] or ""
        content = self._read() if kind.startswith("image/") and kind != "image/png" else None
        if content is None:
            return None
        data = base64.b64encode(content).decode()
        return f'<img src="data:{kind};base64,{data}" alt="{html.escape(str(self))}">'
