"""Reproduction of the source: comparison of its tables and figures with computed values."""

from vibrojax.reproduce.page import write_reproduction as write_reproduction
from vibrojax.reproduce.reproduction import GROUPS as GROUPS
from vibrojax.reproduce.reproduction import Entry as Entry
from vibrojax.reproduce.reproduction import Group as Group
from vibrojax.reproduce.reproduction import Reproduction as Reproduction
from vibrojax.reproduce.reproduction import Result as Result
from vibrojax.reproduce.reproduction import run_reproduction as run_reproduction
from vibrojax.reproduce.rules import VERDICTS as VERDICTS
from vibrojax.reproduce.rules import Here as Here
