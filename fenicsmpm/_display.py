# SPDX-License-Identifier: MIT
"""What a notebook shows of a value, and what a terminal prints instead."""

from __future__ import annotations

import base64
import html
import mimetypes
import os
from pathlib import Path


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
