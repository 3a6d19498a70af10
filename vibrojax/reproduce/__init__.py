"""The source, reproduced: its tables and figures beside what is computed here."""

from vibrojax.reproduce.entry import Entry as Entry
from vibrojax.reproduce.entry import Group as Group
from vibrojax.reproduce.groups import GROUPS as GROUPS
from vibrojax.reproduce.page import write_reproduction as write_reproduction
from vibrojax.reproduce.reproduction import Reproduction as Reproduction
from vibrojax.reproduce.reproduction import Result as Result
from vibrojax.reproduce.reproduction import run_reproduction as run_reproduction
from vibrojax.reproduce.verdicts import VERDICTS as VERDICTS
from vibrojax.reproduce.verdicts import Here as Here
