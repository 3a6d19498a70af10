"""The source, reproduced: its tables and figures beside what is computed here."""

from vibrojax.reproduce._entry import VERDICTS as VERDICTS
from vibrojax.reproduce._entry import Entry as Entry
from vibrojax.reproduce._entry import Here as Here
from vibrojax.reproduce._registry import GROUPS as GROUPS
from vibrojax.reproduce._registry import Group as Group
from vibrojax.reproduce._run import Reproduction as Reproduction
from vibrojax.reproduce._run import Result as Result
from vibrojax.reproduce._run import run_reproduction as run_reproduction
from vibrojax.reproduce._write import write_reproduction as write_reproduction
