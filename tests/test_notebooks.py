# SPDX-License-Identifier: MIT
"""A demo opened as a notebook runs, shows its pictures inline and leaves no widgets behind."""

from pathlib import Path

import pytest

DEMOS = Path(__file__).parents[1] / "demos"
SHOWN = """
list(io.progress(range(3), "steps"))
body
"""


@pytest.mark.slow
def test_a_demo_runs_as_a_notebook(tmp_path):
    jupytext, nbclient, nbformat, _ = (
        pytest.importorskip(name, reason="of the extra docs")
        for name in ("jupytext", "nbclient", "nbformat", "ipykernel")
    )
    notebook = jupytext.read(DEMOS / "cooks_membrane.py")
    notebook.cells.append(nbformat.v4.new_code_cell(SHOWN))
    assert notebook.cells[0].cell_type == "markdown"
    nbclient.NotebookClient(
        notebook,
        timeout=300,
        kernel_name="python3",
        resources={"metadata": {"path": str(tmp_path)}},
    ).execute()
    outputs = [output for cell in notebook.cells for output in cell.get("outputs", ())]
    kinds = [set(output.get("data", ())) for output in outputs]
    assert {"image/png", "text/plain"} in kinds
    assert not any("widget" in kind for found in kinds for kind in found)
    bar, table = notebook.cells[-1].outputs
    assert bar["data"]["text/html"] == "" and "<caption" in table["data"]["text/html"]


def test_demos_ask_no_file_for_its_name():
    """A notebook has no __file__ of its own."""
    for demo in DEMOS.glob("*.py"):
        assert "__file__" not in demo.read_text().replace("fenicsmpm.__file__", ""), demo.name
