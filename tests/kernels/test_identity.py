"""Tests of the identity of a trace: equal traces have one digest, and other traces have another one or none.

Digests are those of processes without the checks of types, which wrap every function of the package.
"""

import json
import os
import subprocess
import sys
from pathlib import Path

import identities

FOLDERS = [str(Path(__file__).parent), str(Path(__file__).parents[2])]


def printed(names, cache, seed="0"):
    """Return the results of functions of `identities`, in this order, in a process of their own."""
    code = f"import json, identities; print(json.dumps([getattr(identities, name)() for name in {names!r}]))"
    more = {"VIBROJAX_CACHE": str(cache), "PYTHONHASHSEED": seed, "PYTHONPATH": os.pathsep.join(FOLDERS)}
    command = [sys.executable, "-c", code]
    completed = subprocess.run(command, capture_output=True, text=True, env=os.environ | more)
    assert completed.returncode == 0, completed.stderr
    return json.loads(completed.stdout)


def test_digests(tmp_path):
    """Equal objects have one digest, whatever changes a trace changes it, and what is uncertain has none.

    A second process, in which sets and hashes have another order, finds every kernel of the first.
    """
    digests = ["of_equal", "of_different", "of_uncertain", "of_patched"]
    [kernels, found], equal, different, uncertain, (before, after) = printed(["traced", *digests], tmp_path, seed="1")
    assert all(first == second is not None for first, second in equal)
    assert None not in different and len(set(different)) == len(different)
    assert uncertain == dict.fromkeys(identities.UNCERTAIN)
    assert before is not None and after is None  # a method of the class is replaced in between
    assert kernels > 3 and found == 0
    assert printed(["traced"], tmp_path, seed="2") == [[kernels, kernels]]
