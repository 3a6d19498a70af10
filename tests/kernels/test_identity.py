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


def printed(name, cache, seed="0"):
    """Return the result of a function of `identities` in a process of its own."""
    code = f"import json, identities; print(json.dumps(identities.{name}()))"
    more = {"VIBROJAX_CACHE": str(cache), "PYTHONHASHSEED": seed, "PYTHONPATH": os.pathsep.join(FOLDERS)}
    command = [sys.executable, "-c", code]
    completed = subprocess.run(command, capture_output=True, text=True, env=os.environ | more)
    assert completed.returncode == 0, completed.stderr
    return json.loads(completed.stdout)


def test_equal_objects_have_one_digest(tmp_path):
    for first, second in printed("of_equal", tmp_path):
        assert first == second is not None


def test_whatever_changes_a_trace_changes_the_digest(tmp_path):
    different = printed("of_different", tmp_path)
    assert None not in different and len(set(different)) == len(different)


def test_what_is_uncertain_has_no_digest(tmp_path):
    assert printed("of_uncertain", tmp_path) == dict.fromkeys(identities.UNCERTAIN)


def test_replaced_methods_have_no_digest(tmp_path):
    before, after = printed("of_patched", tmp_path)
    assert before is not None and after is None


def test_one_digest_means_one_trace(tmp_path):
    """The second process, in which sets and hashes have another order, finds every kernel of the first."""
    kernels, found = printed("traced", tmp_path, seed="1")
    assert kernels > 10 and found == 0
    assert printed("traced", tmp_path, seed="2") == [kernels, kernels]
