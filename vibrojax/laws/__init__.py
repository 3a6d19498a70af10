"""Laws fitted to what was measured or swept."""

from vibrojax.laws._forms import FORMS as FORMS
from vibrojax.laws._frequency import refit_frequency as refit_frequency
from vibrojax.laws._friction import fit_friction as fit_friction
from vibrojax.laws._joint import fit_joint as fit_joint
from vibrojax.laws._results import table as table
from vibrojax.laws._results import verdict as verdict
from vibrojax.laws._rop import fit_rop as fit_rop
from vibrojax.laws._uncertainty import REASONS as REASONS
