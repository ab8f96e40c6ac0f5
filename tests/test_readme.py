# SPDX-License-Identifier: MIT
"""What the pages print is true: code blocks run, outputs are as printed, links lead somewhere."""

import contextlib
import io
import logging
import re
import tomllib
from pathlib import Path

import pytest

import fenicsmpm

ROOT = Path(__file__).parents[1]
FIRST = [ROOT / name for name in ("README.md", "CONTRIBUTING.md", "packaging/README.md")]
PAGES = [*FIRST, *sorted((ROOT / "docs").rglob("*.md"))]
BLOCK = re.compile(r"^```(\w*)\n(.*?)^```$", re.MULTILINE | re.DOTALL)


def blocks(page):
    """Language, text and first line of each code block of a page."""
    text = page.read_text()
    for match in BLOCK.finditer(text):
        yield match[1], match[2], text.count("\n", 0, match.start(2))


def pages_with_code():
    """Of which the first, README.md, is run again with the newest dolfinx."""
    pages = [page for page in PAGES if any(language == "python" for language, _, _ in blocks(page))]
    for k, page in enumerate(pages):
        marks = [pytest.mark.once] if k > 0 else []
        yield pytest.param(page, id=str(page.relative_to(ROOT)), marks=marks)


@pytest.mark.parametrize("page", pages_with_code())
def test_code_of_a_page(page, tmp_path, monkeypatch):
    """The Python blocks of a page are one script; a text block after one is what it prints."""
    if "import gmsh" in page.read_text():
        pytest.importorskip("gmsh")
    monkeypatch.chdir(tmp_path)  # some write files
    log = logging.getLogger("fenicsmpm")  # of which others may print more
    for name, value in ("handlers", []), ("propagate", True), ("level", logging.NOTSET):
        monkeypatch.setattr(log, name, value)
    namespace = {"__name__": "__main__"}
    printed = None
    for language, text, line in blocks(page):
        if language == "python":
            out = io.StringIO()
            with contextlib.redirect_stdout(out):
                # empty lines in front: a traceback then names the line of the page
                exec(compile("\n" * line + text, page, "exec"), namespace)
            printed = out.getvalue()
        else:
            if language == "text" and printed is not None:
                assert printed == text, f"{page.name}, line {line + 1}"
            printed = None


def test_readme_example_is_short_and_prints():
    code = [text for language, text, _ in blocks(ROOT / "README.md") if language == "python"]
    assert len(code) == 1
    assert len(code[0].splitlines()) <= 25
    assert "print(" in code[0]


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_links_of_a_page(page):
    for target in re.findall(r"\]\(([^)#]+)(?:#[^)]*)?\)", page.read_text()):
        assert "://" in target or (page.parent / target).exists(), target


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_named_files_exist(page):
    """Paths in backticks, such as `fenicsmpm/forms/form.py`."""
    pattern = r"`((?:fenicsmpm|demos|tests|benchmarks|docs|packaging|\.ci)/[\w./]*)`"
    for name in re.findall(pattern, page.read_text()):
        assert (ROOT / name).exists(), name


def test_one_version():
    settings = tomllib.loads((ROOT / "pyproject.toml").read_text())
    assert settings["project"]["dynamic"] == ["version"]
    assert settings["tool"]["setuptools"]["dynamic"]["version"] == {"attr": "fenicsmpm.__version__"}
    recipe = (ROOT / "packaging/conda/recipe.yaml").read_text()
    assert f'version: "{fenicsmpm.__version__}"' in recipe
    assert f"\nversion: {fenicsmpm.__version__}\n" in (ROOT / "CITATION.cff").read_text()
    assert f"## [{fenicsmpm.__version__}]" in (ROOT / "CHANGELOG.md").read_text()
