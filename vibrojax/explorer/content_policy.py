"""The content security policy of an HTML page: the scripts, styles and connections that the browser allows."""

import base64
from collections.abc import Sequence
from hashlib import sha256


def content_policy(scripts: Sequence[str], styles: Sequence[str], asks: bool = False) -> str:
    """Return the policy of a page that may use only these scripts and style sheets.

    **Arguments:** `scripts`, `styles`: the content of each element, between its tags; `asks`: whether the page may send
    requests to its own server.
    """
    rules = {
        "default-src": "'none'",
        "script-src": _hashes(scripts),
        "style-src": _hashes(styles),
        "img-src": "data:",  # pictures embedded in the page, and an empty icon, so that the browser requests none
        "connect-src": "'self'" if asks else "'none'",
        "base-uri": "'none'",
        "form-action": "'none'",
    }
    return "; ".join(f"{name} {sources}" for name, sources in rules.items())


def _hashes(texts: Sequence[str]) -> str:
    digests = (base64.b64encode(sha256(text.encode()).digest()).decode() for text in dict.fromkeys(texts))
    return " ".join(f"'sha256-{digest}'" for digest in digests) or "'none'"
