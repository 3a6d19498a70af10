"""The content security policy of a page: the scripts, styles and connections that its browser allows."""

import base64
from collections.abc import Sequence
from hashlib import sha256


def content_policy(scripts: Sequence[str], styles: Sequence[str], asks: bool = False) -> str:
    """Return the policy of a page that holds these scripts and style sheets, and nothing else.

    **Arguments:** `scripts`, `styles`: the text between the tags of each element; `asks`: whether the page may send
    requests to its own server.
    """
    rules = {
        "default-src": "'none'",
        "script-src": _hashes(scripts),
        "style-src": _hashes(styles),
        "img-src": "data:",  # an empty icon, so that the browser requests none; pictures within the page
        "connect-src": "'self'" if asks else "'none'",
        "base-uri": "'none'",
        "form-action": "'none'",
    }
    return "; ".join(f"{name} {sources}" for name, sources in rules.items())


def _hashes(texts: Sequence[str]) -> str:
    digests = (base64.b64encode(sha256(text.encode()).digest()).decode() for text in dict.fromkeys(texts))
    return " ".join(f"'sha256-{digest}'" for digest in digests) or "'none'"
