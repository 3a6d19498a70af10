"""Tables that the code itself uses: the directive `{code-table} NAME` writes one of them onto a page."""

import re
from collections.abc import Callable, Iterable
from dataclasses import asdict
from pathlib import Path

import pandas as pd
from docutils import nodes
from sphinx.application import Sphinx
from sphinx.util.docutils import SphinxDirective

import vibrojax as vj
from vibrojax.io.kinds import SPECIAL_KINDS
from vibrojax.io.variables import NATURES, VARIABLES
from vibrojax.maps.read import read_sweep
from vibrojax.physics.rock import ROCKS
from vibrojax.pictures.axes import typeset
from vibrojax.scenes import HasFriction
from vibrojax.settings.toml import bundled_names
from vibrojax.studies.rop_law import SCHEMA as OF_FITS


def setup(app: Sphinx) -> dict[str, bool]:
    """Register the directive."""
    app.add_directive("code-table", CodeTable)
    return {"parallel_read_safe": True, "parallel_write_safe": True}


def of_all_scenes(listed: Callable[[str], pd.DataFrame]) -> pd.DataFrame:
    """Return the tables of all scenes as one; each row names the scenes, and the choices, that it applies to."""
    parts = [listed(name).reset_index().assign(scenes=name) for name in vj.SCENES]
    joined = pd.concat(parts)
    sources = [column for column in ("where", "scenes") if column in joined.columns]
    own = [column for column in joined.columns if column not in sources]
    rows = joined.groupby(own, sort=False)[sources].agg(lambda values: [*dict.fromkeys(values)]).reset_index()
    rows["scenes"] = [GROUPS.get(text := shortened(names), text) for names in rows.scenes]
    if "where" in rows:
        rows["where"] = [", ".join(CHOICE.sub(r"\1", place) for place in places) for places in rows["where"]]
        rows = rows.rename(columns={"where": "with"})
    return rows


CHOICE = re.compile(r'^\w+ = "([\w-]+)".*')
"""The name in `friction = "stribeck" (eq. 5.9)`."""


GROUPS = {"all but penetration": "", "all but penetration, rotary": "impacts", "all but rotary, vibro-impact": "rock"}
"""Names of frequent groups of scenes, which the page defines."""

SHARED = {
    r"(\w+)_(?:least|most)": (
        "NAME_least, NAME_most",
        "as NAME",
        "least and greatest value of the variable NAME among the samples",
        "tolerance",
        "",
    ),
    r"(\w+)_(?:least|most)_sample": (
        "NAME_least_sample, NAME_most_sample",
        "1",
        "number of the sample with the least or greatest value; -1 if there is none",
        "tolerance",
        "",
    ),
    r"return_([xv]\d|compression)": ("return_NAME", "as NAME", "state variable NAME at the return", "", ""),
    r"orbit_([xv]\d|compression)": (
        "orbit_NAME",
        "as NAME",
        "state variable NAME where the orbit crosses the section",
        "",
        "all",
    ),
    r"(\w+_order)_conf": ("NAME_conf", "1", "half-width of the confidence interval of NAME", "study", ""),
}
"""Patterns of variables that share a row, and that row: variable, units, meaning, command and scenes."""


def shortened(names: list[str]) -> str:
    """Return names of scenes as text: those that are missing, if there are fewer of them."""
    missing = [name for name in vj.SCENES if name not in names]
    if not missing:
        return "all"
    return f"all but {', '.join(missing)}" if len(missing) < len(names) else ", ".join(names)


def variables() -> pd.DataFrame:
    """Return the variables of all scenes; those that `SHARED` describes follow the others."""
    table = of_all_scenes(vj.list_variables)
    rows = []
    for pattern, (variable, units, meaning, *rest) in SHARED.items():
        names = table.variable.str.extract(f"^{pattern}$")[0]
        listed = ", ".join(names.dropna().unique())
        rows.append((variable, units, meaning if "_sample" in variable else f"{meaning}; NAME: {listed}", *rest))
        table = table[names.isna()]
    return pd.concat([table, pd.DataFrame(rows, columns=table.columns)])


def flags() -> pd.DataFrame:
    """Return the variables whose values are flags, with the meaning of each value; equal meanings share a row."""
    kept = {name: (about.first_flag, about.flags) for name, about in VARIABLES.items() if about.flags}
    kept |= {"nature": (0, NATURES), "special_kind": (0, SPECIAL_KINDS)}
    shared: dict[str, list[str]] = {}
    for name, (first, names) in kept.items():
        shared.setdefault(", ".join(f"{value} {flag}" for value, flag in enumerate(names, first)), []).append(name)
    return pd.DataFrame([(", ".join(names), text) for text, names in shared.items()], columns=["variable", "values"])


def fit() -> pd.DataFrame:
    """Return the variables of a fit of the rate-of-penetration law, without the standard errors."""
    values = {name: ", ".join(about.flags) for name, about in OF_FITS.items()}
    values["r_squared_reason"] = "as for reason"
    rows = [
        (name, about.units, about.along or "groups only", about.long_name, values[name])
        for name, about in OF_FITS.items()
        if not name.endswith("_stderr")
    ]
    return pd.DataFrame(rows, columns=["variable", "units", "along", "meaning", "values"])


def sweeps() -> pd.DataFrame:
    """Return the bundled sweeps."""
    bundled = {name: read_sweep(name) for name in bundled_names()}
    rows = [(name, sweep.scene, ", ".join(sweep.axes) or "points", sweep.lanes) for name, sweep in bundled.items()]
    return pd.DataFrame(rows, columns=["name", "scene", "over", "lanes"])


def laws() -> pd.DataFrame:
    """Return the friction laws with their own parameters, their equation, and the default."""
    rows = [(name, ", ".join(law.parameters), law.reference) for name, law in vj.FRICTION_LAWS.items()]
    first = next(scene for scene in (kind() for kind in vj.SCENES.values()) if isinstance(scene, HasFriction))
    table = pd.DataFrame(rows, columns=["name", "its parameters", "equation of the thesis"])
    table["default"] = ["yes" if name == first.friction.name else "" for name in table.name]
    return table


def thesis() -> pd.DataFrame:
    """Return the table of `tests/source`, which compares the package with Batako's thesis."""
    lines = (Path(__file__).parents[2] / "tests" / "source" / "table.md").read_text().splitlines()
    rows = [[cell.strip() for cell in line.strip().strip("|").split("|")] for line in lines if line.startswith("| ")]
    return pd.DataFrame(rows[1:], columns=rows[0])


TABLES: dict[str, Callable[[], pd.DataFrame]] = {
    "scenes": lambda: vj.list_scenes().reset_index(),
    "parameters": lambda: of_all_scenes(vj.list_parameters),
    "variables": variables,
    "settings": lambda: vj.list_settings().reset_index(),
    "flags": flags,
    "fit": fit,
    "laws": laws,
    "rocks": lambda: pd.DataFrame([{"rock": name} | asdict(rock) for name, rock in ROCKS.items()]),
    "sweeps": sweeps,
    "verdicts": lambda: thesis().verdict.value_counts().rename("results").reset_index(),
    "differences": lambda: thesis().query("verdict == 'differs'").drop(columns=["verdict", "reading"]),
}


class CodeTable(SphinxDirective):
    """The table of that name; its first column is literal."""

    required_arguments = 1

    def run(self) -> list[nodes.Node]:
        self.env.note_reread()
        table = TABLES[self.arguments[0]]()
        return [as_table(table.columns, table.itertuples(index=False))]


def as_table(header: Iterable[object], rows: Iterable[Iterable[object]], literal: bool = True) -> nodes.table:
    """Return a table of plain cells; if `literal`, the first cell of each row is code."""
    header = list(header)
    group = nodes.tgroup("", cols=len(header))
    group += [nodes.colspec("", colwidth=1) for _ in header]
    group += nodes.thead("", _row(map(_text, header), False))
    group += nodes.tbody("", *(_row(map(_text, values), literal) for values in rows))
    return nodes.table("", group, classes=["code-table"])


def _text(value: object) -> str:
    return typeset(f"{value:g}" if isinstance(value, float) else "" if value is None else str(value))


def _row(texts: Iterable[str], literal: bool) -> nodes.row:
    first, *others = texts
    cells = [nodes.literal("", first) if literal else nodes.Text(first), *map(nodes.Text, others)]
    return nodes.row("", *(nodes.entry("", nodes.paragraph("", "", cell)) for cell in cells))
