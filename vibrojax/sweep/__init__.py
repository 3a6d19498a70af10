"""Sweeps: from a sweep file to a labelled dataset."""

from vibrojax.sweep._accuracy import LOCATED_STRIDE as LOCATED_STRIDE
from vibrojax.sweep._accuracy import Accuracy as Accuracy
from vibrojax.sweep._accuracy import accuracy_for as accuracy_for
from vibrojax.sweep._chunks import Chunks as Chunks
from vibrojax.sweep._numbers import quantity as quantity
from vibrojax.sweep._parallel import in_parallel as in_parallel
from vibrojax.sweep._point import read_point as read_point
from vibrojax.sweep._read import read_sweep as read_sweep
from vibrojax.sweep._run import estimate as estimate
from vibrojax.sweep._run import run_sweep as run_sweep
from vibrojax.sweep._run import run_to_file as run_to_file
from vibrojax.sweep._settings import RunSettings as RunSettings
from vibrojax.sweep._size import check_size as check_size
from vibrojax.sweep._size import memory as memory
from vibrojax.sweep._stiff import unresolved as unresolved
from vibrojax.sweep._sweep import Sweep as Sweep
