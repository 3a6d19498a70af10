"""Writes a reproduction: a page that loads nothing from outside, a table in Markdown, and the datasets."""

import base64
import re
from dataclasses import dataclass
from importlib.resources import files
from io import BytesIO
from pathlib import Path

from jinja2 import Environment, PackageLoader, StrictUndefined
from markupsafe import Markup, escape
from matplotlib.figure import Figure

from vibrojax.errors import InputError
from vibrojax.io.content_policy import content_policy
from vibrojax.io.dataset import write_dataset
from vibrojax.io.provenance import source
from vibrojax.reproduce.findings import FINDINGS, READINGS, Finding
from vibrojax.reproduce.reproduction import Reproduction, Result
from vibrojax.reproduce.verdicts import DIFFERS, NOT_COMPARED, VERDICTS

COLUMNS = ("id", "what", "source", "here", "verdict", "reading")
CLASSES = dict(zip(VERDICTS, ("differs", "uncompared", "trend", "agrees"), strict=True))
"""Classes of the page's style sheet."""
_EXPLAINED = [name for finding in FINDINGS for name in finding.ids]


def write_reproduction(reproduction: Reproduction, folder: str | Path) -> None:
    """Write `index.html`, `table.md` and the datasets into `folder`, which is made if it is not there.

    **Raises:** `InputError` where the folder cannot be written.

    **Example:**

    >>> from pathlib import Path
    >>> from vibrojax.reproduce import GROUPS
    >>> vj.write_reproduction(vj.run_reproduction(GROUPS[:1], progress=False), "reproduction")
    >>> sorted(path.name for path in Path("reproduction").iterdir() if path.is_file())
    ['index.html', 'table.md']
    """
    folder = Path(folder)
    try:
        folder.mkdir(parents=True, exist_ok=True)
        (folder / "table.md").write_text(table(reproduction), encoding="utf-8")
        (folder / "index.html").write_text(page(reproduction), encoding="utf-8")
    except OSError as error:
        raise InputError(f"-o: {error.filename}: cannot be written ({error.strerror})") from None
    for name, dataset in reproduction.datasets.items():
        write_dataset(dataset, folder / f"{name}.nc")


def table(reproduction: Reproduction) -> str:
    """One line of Markdown per entry, in the order of the page."""
    lines = [f"| {' | '.join(COLUMNS)} |", "|" + "---|" * len(COLUMNS)]
    for result in reproduction.results:
        entry, here = result.entry, result.here
        cells = (entry.id, entry.what, entry.source, here.text, here.verdict, ", ".join(entry.readings))
        lines.append(f"| {' | '.join(_cell(text) for text in cells)} |")
    return "\n".join([*lines, ""])


def _cell(text: str) -> str:
    """A cell may hold no bar and no line break."""
    return " ".join(text.replace("|", "/").split())


@dataclass(frozen=True)
class _Explained:
    """A finding, and those of its results that differ in this run."""

    finding: Finding
    differing: tuple[str, ...]


def page(reproduction: Reproduction) -> str:
    """The page as HTML text, pictures within it."""
    environment = Environment(
        loader=PackageLoader("vibrojax.reproduce", ""),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
    )
    environment.filters |= {"code": _code, "picture": _picture}
    results = reproduction.results
    style = "\n" + files("vibrojax.reproduce").joinpath("page.css").read_text(encoding="utf-8")
    differing = sorted((one for one in results if one.here.verdict == DIFFERS), key=_weight)
    return environment.get_template("page.html.jinja").render(
        policy=Markup(content_policy([], [style])),
        style=Markup(style),
        reproduction=reproduction,
        verdicts=tuple(reversed(VERDICTS)),
        classes=CLASSES,
        explained=_explained([one.entry.id for one in differing]),
        differing=differing,
        not_compared=[one for one in results if one.here.verdict == NOT_COMPARED],
        cannot_be_compared=NOT_COMPARED,
        readings=READINGS,
        version=source(),
    )


def _code(text: str) -> Markup:
    """Text with what stands in backquotes as code."""
    return Markup(re.sub("`([^`]+)`", r"<code>\1</code>", str(escape(text))))


def _picture(figure: Figure) -> str:
    """The figure as a reference that holds it."""
    content = BytesIO()
    figure.savefig(content, format="png", dpi=120)
    return f"data:image/png;base64,{base64.b64encode(content.getvalue()).decode()}"


def _weight(result: Result) -> int:
    """Where a result stands among the findings, the weightiest first."""
    name = result.entry.id
    return _EXPLAINED.index(name) if name in _EXPLAINED else len(_EXPLAINED)


def _explained(differing: list[str]) -> list[_Explained]:
    """The findings with the results that differ; those of no finding come last."""
    rest = Finding("Not explained:", tuple(name for name in differing if name not in _EXPLAINED))
    explained = [
        _Explained(finding, tuple(name for name in finding.ids if name in differing)) for finding in (*FINDINGS, rest)
    ]
    return [one for one in explained if one.differing]
