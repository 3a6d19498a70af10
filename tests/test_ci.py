"""Tests of what CI runs: actions pinned by commit, versions of dependencies, and the commands of the README."""

import re
import subprocess
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]


def test_actions_are_pinned_by_commit():
    texts = [path.read_text() for path in (ROOT / ".github/workflows").glob("*.yml")]
    used = [action for text in texts for action in re.findall(r"uses: (\S+)", text)]
    assert len(texts) == 2 and used and all(re.fullmatch(r"[\w/-]+@[0-9a-f]{40}", action) for action in used)


@pytest.mark.parametrize("changed", ["bin/pytest", "bin/sphinx-build"])
def test_other_commands_in_the_readme_are_not_run(changed, tmp_path):
    """The script stops before it installs anything, or for the site, before it runs the command."""
    script = (ROOT / ".ci/run").read_text()
    checks = re.findall(r"^(?:test_command=|site_command=|expect ).*$", script, re.M)
    [define] = re.findall(r"^expect\(\) \{\n.*?\n\}$", script, re.M | re.S)
    for readme, passes in (((ROOT / "README.md").read_text(), True), ("", False)):
        text = readme or (ROOT / "README.md").read_text().replace(changed, f"{changed} --curl")
        (tmp_path / "README.md").write_text(text)
        words = ["bash", "-euo", "pipefail", "-c", "\n".join([define, *checks, "echo passed"])]
        done = subprocess.run(words, cwd=tmp_path, capture_output=True, text=True)
        assert ("passed" in done.stdout) == passes and ("has another command" in done.stderr) == (not passes)
