"""Dead links of a folder of HTML pages, and what they load from elsewhere: `python tests/links.py build/site`."""

import sys
from html.parser import HTMLParser
from pathlib import Path
from urllib.parse import unquote, urlsplit

LOADS = {("script", "src"), ("link", "href"), ("img", "src"), ("iframe", "src"), ("source", "src"), ("object", "data")}
"""Attributes by which a page loads something by itself; links are only followed by who clicks them."""


class Page(HTMLParser):
    """The targets on a page, the links from it, and what it loads."""

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
    """What is wrong, a line each: links to files and places that are not there, and what is loaded from elsewhere."""
    pages = {path.resolve(): Page(path.read_text(encoding="utf-8")) for path in sorted(folder.rglob("*.html"))}
    found = [] if pages else [f"{folder}: no pages"]
    for path, page in pages.items():
        told = path.relative_to(folder.resolve())
        found += [f"{told}: loads {one} from elsewhere" for one in page.loads if urlsplit(one).netloc]
        for link in dict.fromkeys(page.links):
            parts = urlsplit(link)
            if parts.scheme or parts.netloc:
                continue
            target = (path.parent / unquote(parts.path)).resolve() if parts.path else path
            if not target.is_file():
                found.append(f"{told}: {link} is not there")
            elif target in pages and unquote(parts.fragment) not in pages[target].targets:
                found.append(f"{told}: {link} has no such place")
    return found


if __name__ == "__main__":
    dead = faults(Path(sys.argv[1]))
    print("\n".join(dead) or "no dead link, nothing loaded from elsewhere")
    sys.exit(bool(dead))
