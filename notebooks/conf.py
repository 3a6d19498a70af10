"""Configuration of the site: `sphinx-build -W --keep-going -n notebooks build/site`.

Pages are Markdown and notebooks, executed while it is built; what they gave is kept by the package's fingerprint, so
that a second build takes seconds. Nothing is fetched: equations are MathML, other sites' inventories are not asked for.
"""

import os
import sys
from pathlib import Path

HERE = Path(__file__).parent
sys.path.insert(0, str(HERE / "_site"))

from fingerprint import fingerprint  # noqa: E402

import vibrojax  # noqa: E402

os.environ.setdefault("MPLBACKEND", "agg")
# Two notebooks at once leave no core for threads of linear algebra, which wait for one another in a busy loop.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

project = "vibrojax"
author = "The vibrojax authors"
copyright = f"2026, {author}"
version = release = vibrojax.__version__

extensions = [
    "myst_nb",
    "sphinx.ext.autodoc",
    "sphinx_copybutton",
    "equations",
    "docstrings",
    "commands",
    "tables",
    "live_page",
    "terms",
]
exclude_patterns = ["_site", ".ipynb_checkpoints"]
nitpicky = True
suppress_warnings = ["myst-nb.lexer"]  # of pages that are not executed, with -D nb_execution_mode=off
smartquotes = False  # x' is a derivative

# What is executed
nb_execution_mode = "cache"
nb_execution_cache_path = str(HERE.parent / "build" / "executed" / fingerprint())
nb_execution_raise_on_error = True
nb_execution_timeout = 1800  # s; a notebook takes one to two minutes, but up to ten where other programs use the cores
nb_merge_streams = True
nb_ipywidgets_js: dict[str, dict[str, str]] = {}

# Markdown
myst_enable_extensions = ["dollarmath", "amsmath", "deflist", "colon_fence", "attrs_inline", "attrs_block"]
myst_heading_anchors = 3
myst_dmath_double_inline = True

# Docstrings
autodoc_member_order = "bysource"
autodoc_typehints = "none"
autodoc_preserve_defaults = True
autodoc_default_options = {"members": True}
default_role = "code"
add_module_names = False
nitpick_ignore_regex = [
    ("py:.*", r"(?!vibrojax\.).*"),
    (
        "py:.*",
        r"vibrojax\.(physics\.arrays|maps\.(executor|slurm)|lanes\.inputs|systems\.numbers|stepping\.series)\..*|.*\.[A-Z]",
    ),
]
"""Types in signatures: those of others, whose sites are not asked, and aliases and type variables."""

# Pages
html_theme = "furo"
html_title = f"vibrojax {release}"
html_static_path = ["_site/static"]
html_css_files = ["site.css"]
html_show_sphinx = False
pygments_dark_style = "github-dark"
html_math_renderer = "mathml"
copybutton_prompt_text = r">>> |\.\.\. |\$ "
copybutton_prompt_is_regexp = True
