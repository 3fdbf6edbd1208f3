"""The notebooks run from top to bottom and show a figure; none is committed with its outputs."""

from pathlib import Path

import nbformat
import pytest
from nbclient import NotebookClient

NOTEBOOKS = sorted((Path(__file__).resolve().parents[1] / "notebooks").glob("*.ipynb"))

#: before each: nothing of another notebook is there, neither names nor memory
FRESH = "%reset -f\nimport railjax.base.programs\nrailjax.base.programs.forget_compiled()\n%reset -f"


def code_cells(notebook: nbformat.NotebookNode) -> list:
    return [cell for cell in notebook.cells if cell.cell_type == "code"]


@pytest.fixture(scope="module")
def client(tmp_path_factory):
    """One process for all, in a folder of its own: starting it and importing JAX takes seconds."""
    folder = {"metadata": {"path": str(tmp_path_factory.mktemp("notebooks"))}}
    client = NotebookClient(nbformat.v4.new_notebook(), timeout=300, kernel_name="python3", resources=folder)
    yield client
    client.nb = nbformat.v4.new_notebook()
    client.execute()  # the last time, after which the process ends


def test_there_are_notebooks() -> None:
    assert NOTEBOOKS


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_runs_and_shows_a_figure(path: Path, client: NotebookClient) -> None:
    client.nb = notebook = nbformat.read(path, as_version=4)
    cells = code_cells(notebook)
    assert all(cell.outputs == [] and cell.execution_count is None for cell in cells), "committed with its outputs"
    assert "railjax.use_double_precision()\nrailjax.use_all_cores()" in cells[0].source
    notebook.cells.insert(0, nbformat.v4.new_code_cell(FRESH))
    client.execute(cleanup_kc=False)
    outputs = [output for cell in cells for output in cell.outputs]
    assert any("image/png" in output.get("data", {}) for output in outputs)
