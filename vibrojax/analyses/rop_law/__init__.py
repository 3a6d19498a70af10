"""Laws fitted to what was measured or swept."""

from vibrojax.analyses.rop_law.forms import FORMS as FORMS
from vibrojax.analyses.rop_law.frequency import refit_frequency as refit_frequency
from vibrojax.analyses.rop_law.friction import fit_friction as fit_friction
from vibrojax.analyses.rop_law.joint import fit_joint as fit_joint
from vibrojax.analyses.rop_law.results import table as table
from vibrojax.analyses.rop_law.results import verdict as verdict
from vibrojax.analyses.rop_law.rop import fit_rop as fit_rop
from vibrojax.analyses.rop_law.uncertainty import REASONS as REASONS
