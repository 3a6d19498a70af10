"""Tables as text: points of sweeps as CSV, and logs as delimited text, LAS, WITSML or xlsx, with their numbers."""

import csv
import io
import re
import warnings
from collections.abc import Collection, Iterable, Iterator, Sequence
from itertools import zip_longest
from pathlib import Path
from typing import TypeAlias
from xml.etree import ElementTree

import numpy as np
from jaxtyping import Bool, Float, Int

from vibrojax.errors import Place, counted, shown
from vibrojax.io.files import read_regular, read_text
from vibrojax.io.log_columns import recognise
from vibrojax.lazy import pd
from vibrojax.physics.units import is_unit

_MOST_LINES_LISTED = 12

MOST_LISTED = 10  # number of faults that a message lists

Frame: TypeAlias = "pd.DataFrame"

AMBIGUOUS_COMMAS = "commas are ambiguous: they may be decimal marks, or separate thousands; write decimal points"

_HEAD, _HEAD_SIZE = 200, 50_000
"""Rows in which names, units and the first numbers are sought, and characters that show what separates columns."""

_NO_ROWS = "no rows; add a line for each measurement"
_LAS_DELIMITERS = {"COMMA": ",", "TAB": "\t"}
_NUMBERS = {
    ",": re.compile(r"[-+]?(\d+|\d{1,3}(\.\d{3})+),\d+([eE][-+]?\d+)?"),
    ".": re.compile(r"[-+]?\d*\.\d+([eE][-+]?\d+)?|[-+]?\d{1,3}(,\d{3})+\.\d+"),
}
"""Numbers with a decimal mark; some could be numbers with thousands and the other mark, too."""
_THOUSANDS = {mark: re.compile(rf"[-+]?[1-9]\d{{0,2}}([{mark}]\d{{3}})+([.,]\d+)?") for mark in ",."}


def read_table(path: Path) -> tuple[int, list[str], Iterator[tuple[int, list[str]]]]:
    """Return the header of a CSV with points and its line number, and the other rows with their line numbers.

    Commas in numbers between semicolons are decimal marks; a warning says so.

    **Raises:** `InputError` if the header is not a list of names or, while reading rows, if a row has other columns.
    """
    place, text = Place(str(path)), read_text(path)
    rows, is_german = csv_rows(place, text), _separator(text) == ";"
    line, header = next(rows, (0, []))
    if not header:
        raise place.error("empty; a line of column names and a line for each point are needed")
    header = [cell.strip() for cell in header]
    if all(map(is_number, header)):
        fault = f"{shown(', '.join(header))} are numbers; the first line names the columns, like beta,gamma"
        raise place.at(f"line {line}").error(fault)
    if is_german:
        lines = list(rows)
        cells = pd.Series([cell for _, row in lines for cell in row], dtype=object).str.strip()
        if not (mark := decimal_mark([cells])):
            raise place.error(AMBIGUOUS_COMMAS)
        warnings.warn(f"{path}: semicolons separate the columns, and the decimal mark is {shown(mark)}", stacklevel=2)
        points = iter(with_points(cells, mark))
        rows = ((number, [next(points) for _ in row]) for number, row in lines)

    def checked() -> Iterator[tuple[int, list[str]]]:
        last = 0
        for last, cells in rows:
            if len(cells) != len(header):
                raise place.at(f"line {last}").error(f"has {len(cells)} cells; {len(header)} are needed, one a column")
            yield last, cells
        if not last:
            raise place.error("no points; add a line for each below the column names")

    return line, header, checked()


def is_number(cell: str) -> bool:
    """Return whether a cell holds a number other than NaN, written without the underscores of Python."""
    try:
        return "_" not in cell and float(cell) == float(cell)
    except ValueError:
        return False


def _separator(text: str) -> str:
    """Return the mark between the columns: a semicolon or a tab if most of the first lines have it, or a comma."""
    lines = [line for line in text[:_HEAD_SIZE].splitlines() if line.strip()]
    return next((mark for mark in ";\t" if 2 * sum(mark in line for line in lines) > len(lines)), ",")


def csv_rows(place: Place, text: str) -> Iterator[tuple[int, list[str]]]:
    """Return the non-empty lines of a CSV, each with its number; raise `InputError` if the text is not CSV."""
    lines = io.StringIO(text, newline="")
    reader = csv.reader(lines, skipinitialspace=True, strict=True, delimiter=_separator(text))
    try:
        yield from ((reader.line_num, row) for row in reader if any(cell.strip() for cell in row))
    except csv.Error as error:
        raise place.at(f"line {reader.line_num}").error(f"not CSV: {error}") from None


# Numbers


def decimal_mark(columns: "Iterable[pd.Series]") -> str:
    """Return the decimal mark of text cells, "." or ","; "" if both occur, or commas may be either mark."""
    columns = [column.dropna().str.strip() for column in columns]
    if not any(column.str.contains(",", regex=False).any() for column in columns):
        return "."
    cells = pd.concat(columns)
    marks = [
        mark
        for mark, like in _NUMBERS.items()
        if (cells.str.fullmatch(like) & ~cells.str.fullmatch(_THOUSANDS[mark])).any()
    ]
    return marks[0] if len(marks) == 1 else ""


def with_points(cells: "pd.Series", mark: str) -> "pd.Series":
    """Return text cells with decimal points, and without marks between thousands; `mark`: their decimal mark."""
    if not mark or (mark == "." and not cells.str.contains(",", regex=False).any()):
        return cells
    other = "," if mark == "." else "."
    cells = cells.where(~cells.str.fullmatch(_THOUSANDS[other]), cells.str.replace(other, "", regex=False))
    return cells.str.replace(",", ".", regex=False) if mark == "," else cells


def to_numbers(
    cells: "pd.Series", mark: str, nulls: Collection[str]
) -> tuple[Float[np.ndarray, " rows"], Bool[np.ndarray, " rows"]]:
    """Return the numbers in text cells, NaN where there is none, and where a cell is neither a number nor a null.

    `mark`: the decimal mark, as `decimal_mark` returns it; `nulls`: what stands for a missing value, in small letters.
    """
    cells = with_points(cells.fillna(""), mark)
    values = pd.to_numeric(cells, errors="coerce").to_numpy(float, copy=True)
    bad = ~np.isfinite(values)
    texts = cells[bad]
    bad[bad] = ~((texts == "") | texts.str.casefold().isin(nulls))
    values[bad | np.isin(values, pd.to_numeric(list(nulls), errors="coerce"))] = np.nan
    return values, bad


# Files of logs


def read_cells(place: Place, source: "Path | pd.DataFrame") -> Frame:
    """Return the cells of a file, or of a DataFrame, as texts; a file's kind is recognised by its content or ending.

    The columns have the names with their units, and the index is the number of the line. `attrs`: `line` (that of the
    names), `nulls` (a set of the numbers that stand for a missing value in this file), and `notes`.

    **Raises:** `InputError` if the file cannot be read, or a row has another width than the names (further cells may
    be empty).
    """
    if not isinstance(source, Path):
        return _of_frame(place, source)
    if source.suffix.lower() in (".xlsx", ".xlsm", ".xls"):
        cells, header = _below_names(place, _read_xlsx(place, source))
    elif (text := read_text(source, windows=True)).lstrip().startswith("~") or source.suffix.lower() == ".las":
        cells, header = _read_las(place, text)
    elif text.lstrip().startswith("<"):
        cells, header = _read_witsml(place, text)
    else:
        cells, header = _below_names(place, _table(place, csv_rows(place, text)))
    width = len(header)
    counts = cells.iloc[:, :width].notna().sum(axis=1) + (cells.iloc[:, width:].fillna("") != "").sum(axis=1)
    if (wrong := counts[counts != width].astype(int)).size:
        listed = listed_faults([f"line {line} has {counted(count, 'cell')}" for line, count in wrong.items()])
        hint = "; if commas are decimal marks, separate the columns by semicolons" if wrong.min() > width else ""
        raise place.error(f"{listed}; {width} are needed, one a column{hint}")
    return cells.iloc[:, :width].set_axis(header, axis=1).map(str.strip)


def listed_faults(faults: Sequence[str]) -> str:
    """Return the first `MOST_LISTED` faults, and the number of further ones."""
    more = f"; and {len(faults) - MOST_LISTED} more" if len(faults) > MOST_LISTED else ""
    return "; ".join(faults[:MOST_LISTED]) + more


def _of_frame(place: Place, table: Frame) -> Frame:
    """Return the cells of a DataFrame; in one that `read_log` returned, quantities are in SI."""
    units = table.attrs["units"] if "sources" in table.attrs else {}
    table = table.reset_index() if any(table.index.names) else table
    lines = table["line"] if units and "line" in table else range(2, len(table) + 2)
    table = table.drop(columns="line", errors="ignore") if units else table
    if table.empty:
        raise place.error(_NO_ROWS)
    names = [f"{name} ({units[name]})" if name in units else str(name) for name in table.columns]
    cells = table.astype(object).where(table.notna(), "").map(lambda cell: str(cell).strip())
    cells = cells.set_axis(names, axis=1).set_axis(lines)
    cells.attrs = {"line": 1, "nulls": set(), "notes": []}
    return cells


def _table(place: Place, rows: Iterable[tuple[int, list[str]]], line: int = 1, nulls: Iterable[str] = ()) -> Frame:
    """Return rows, each with its line, as `read_cells` does, with numbered columns; short rows end in None."""
    rows = list(rows)
    if not rows:
        raise place.error(_NO_ROWS)
    columns = zip_longest(*(cells for _, cells in rows))
    table = pd.DataFrame(dict(enumerate(map(list, columns))), index=[line for line, _ in rows], dtype=object)
    table.attrs = {"line": line, "nulls": set(nulls), "notes": []}
    return table


def _read_xlsx(place: Place, path: Path) -> Frame:
    try:
        content = io.BytesIO(read_regular(path))
        table = pd.read_excel(content, header=None, dtype=str, keep_default_na=False, engine="openpyxl")
    except ImportError:
        fault = "needs openpyxl, which is not installed; export as CSV"
        raise place.error(f'{fault}, or pip install "vibrojax[xlsx]"') from None
    except Exception as error:  # openpyxl raises errors of several libraries for a damaged workbook
        raise place.error(f"cannot be read as xlsx ({type(error).__name__}); export as CSV") from None
    table.index = pd.RangeIndex(1, len(table) + 1)
    return table[(table != "").any(axis=1)]


def _below_names(place: Place, table: Frame) -> tuple[Frame, list[str]]:
    """Return the cells below the names, and the names, which stand above the first row of numbers.

    A row of units goes into the names. Of several other rows there, such as titles, that with most known names counts.
    """
    head = table.iloc[:_HEAD].fillna("").map(str.strip)
    numbers = head.map(lambda cell: bool(cell) and is_number(cell.replace(",", "."))).sum(axis=1).to_numpy()
    if len(head) > 1 and not numbers.any():
        fault = f"no numbers in the first {len(head)} lines; commas, semicolons or tabs between the columns are needed"
        raise place.error(fault)
    typical = np.median(numbers[numbers > 0]) if numbers.any() else np.inf
    above = int(np.argmax(numbers >= typical / 2)) if numbers.any() else 1
    if above == len(table):
        raise place.error(_NO_ROWS)
    if not above:
        first = shown(", ".join(filter(None, head.iloc[0])))
        advice = "the first line names the columns, like relief,rate_of_penetration"
        raise place.at(f"line {table.index[0]}").error(f"{first} are numbers; {advice}")
    texts = head.iloc[:above].to_numpy().tolist()
    known = [sum(recognise(cell)[0] is not None for cell in row if cell) for row in texts]
    units = [sum(is_unit(cell.strip(" []()")) for cell in row) for row in texts]
    below = next((k for k in range(1, above) if units[k] > known[k]), None)
    names = max((k for k in range(above) if k != below), key=lambda k: (known[k], sum(map(bool, texts[k])), k))
    header = texts[names][: table.iloc[names].notna().sum()]
    if below is not None:
        header = [_with_unit(name, unit.strip(" []()")) for name, unit in zip(header, texts[below], strict=False)]
    while not header[-1] and (table.iloc[above:, len(header) - 1].fillna("") == "").all():
        header.pop()
    says = {below: "holds the units of the columns"}
    cells = table.iloc[above:]
    cells.attrs = {"line": int(table.index[names]), "nulls": set()}
    cells.attrs["notes"] = [
        f"line {table.index[k]} {says.get(k, 'holds no names and is not read')}" for k in range(above) if k != names
    ]
    return cells, header


def _with_unit(name: str, unit: str) -> str:
    """Return a name with its unit, if it is one or the name is known, and holds none: "Rotary RPM" ends in a unit."""
    quantity, own = recognise(name)
    is_wanted = unit.strip(" .-") and own is None and (quantity is not None or is_unit(unit))
    return f"{name} ({unit})" if is_wanted else name


def _read_witsml(place: Place, text: str) -> tuple[Frame, list[str]]:
    """Return the rows and names of `logData` in WITSML 1.3 or 1.4, with units of its list or of its `logCurveInfo`."""
    if "<!DOCTYPE" in text or "<!ENTITY" in text:
        raise place.error("defines entities, which are not read; export the log without them, or as CSV")
    try:
        root = ElementTree.fromstring(text)
    except (ElementTree.ParseError, ValueError) as error:
        raise place.error(f"not XML ({error}); export the log again, or as CSV") from None
    logs = root.findall(".//{*}logData")
    rows = [(row.text or "").split(",") for row in root.findall(".//{*}logData/{*}data")]
    if len(logs) != 1 or not rows:
        fault = f"holds {counted(len(logs), 'element')} logData with {counted(len(rows), 'row')}"
        raise place.error(f"{fault}; a file with one log of WITSML 1.3 or 1.4 is needed, or export as CSV")
    names, units = ((logs[0].findtext("{*}" + tag) or "").split(",") for tag in ("mnemonicList", "unitList"))
    about = {c.findtext("{*}mnemonic"): c.findtext("{*}unit") or "" for c in root.findall(".//{*}logCurveInfo")}
    names = [name.strip() for name in names] if any(names) else list(map(str, about))
    units = units if len(units) == len(names) else [about.get(name, "") for name in names]
    header = [_with_unit(name, unit.strip()) for name, unit in zip(names, units, strict=True)]
    lines = [number for number, line in enumerate(text.splitlines(), 1) if "<data>" in line]
    index = lines if len(lines) == len(rows) else range(1, len(rows) + 1)
    nulls = [(null.text or "").strip() for null in root.findall(".//{*}nullValue")]
    return _table(place, zip(index, rows, strict=True), max(index[0] - 1, 1), nulls), header


def _read_las(place: Place, text: str) -> tuple[Frame, list[str]]:
    """Return the rows and the names of a LAS file of version 1.2, 2.0 (wrapped, too) or 3.0 with one log."""
    try:
        import lasio
    except ImportError:
        raise place.error('LAS files need lasio, which is not installed; pip install "vibrojax[las]"') from None
    # lasio reads the header only: its rows have no lines, and it takes neither small letters nor sections of LAS 3.
    sections: dict[str, list[tuple[int, str]]] = {}
    lines: list[tuple[int, str]] = []
    for number, line in enumerate(text.splitlines(), 1):
        if line.startswith("~"):
            title = line[1:].strip().upper()
            key = "A" if title.startswith(("A", "LOG_DATA")) else "C" if title.startswith("LOG_DEF") else title[:1]
            if key in sections and key in "AC":
                raise place.at(f"line {number}").error("begins a second log; write one log in a file")
            lines = sections.setdefault(key, [])
        elif line.strip() and not line.lstrip().startswith("#"):
            lines.append((number, line))
    head = [line for key in "VWC" for line in (f"~{key}", *(line for _, line in sections.get(key, [])))]
    try:
        las = lasio.read(io.StringIO("\n".join([*head, "~A"])), ignore_data=True)
        is_wrapped = str(las.version.WRAP.value).strip().upper() == "YES"
        delimiter = _LAS_DELIMITERS.get(str(las.version["DLM"].value).upper()) if "DLM" in las.version else None
        rows = [(number, line.split(delimiter)) for number, line in sections["A"]]
        names = [_with_unit(str(curve.original_mnemonic), str(curve.unit or "")) for curve in las.curves]
        names_line = sections["C"][0][0]
    except Exception:  # lasio has no error of its own for a malformed header
        fault = "not LAS: ~Version with VERS and WRAP, a curve on each line of ~Curve, and rows in ~ASCII are needed"
        raise place.error(f"{fault}; export the log again, with its data, or as CSV") from None
    nulls = [str(las.well["NULL"].value)] if "NULL" in las.well else []
    return _table(place, _unwrapped(place, rows, len(names)) if is_wrapped else rows, names_line, nulls), names


def _unwrapped(place: Place, rows: Sequence[tuple[int, list[str]]], width: int) -> list[tuple[int, list[str]]]:
    """Return the records of wrapped lines, each with its first line.

    **Raises:** `InputError` if a lost cell shifts the later ones: the index, which LAS 2.0 puts on a line of its own,
    then shares one.
    """
    every = [(number, len(cells), cell) for number, cells in rows for cell in cells]
    records = [(every[k][0], [cell for *_, cell in every[k : k + width]]) for k in range(0, len(every), width)]
    for k in range(width, len(every), width):
        if every[0][1] == 1 < every[k][1]:
            fault = f"has other than {width} cells: the index of the next one is not alone on a line"
            here = place.at(f"line {records[k // width - 1][0]}")
            raise here.error(f"the record that begins here {fault}; correct it, or export the log without wrapping")
    return records


def line_ranges(lines: Int[np.ndarray, " lines"]) -> str:
    """Return line numbers as text such as "3, 7-9", at most a dozen ranges."""
    parts = np.split(lines, np.flatnonzero(np.diff(lines) > 1) + 1)
    texts = [f"{part[0]}" if part.size == 1 else f"{part[0]}-{part[-1]}" for part in parts]
    more = f" and {len(texts) - _MOST_LINES_LISTED} ranges more" if len(texts) > _MOST_LINES_LISTED else ""
    return ", ".join(texts[:_MOST_LINES_LISTED]) + more
