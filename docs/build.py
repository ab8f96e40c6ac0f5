# SPDX-License-Identifier: MIT
"""Builds the documentation: ``./run docs`` executes tutorial and demos, then runs Sphinx.

The pages are ``build/site/index.html``. Notebooks whose script and package have not changed are
not executed again. With ``--no-execute`` others are shown without output, which takes seconds.
"""

import argparse
import asyncio
import hashlib
import importlib.util
import os
import re
import shutil
import subprocess
import sys
import tomllib
from pathlib import Path
from types import ModuleType

ROOT = Path(__file__).resolve().parents[1]
BUILD = ROOT / "build"
SOURCE, NOTEBOOKS, SITE = BUILD / "docs", BUILD / "notebooks", BUILD / "site"
TIMEOUT = 600  # s, for a cell
MODULE = """{underline}
{name}
{underline}

.. automodule:: {name}
   :no-members:

.. autosummary::
   :nosignatures:

   {names}

{entries}
"""
ENTRY = ".. auto{kind}:: {module}.{name}\n\n"
CONSTANT = ".. py:data:: {name}\n   :value: {value!r}\n\n"
# Pages of the repository that the site has elsewhere, and what their links become there
MOVED = {
    "CHANGELOG.md": "reference/changelog.md",
    "CONTRIBUTING.md": "development/contributing.md",
    "benchmarks/README.md": "reference/benchmarks.md",
    "packaging/README.md": "development/packages.md",
}
# What else pages lead to
FILES = "benchmarks", "demos", "fenicsmpm", "meshes", "packaging", "studies", "tests"
CARD = """:::{{grid-item-card}} {title}
{picture}:link: {name}
:link-type: doc
:::
"""


def install() -> None:
    """Install what the extra "docs" of pyproject.toml lists, if it is not there."""
    if all(importlib.util.find_spec(name) for name in ("myst_nb", "jupytext", "sphinx_design")):
        return
    extras = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    wanted = extras["optional-dependencies"]["docs"]
    print("installing", *wanted, flush=True)
    pip = [sys.executable, "-m", "pip", "install"]
    # what pip says is shown only if it fails: it complains that it does not see Debian's VTK
    done = subprocess.run([*pip, *wanted], stdout=subprocess.PIPE, stderr=subprocess.STDOUT)
    if done.returncode != 0:
        sys.exit(done.stdout.decode())


def version_of(script: Path) -> str:
    """Changes when a script or the package does."""
    sources = [script, *sorted((ROOT / "fenicsmpm").rglob("*.py"))]
    return hashlib.sha256(b"".join(path.read_bytes() for path in sources)).hexdigest()[:16]


def notebook_of(script: Path):
    """The notebook of a script, without the licence, which is for its file."""
    import jupytext

    text = script.read_text().removeprefix("# SPDX-License-Identifier: MIT\n").lstrip("\n")
    notebook = jupytext.reads(text, fmt="py:light")
    notebook.metadata["kernelspec"] = {
        "name": "python3", "display_name": "Python 3", "language": "python",
    }  # fmt: skip
    return notebook


async def execute(script: Path, folder: Path, free: asyncio.Semaphore) -> str | None:
    """Execute a script as a notebook in a directory of its own; what went wrong, if anything."""
    import nbformat
    from nbclient import NotebookClient
    from nbclient.exceptions import CellExecutionError, CellTimeoutError, DeadKernelError

    notebook = notebook_of(script)
    async with free:
        print("executing", script.relative_to(ROOT), flush=True)
        shutil.rmtree(folder, ignore_errors=True)
        folder.mkdir(parents=True)
        client = NotebookClient(
            notebook,
            timeout=TIMEOUT,
            resources={"metadata": {"path": str(folder)}},
            extra_arguments=["--log-level=ERROR"],
        )
        try:
            await client.async_execute()
        except (CellExecutionError, CellTimeoutError, DeadKernelError) as error:
            return f"{script.relative_to(ROOT)}: {error}"
    nbformat.write(notebook, folder / "notebook.ipynb")
    (folder / "version").write_text(version_of(script))
    return None


async def execute_all(scripts: list[Path]) -> None:
    """Execute what has changed, as many at once as there are cores."""
    free = asyncio.Semaphore(len(os.sched_getaffinity(0)))
    os.environ.update(NUMBA_NUM_THREADS="1", PYVISTA_OFF_SCREEN="true", TQDM_DISABLE="1")
    jobs = []
    for script in scripts:
        folder = NOTEBOOKS / script.stem
        done = folder / "version"
        if not done.exists() or done.read_text() != version_of(script):
            jobs.append(execute(script, folder, free))
    failed = [error for error in await asyncio.gather(*jobs) if error is not None]
    if failed:
        sys.exit("\n\n".join(failed))


def pages() -> None:
    """Copy all pages, and lead their links to the places of this site."""
    shutil.rmtree(SOURCE, ignore_errors=True)
    shutil.copytree(ROOT / "docs", SOURCE, ignore=shutil.ignore_patterns("__pycache__", "build.py"))
    for page, place in MOVED.items():
        shutil.copy2(ROOT / page, SOURCE / place)
    for folder in FILES:
        shutil.copytree(ROOT / folder, BUILD / folder, dirs_exist_ok=True)
    shutil.copy2(ROOT / "CITATION.cff", BUILD)
    for page in SOURCE.rglob("*.md"):
        page.write_text(lead(page.read_text()))


def lead(text: str) -> str:
    """A text whose links lead to places of this site instead of files of the repository."""
    text = re.sub(r"\]\((?:[\w./]*/)?([1-8]_\w+)\.py", r"](/tutorial/\1.ipynb", text)
    text = re.sub(r"\]\((?:(?:\.\./)*demos/)?(\w+)\.py", r"](/gallery/\1.ipynb", text)
    # names of demos that are no links yet
    text = re.sub(r"(?<!\[)`demos/(\w+)\.py`", r"[`demos/\1.py`](/gallery/\1.ipynb)", text)
    for old, new in MOVED.items():
        text = re.sub(rf"\]\((?:\.\./)*{re.escape(old)}", f"](/{new}", text)
    return re.sub(r"\]\((?:\.\./)*docs/", "](/", text)


def place(script: Path, folder: Path) -> str:
    """Put the notebook of a script and the script among the pages; its title."""
    import nbformat

    executed = NOTEBOOKS / script.stem / "notebook.ipynb"
    notebook = nbformat.read(executed, 4) if executed.exists() else notebook_of(script)
    folder.mkdir(parents=True, exist_ok=True)
    links = f"{{download}}`Script <{script.name}>`, {{download}}`notebook <{script.stem}.ipynb>`"
    head, _, rest = notebook.cells[0].source.partition("\n")
    if not head.startswith("# "):
        sys.exit(f"{script.relative_to(ROOT)} does not begin with a title, '# # Title'")
    notebook.cells[0].source = f"{head}\n\n{links}\n{rest}"
    for cell in notebook.cells:
        if cell.cell_type == "markdown":
            cell.source = lead(cell.source)
    nbformat.write(notebook, folder / f"{script.stem}.ipynb")
    shutil.copy2(script, folder)
    return head.removeprefix("# ")


def gallery(scripts: list[Path]) -> None:
    """The page of pictures: sections and their demos as docs/gallery.toml lists them."""
    folder = SOURCE / "gallery"
    sections = tomllib.loads((ROOT / "docs" / "gallery.toml").read_text())
    named = [name for names in sections.values() for name in names]
    if sorted(named) != sorted(script.stem for script in scripts):
        different = set(named) ^ {script.stem for script in scripts}
        sys.exit(f"docs/gallery.toml and demos/ differ: {', '.join(sorted(different))}")
    page = ["# Gallery", "Each picture leads to a page with the problem, the code and the result."]
    for section, names in sections.items():
        cards = []
        for name in names:
            title = place(ROOT / "demos" / f"{name}.py", folder)
            output = NOTEBOOKS / name / "output"
            made = [output / f"{name}{kind}" for kind in (".gif", ".png")]
            picture = next((path for path in made if path.exists()), None)
            if picture is not None:
                shutil.copy2(picture, folder)
            shown = f":img-top: {picture.name}\n" if picture else ""
            cards.append(CARD.format(title=title, name=name, picture=shown))
        page += [f"## {section}", "::::{grid} 2 2 3 3", ":gutter: 3", *cards, "::::"]
    page += ["```{toctree}\n:hidden:\n", *named, "```"]
    (folder / "index.md").write_text("\n\n".join(page[:2]) + "\n\n" + "\n".join(page[2:]) + "\n")


def modules() -> list[ModuleType]:
    """Modules whose ``__all__`` is public, each behind the one that contains it."""
    import fenicsmpm

    found = []
    for package in (getattr(fenicsmpm, name) for name in fenicsmpm.__all__):
        if isinstance(package, ModuleType):
            inner = (getattr(package, name) for name in package.__all__)
            found += [package, *(module for module in inner if isinstance(module, ModuleType))]
    return found


def entry(module: ModuleType, name: str) -> str:
    """What Sphinx is told of a public name."""
    thing = getattr(module, name)
    if not callable(thing):
        # of functions by name, the names: their addresses mean nothing
        by_name = isinstance(thing, dict) and any(map(callable, thing.values()))
        return CONSTANT.format(name=name, value=tuple(thing) if by_name else thing)
    kind = "function"
    if isinstance(thing, type):
        kind = "exception" if issubclass(thing, BaseException) else "class"
    return ENTRY.format(kind=kind, module=module.__name__, name=name)


def reference() -> None:
    """A page of the reference for each public module."""
    folder = SOURCE / "reference" / "api"
    for module in modules():
        members = {name: getattr(module, name) for name in module.__all__}
        names = [name for name, thing in members.items() if not isinstance(thing, ModuleType)]
        page = MODULE.format(
            name=module.__name__,
            underline="=" * len(module.__name__),
            names="\n   ".join(name for name in names if callable(members[name])),
            entries="".join(entry(module, name) for name in names),
        )
        (folder / f"{module.__name__}.rst").write_text(page)


def undocumented() -> list[str]:
    """Public names that the reference does not have."""
    from sphinx.util.inventory import InventoryFile

    data = (SITE / "objects.inv").read_bytes()
    inventory = InventoryFile.loads(data, uri="").data
    documented = {
        name for kind, names in inventory.items() if kind.startswith("py:") for name in names
    }
    public = {f"{module.__name__}.{name}" for module in modules() for name in module.__all__}
    return sorted(public - documented)


def main() -> None:
    """Build the site."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--no-execute", action="store_true", help="show notebooks as they are")
    arguments = parser.parse_args()
    install()
    tutorial = sorted((ROOT / "docs" / "tutorial").glob("*.py"))
    demos = sorted((ROOT / "demos").glob("*.py"))
    if not arguments.no_execute:
        asyncio.run(execute_all(tutorial + demos))
    pages()
    for step in tutorial:
        place(step, SOURCE / "tutorial")
    gallery(demos)
    reference()
    sphinx = [sys.executable, "-m", "sphinx", "-W", "--keep-going", "-q", "-E"]
    build = subprocess.run([*sphinx, "-d", BUILD / "doctrees", SOURCE, SITE])
    if build.returncode != 0:
        sys.exit(build.returncode)
    if missing := undocumented():
        sys.exit(f"public names without a place in the reference: {', '.join(missing)}")
    print(f"the site is in {(SITE / 'index.html').relative_to(ROOT)}")


if __name__ == "__main__":
    main()
