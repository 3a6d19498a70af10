"""Writes a reproduction: the page, the table, the datasets."""

from pathlib import Path

from vibrojax.errors import InputError
from vibrojax.reproduce._page import page
from vibrojax.reproduce._run import Reproduction
from vibrojax.reproduce._table import table
from vibrojax.store.dataset import write_dataset


def write_reproduction(found: Reproduction, folder: str | Path) -> None:
    """Write `index.html`, `table.md` and the datasets into `folder`, which is made if it is not there.

    **Raises:** `InputError` where the folder cannot be written.
    """
    folder = Path(folder)
    try:
        folder.mkdir(parents=True, exist_ok=True)
        (folder / "table.md").write_text(table(found), encoding="utf-8")
        (folder / "index.html").write_text(page(found), encoding="utf-8")
    except OSError as error:
        raise InputError(f"-o: {error.filename}: cannot be written ({error.strerror})") from None
    for name, dataset in found.datasets.items():
        write_dataset(dataset, folder / f"{name}.nc")
