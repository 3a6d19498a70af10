"""Tables of what the code itself goes by: a directive `{code-table} NAME` writes one of those below onto a page."""

from collections.abc import Callable, Iterable
from dataclasses import asdict

import pandas as pd
from docutils import nodes
from sphinx.application import Sphinx
from sphinx.util.docutils import SphinxDirective

import vibrojax as vj
from vibrojax.families.indicators import KINDS
from vibrojax.input.read import read_sweep
from vibrojax.input.source import bundled_names
from vibrojax.physics.rock import ROCKS
from vibrojax.scenes import HasFriction
from vibrojax.store.variables import NATURES, VARIABLES
from vibrojax.words import WORDS


def setup(app: Sphinx) -> dict[str, bool]:
    """Make the directive known."""
    app.add_directive("code-table", CodeTable)
    return {"parallel_read_safe": True, "parallel_write_safe": True}


def of_all_scenes(listed: Callable[[str], pd.DataFrame]) -> pd.DataFrame:
    """The tables of every scene as one, a row saying in which scenes it is as it stands there."""
    parts = [listed(name).reset_index().assign(scenes=name) for name in vj.SCENES]
    joined = pd.concat(parts).fillna("").astype({"scenes": str})
    own = [column for column in joined.columns if column != "scenes"]
    rows = joined.groupby(own, sort=False).scenes.agg(list).reset_index()
    rows["scenes"] = ["all" if len(names) == len(vj.SCENES) else ", ".join(names) for names in rows.scenes]
    return rows


def flags() -> pd.DataFrame:
    """Variables whose values are flags, with what each value means."""
    kept = {name: (one.first_flag, one.flags) for name, one in VARIABLES.items() if one.flags}
    kept |= {"nature": (0, NATURES), "special_kind": (0, KINDS)}
    return pd.DataFrame(
        [
            (name, ", ".join(f"{value} {flag}" for value, flag in enumerate(names, first)))
            for name, (first, names) in kept.items()
        ],
        columns=["variable", "values"],
    )


def sweeps() -> pd.DataFrame:
    """The bundled sweeps."""
    found = {name: read_sweep(name) for name in bundled_names()}
    rows = [(name, one.scene.name, ", ".join(one.axes) or "points", one.lanes) for name, one in found.items()]
    return pd.DataFrame(rows, columns=["name", "scene", "over", "lanes"])


def laws() -> pd.DataFrame:
    """Friction laws, with their own parameters and equation; what a scene has by default is said there."""
    rows = [(name, ", ".join(law.parameters), law.reference) for name, law in vj.FRICTION_LAWS.items()]
    first = next(scene for scene in (kind() for kind in vj.SCENES.values()) if isinstance(scene, HasFriction))
    table = pd.DataFrame(rows, columns=["name", "its parameters", "equation of the source"])
    table["default"] = ["yes" if name == first.friction.name else "" for name in table.name]
    return table


TABLES: dict[str, Callable[[], pd.DataFrame]] = {
    "scenes": lambda: vj.list_scenes().reset_index(),
    "parameters": lambda: of_all_scenes(vj.list_parameters),
    "variables": lambda: of_all_scenes(vj.list_variables),
    "settings": lambda: vj.list_settings().reset_index(),
    "flags": flags,
    "laws": laws,
    "rocks": lambda: pd.DataFrame([{"rock": name} | asdict(one) for name, one in ROCKS.items()]),
    "sweeps": sweeps,
    "words": lambda: pd.DataFrame(WORDS.items(), columns=["word", "meaning"]),
}


class CodeTable(SphinxDirective):
    """`{code-table} NAME`: the table of that name; its first column is what one writes."""

    required_arguments = 1

    def run(self) -> list[nodes.Node]:
        table = TABLES[self.arguments[0]]()
        group = nodes.tgroup("", cols=len(table.columns))
        group += [nodes.colspec("", colwidth=1) for _ in table.columns]
        group += nodes.thead("", row([nodes.Text(str(column)) for column in table.columns]))
        literal = self.arguments[0] != "words"
        group += nodes.tbody("", *(row(cells(values, literal)) for values in table.itertuples(index=False)))
        return [nodes.table("", group, classes=["code-table"])]


def cells(values: Iterable[object], literal: bool) -> list[nodes.Node]:
    """The cells of a row, the first as what one writes."""
    texts = [f"{value:g}" if isinstance(value, float) else "" if value is None else str(value) for value in values]
    first = nodes.literal("", texts[0]) if literal else nodes.Text(texts[0])
    return [first, *(nodes.Text(text) for text in texts[1:])]


def row(inside: list[nodes.Node]) -> nodes.row:
    """A row of cells."""
    return nodes.row("", *(nodes.entry("", nodes.paragraph("", "", one)) for one in inside))
