"""Output of a reproduction: a self-contained HTML page, a Markdown table, and the datasets."""

import base64
import re
from io import BytesIO
from pathlib import Path

from jinja2 import Environment, FileSystemLoader, StrictUndefined
from markupsafe import Markup, escape
from matplotlib.figure import Figure

from source.reproduction import FINDINGS, READINGS, Finding, Reproduction
from source.rules import DIFFERS, NOT_COMPARED, VERDICTS
from vibrojax.errors import InputError
from vibrojax.explorer.write import content_policy
from vibrojax.io.atomic import atomic_write
from vibrojax.io.files import source
from vibrojax.io.identity import text_mark
from vibrojax.io.writers import write_dataset

FOLDER = Path(__file__).parent
COLUMNS = ("id", "what", "source", "here", "verdict", "reading")
CLASSES = dict(zip(VERDICTS, ("differs", "uncompared", "trend", "agrees"), strict=True))
"""CSS class of each outcome of a comparison."""


def write_reproduction(reproduction: Reproduction, folder: str | Path) -> None:
    """Write `index.html`, `table.md` and the datasets into `folder`, which is created if necessary.

    **Raises:** `InputError` if the folder cannot be written, or holds a file of such a name that this package has not
    written.
    """
    folder = Path(folder)
    try:
        folder.mkdir(parents=True, exist_ok=True)
        for name, text in (
            ("table.md", markdown_table(reproduction) + text_mark()),
            ("index.html", html_page(reproduction)),
        ):
            with atomic_write(folder / name) as part:
                part.write_text(text, encoding="utf-8")
    except OSError as error:
        raise InputError(f"-o: {error.filename}: cannot be written ({error.strerror})") from None
    for name, dataset in reproduction.datasets.items():
        write_dataset(dataset, folder / f"{name}.nc")


def markdown_table(reproduction: Reproduction) -> str:
    """Return a Markdown table with one row per result, in the order of the HTML page."""
    lines = [f"| {' | '.join(COLUMNS)} |", "|" + "---|" * len(COLUMNS)]
    for result in reproduction.results:
        entry, here = result.entry, result.here
        cells = (entry.id, entry.what, entry.source, here.text, here.verdict, ", ".join(entry.readings))
        lines.append(f"| {' | '.join(' '.join(cell.replace('|', '/').split()) for cell in cells)} |")
    return "\n".join([*lines, ""])


def html_page(reproduction: Reproduction) -> str:
    """Return the page as an HTML string with embedded pictures."""
    environment = Environment(loader=FileSystemLoader(FOLDER), autoescape=True, undefined=StrictUndefined)
    environment.trim_blocks = environment.lstrip_blocks = environment.keep_trailing_newline = True
    environment.filters |= {"code": _code, "picture": _picture}
    style = "\n" + (FOLDER / "page.css").read_text(encoding="utf-8")
    differing = {result.entry.id: result for result in reproduction.results if result.here.verdict == DIFFERS}
    explained = {name for finding in FINDINGS for name in finding.ids}
    rest = Finding("Not explained:", tuple(name for name in differing if name not in explained))
    ids = {finding.text: [name for name in finding.ids if name in differing] for finding in (*FINDINGS, rest)}
    return environment.get_template("page.html.jinja").render(
        policy=Markup(content_policy([], [style])),
        style=Markup(style),
        reproduction=reproduction,
        verdicts=tuple(reversed(VERDICTS)),
        classes=CLASSES,
        explanations=[(text, names) for text, names in ids.items() if names],
        differing=[differing[name] for names in ids.values() for name in names],
        not_compared=[result for result in reproduction.results if result.here.verdict == NOT_COMPARED],
        cannot_be_compared=NOT_COMPARED,
        readings=READINGS,
        version=source(),
    )


def _code(text: str) -> Markup:
    """Return the text escaped for HTML, with backquoted parts as code elements."""
    return Markup(re.sub("`([^`]+)`", r"<code>\1</code>", str(escape(text))))


def _picture(figure: Figure) -> str:
    content = BytesIO()
    figure.savefig(content, format="png", dpi=120)
    return f"data:image/png;base64,{base64.b64encode(content.getvalue()).decode()}"
