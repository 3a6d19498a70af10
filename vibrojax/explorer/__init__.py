"""An interactive page of a dataset: one JavaScript module behind an HTML file, a live server and a notebook widget.

(The public function is `vibrojax.explore`; a package of that name would hide it.)

`mount(element, {data, source, state, onPick, onState})` of `page/mount.js` shows a dataset in an HTML element. `data`
is the *document* of the dataset, a JSON object (below). `source` returns motions, each encoded as a `Cell`, the data
that the page shows for one map cell, see `encoding`. `state` is the fragment of the page's address,
`variable=regime&x=gamma&y=beta&at.beta=0.4&...`.

**The JSON document** (keys without contents may be missing):

    {"format": 1, "kind": "grid" | "family" | "motion" | "plots",
     "title", "scene", "source", "notes": [text, ...], "common": values that are the same everywhere,
     "axes": [{"name", "label", "symbol", "units" and "factor" (shown = value * factor), "numeric", "log",
               "values": [...], "columns": [the same, along a list of points or initial conditions]}],
     "variables": see `document.variable_document`; "data" is a packed array, see `encoding.pack`,
     "maps": {name: 256 colours},
     "lanes": a packed array with its "axes": the number of the lane of each map cell,
     "fixed": {coordinates without an axis}, "region": {axis: [low, high]} of the source's best performance, SI,
     "run": the parts of the command that simulates a lane, see `document.run_document`,
     "curves": {"of": "borders" | "curves", "colours": {kind: colour},
                "list": [{"kind", "at": {axis: value}, "points": {axis: values}}],
                "corners": [{"kind", "at": {axis: value}, "point": {axis: value}}] of codimension two},
     "family": {"runs", "special", ...} only of families,
     "figure": plots of the analysis, see `plots_view`; "map": False if they stand in place of the map,
     "overlay": {"variable", "along", "items"}: what lies over a diagram of returns,
     "summary": [{"name", "lines"}], "meanings": {regime or kind of border: sentence}, "machine": {parameter: value},
     "view": directions of the first view, "first": {axis: index} of the cell shown first,
     "cells": {"size", "blocks"} of the motions stored in the page; "without": the reason why there are none}
"""

from vibrojax.explorer.encoding import Cell as Cell
from vibrojax.explorer.encoding import encode as encode
from vibrojax.explorer.recording import cell_of as cell_of
from vibrojax.explorer.views import contents_of as contents_of
from vibrojax.explorer.write import module_text as module_text
from vibrojax.explorer.write import page_text as page_text
from vibrojax.explorer.write import write_page as write_page
