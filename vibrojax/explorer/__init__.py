"""An interactive page of a dataset: one JavaScript module behind an HTML file, a live server and a notebook widget.

(The public function is `vibrojax.explore`; a package of that name would hide it.)

`mount(element, {data, source, state, onPick, onState})` of `page/mount.js` shows a dataset in an element of a page.
`data` is its *document* (below), and `source` returns the cells of motions. A page has its own `embeddedSource`; a
server or a widget sends `encode([cell])`. `state` is the fragment of an address,
`variable=regime&x=gamma&y=beta&at.beta=0.4&...`.

**The document:**

    {"format": 1, "kind": "grid" | "family" | "motion",
     "title", "scene", "source", "notes": [text, ...],
     "axes": [{"name", "label", "symbol", "units" and "factor" (shown = value * factor), "numeric", "log",
               "values": [...], "columns": [the same, along a list of points or starts]}],
     "variables": [{"name", "label", "long_name", "units", "factor", "axes": [names], "flags": {flag: meaning} | null,
                    "colours": {flag: colour} | null, "map": a name in `maps` | null, "low", "high" (shown), "log",
                    "extend", "nothing_at_zero", "whole", "data": a packed array, see `encoding.pack`}],
     "maps": {name: 256 colours},
     "lanes": a packed array with its "axes": the number of the lane of each cell | null,
     "fixed": {coordinates without an axis},
     "region": {axis: [low, high]}: the source's, SI,
     "run": the parts of a cell's command line, see `document.run_document`: {"own_scene": true}, or
            {"own_scene": false, "scene", "parameters": {name: value}, "options", "start": word, vector or null,
             "duration", and the allowed words: "names" of parameters, "starts", "states" of a vector, "rocks"} | null,
     "curves": {"colours": {kind: colour}, "list": [{"kind", "at": {axis: value}, "points": {axis: values}}]} | null,
     "family": {"runs", "special", ...} only of families,
     "cells": {"size", "blocks"} of the cells in the page | null,
     "without": the reason why there are no motions}

`encoding` describes the form of a cell.
"""

from vibrojax.explorer.encoding import Cell as Cell
from vibrojax.explorer.encoding import encode as encode
from vibrojax.explorer.trajectory_view import cell_of as cell_of
from vibrojax.explorer.views import cells_of as cells_of
from vibrojax.explorer.views import document_of as document_of
from vibrojax.explorer.write import module_text as module_text
from vibrojax.explorer.write import page_text as page_text
from vibrojax.explorer.write import style_text as style_text
from vibrojax.explorer.write import write_page as write_page
