"""Find dead links in a folder of HTML pages, and resources from other sites: `python .ci/links.py build/site`."""

import sys
from html.parser import HTMLParser
from pathlib import Path
from urllib.parse import unquote, urlsplit

LOADS = {("script", "src"), ("link", "href"), ("img", "src"), ("iframe", "src"), ("source", "src"), ("object", "data")}
"""Attributes by which a page loads something by itself. Links are followed only on a click."""


class Page(HTMLParser):
    """Parser that collects the targets, the links and the loaded resources of a page."""

    def __init__(self, text: str):
        super().__init__()
        self.targets: set[str] = {"", "top"}
        self.links: list[str] = []
        self.loads: list[str] = []
        self.feed(text)

    def handle_starttag(self, tag, attrs):
        for name, value in attrs:
            if name == "id" or (tag == "a" and name == "name"):
                self.targets.add(value)
            elif value and (tag, name) in LOADS:
                self.loads.append(value)
                self.links.append(value)
            elif value and tag in ("a", "area") and name == "href":
                self.links.append(value)


def faults(folder: Path) -> list[str]:
    """Return a line per fault: a link without a target, or a resource from another site."""
    pages = {path.resolve(): Page(path.read_text(encoding="utf-8")) for path in sorted(folder.rglob("*.html"))}
    messages = [] if pages else [f"{folder}: no pages"]
    for path, page in pages.items():
        name = path.relative_to(folder.resolve())
        messages += [f"{name}: loads {resource} from elsewhere" for resource in page.loads if urlsplit(resource).netloc]
        for link in dict.fromkeys(page.links):
            parts = urlsplit(link)
            if parts.scheme or parts.netloc:
                continue
            target = (path.parent / unquote(parts.path)).resolve() if parts.path else path
            if not target.is_file():
                messages.append(f"{name}: {link} is not there")
            elif target in pages and unquote(parts.fragment) not in pages[target].targets:
                messages.append(f"{name}: {link} has no such place")
    return messages


if __name__ == "__main__":
    dead = faults(Path(sys.argv[1]))
    print("\n".join(dead) or "no dead link, nothing loaded from elsewhere")
    sys.exit(bool(dead))
