# SPDX-License-Identifier: MIT
"""Representation of objects in notebooks and terminals."""

from __future__ import annotations

import base64
import html
import mimetypes
import os
from pathlib import Path
from typing import TypeAlias

Facts: TypeAlias = list[tuple[str, str]]


class Described:
    """Base of objects that are printed as lines, and shown as a table in notebooks.

    One rank may be printed alone, so the facts are those of this rank only.
    """

    def _facts(self) -> Facts:
        """Return pairs of a name and a text. Not collective."""
        raise NotImplementedError

    def __str__(self) -> str:
        """Return the class name and a line for each fact."""
        facts = self._facts()
        width = max(len(name) for name, _ in facts)
        return "\n".join(
            [type(self).__name__, *(f"  {name:<{width}}  {text}" for name, text in facts)]
        )

    def _repr_html_(self) -> str:
        """Return a table with a row for each fact."""
        left = ' style="text-align: left"'
        rows = "".join(
            f"<tr><th{left}>{html.escape(name)}</th><td{left}>{html.escape(text)}</td></tr>"
            for name, text in self._facts()
        )
        return f"<table><caption{left}>{type(self).__name__}</caption>{rows}</table>"


class Picture(os.PathLike[str]):
    """A picture that was drawn: notebooks show it, `print` gives the name of its file.

    It can be passed wherever the path of a file is expected, such as a frame of `io.animate`.

    Args:
        path: The file; None for a picture that was drawn without a file.
        content: The PNG data of a picture without a file; None on ranks that did not draw it.
    """

    def __init__(self, path: str | Path | None, content: bytes | None = None) -> None:
        """Store the path; the file is read when it is displayed."""
        self.path = None if path is None else Path(path)
        self._content = content

    def __fspath__(self) -> str:
        """Return the path of the file.

        Raises:
            ValueError: If the picture was drawn without a file.
        """
        if self.path is None:
            raise ValueError("the picture has no file: give io.picture a path")
        return str(self.path)

    def __str__(self) -> str:
        """Return the path of the file."""
        return "picture without a file" if self.path is None else str(self.path)

    def __repr__(self) -> str:
        """Return the path of the file, as in `Picture('tip.png')`."""
        return f"Picture({None if self.path is None else str(self.path)!r})"

    def _read(self) -> bytes | None:
        if self.path is None:
            return self._content
        return self.path.read_bytes() if self.path.is_file() else None

    def _repr_png_(self) -> bytes | None:
        """Return the data of a PNG for notebooks; None for other files."""
        return self._read() if self.path is None or self.path.suffix == ".png" else None

    def _repr_html_(self) -> str | None:
        """Return the HTML of an animation, or of another format that browsers show."""
        kind = mimetypes.guess_type(str(self))[0] or ""
        content = self._read() if kind.startswith("image/") and kind != "image/png" else None
        if content is None:
            return None
        data = base64.b64encode(content).decode()
        return f'<img src="data:{kind};base64,{data}" alt="{html.escape(str(self))}">'
