"""Tables as text: CSV files with commas or semicolons between the columns."""

import csv
import io
import re
import warnings
from collections.abc import Collection, Iterable, Iterator
from pathlib import Path

import numpy as np
from jaxtyping import Bool, Float

from vibrojax.errors import InputError, Place, nearest, shown
from vibrojax.io.files import read_regular
from vibrojax.lazy import pd
from vibrojax.physics.units import is_unit

Rows = list[tuple[int, list[str]]]
"""The non-empty lines of a table: (line number, cells)."""

_NUMBERS = {
    ",": re.compile(r"[-+]?(\d+|\d{1,3}(\.\d{3})+),\d+([eE][-+]?\d+)?"),
    ".": re.compile(r"[-+]?\d*\.\d+([eE][-+]?\d+)?|[-+]?\d{1,3}(,\d{3})+\.\d+"),
}
"""Numbers with a decimal mark; some could be numbers with thousands and the other mark, too."""
_THOUSANDS = {mark: re.compile(rf"[-+]?[1-9]\d{{0,2}}([{mark}]\d{{3}})+([.,]\d+)?") for mark in ",."}
_NOT_TEXT = re.compile(rb"[\x00-\x08\x0e-\x1f]|\A(\xff\xfe|\xfe\xff)")  # control characters, or UTF-16


def read_text(path: Path, windows: bool = False) -> str:
    """Return the text of a file that the user specified, without a byte order mark.

    `windows`: whether the file may be in Windows-1252, as exports of older software are; a warning then says so.

    **Raises:** `InputError` if the file cannot be read.
    """
    content = b""
    try:
        content = read_regular(path)
        return content.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        if windows and not _NOT_TEXT.search(content):
            warnings.warn(f"{path}: not UTF-8 (byte {error.start}), read as Windows-1252", stacklevel=2)
            return content.decode("cp1252", "replace")
        raise InputError(f"{path}: not UTF-8 text (byte {error.start}); save it as UTF-8") from None
    except FileNotFoundError:
        similar = [other.name for other in path.parent.glob(f"*{path.suffix}")] if path.parent.is_dir() else []
        best = nearest(path.name, similar)
        hint = f" (did you mean {shown(best)}?)" if best else ""
        raise InputError(f"{path}: no such file; give the path of one that is there{hint}") from None
    except IsADirectoryError:
        raise InputError(f"{path}: is a folder; give the path of a file") from None
    except InputError:
        raise
    except (OSError, ValueError) as error:  # ValueError: the path contains a null character
        raise InputError(f"{path}: cannot be read ({getattr(error, 'strerror', None) or error})") from None


def read_table(path: Path, row: str, none: str, example: str) -> tuple[int, list[str], Iterator[tuple[int, list[str]]]]:
    """Return the header of a CSV with the number of its line, and the other rows, each with the number of its line.

    `row`, `none`, `example`: name of a row, advice if there is none, and example of a header, for messages.

    **Raises:** `InputError` if the header is no list of names or, while reading rows, if one has other columns.
    """
    place = Place(str(path))
    rows = _read_csv(place, read_text(path))
    line, header = next(rows, (0, []))
    if not header:
        raise place.error(f"empty; a line of column names and a line for each {row} are needed")
    header, here = [cell.strip() for cell in header], place.at(f"line {line}")
    if len(header) == 1 and "\t" in header[0]:
        raise here.error(f"{shown(header[0])} is one column; separate them by commas")
    if all(map(is_number, header)):
        raise here.error(f"{shown(', '.join(header))} are numbers; the first line names the columns, like {example}")

    def checked() -> Iterator[tuple[int, list[str]]]:
        last = 0
        for last, cells in rows:
            if len(cells) != len(header):
                raise place.at(f"line {last}").error(f"has {len(cells)} cells; {len(header)} are needed, one a column")
            yield last, cells
        if not last:
            raise place.error(f"{none} below the column names")

    return line, header, checked()


def is_number(cell: str) -> bool:
    """Return whether a cell holds a number other than NaN."""
    try:
        return float(cell) == float(cell)
    except ValueError:
        return False


def csv_rows(place: Place, text: str, delimiter: str) -> Iterator[tuple[int, list[str]]]:
    """Return the non-empty lines of a CSV, each with its number; raise `InputError` if the text is not CSV."""
    reader = csv.reader(io.StringIO(text, newline=""), skipinitialspace=True, strict=True, delimiter=delimiter)
    try:
        yield from ((reader.line_num, row) for row in reader if any(cell.strip() for cell in row))
    except csv.Error as error:
        raise place.at(f"line {reader.line_num}").error(f"not CSV: {error}") from None


def decimal_mark(columns: "Iterable[pd.Series]") -> str:
    """Return the decimal mark of text cells: "." or ",", "both" if both occur, or "" if commas may be either."""
    columns = [column.dropna().str.strip() for column in columns]
    if not any(column.str.contains(",", regex=False).any() for column in columns):
        return "."
    cells = pd.concat(columns)
    marks = [
        mark
        for mark, like in _NUMBERS.items()
        if (cells.str.fullmatch(like) & ~cells.str.fullmatch(_THOUSANDS[mark])).any()
    ]
    return "both" if len(marks) == 2 else "".join(marks)


def ambiguous_commas(mark: str) -> str:
    """Return why commas are ambiguous, if the decimal mark is "both" or ""."""
    return "the file has decimal points too" if mark == "both" else "commas may separate thousands"


def with_points(cells: "pd.Series", mark: str) -> "pd.Series":
    """Return text cells with decimal points, and without marks between thousands; `mark`: their decimal mark."""
    other = "," if mark == "." else "."
    cells = cells.where(~cells.str.fullmatch(_THOUSANDS[other]), cells.str.replace(other, "", regex=False))
    return cells.where(~(cells.str.fullmatch(_NUMBERS[","]) & (mark == ",")), cells.str.replace(",", ".", regex=False))


def to_numbers(
    cells: "pd.Series", mark: str, nulls: Collection[str]
) -> tuple[Float[np.ndarray, " rows"], Bool[np.ndarray, " rows"]]:
    """Return the numbers in text cells, NaN where there is none, and where a cell is neither a number nor a null.

    `mark`: the decimal mark, as `decimal_mark` returns it; `nulls`: what stands for a missing value, in small letters.
    """
    cells = cells.fillna("").str.strip()
    cells = with_points(cells, mark) if mark in (",", ".") else cells
    missing = ((cells == "") | cells.str.casefold().isin(nulls)).to_numpy(bool)
    values = np.array([float(cell) if is_number(cell) else np.nan for cell in cells.mask(missing, "nan")])
    bad = ~np.isfinite(values) & ~missing
    return np.where(np.isin(values, [float(null) for null in nulls if is_number(null)]) | bad, np.nan, values), bad


def _read_csv(place: Place, text: str) -> Iterator[tuple[int, list[str]]]:
    """Return the non-empty lines of a CSV; columns are separated by semicolons if the first line shows it, or commas.

    Commas in numbers between semicolons are decimal marks; a warning says so.
    """
    lines = (line for line in text.splitlines() if line.strip())
    first, second = next(lines, ""), next(lines, "")
    if not (";" in first and ("," not in first or first.count(";") == second.count(";"))):
        return csv_rows(place, text, ",")
    header, *rows = csv_rows(place, text, ";")
    cells = pd.Series([cell for _, row in rows for cell in row], dtype=object).str.strip()
    commas = [(n, cell.strip()) for n, row in rows for cell in row if _NUMBERS[","].fullmatch(cell.strip())]
    mark = decimal_mark([cells]) if commas else "."
    if mark not in (",", "."):
        line, cell = commas[0]
        fault = f"{shown(cell)} is ambiguous: {ambiguous_commas(mark)}; write decimal points"
        raise place.at(f"line {line}").error(fault)
    message = "semicolons separate the columns" + (", commas are decimal marks" if mark == "," else "")
    warnings.warn(f"{place.file}: {message}", stacklevel=2)
    points = iter(with_points(cells, mark)) if mark == "," else iter(cells)
    return iter([header] + [(line, [next(points) for _ in row]) for line, row in rows])


def rows_without_units(place: Place, header: list[str], rows: Rows) -> Rows:
    """Return the rows of a CSV; raise `InputError` if the first of them holds units."""
    units = [cell.strip(" []()") for cell in rows[0][1]]
    if not any(map(is_number, units)) and any(is_unit(unit) for unit in units if unit):
        like = f"{header[0]} ({units[0]})"
        fault = f"holds units; write them behind the names, like {like}, and leave it out"
        raise place.at(f"line {rows[0][0]}").error(fault)
    return rows


def column_numbers(place: Place, name: str, index: int, rows: Rows) -> Float[np.ndarray, " rows"]:
    """Return the numbers in a column, NaN for empty cells; raise `InputError` for other text."""
    values = np.full(len(rows), np.nan)
    for position, (line, row) in enumerate(rows):
        if cell := row[index].strip():
            try:
                values[position] = float(cell.replace(",", "") if _NUMBERS["."].fullmatch(cell) else cell)
            except ValueError:
                fault = f"{shown(cell)} is not a number; write one, like 0.4, or leave it empty"
                raise place.at(f"line {line}, column {name}").error(fault) from None
    return values
