"""Laws fitted to rig measurements and to the results of sweeps."""

from vibrojax.analyses.rop_law.frequency import refit_frequency as refit_frequency
from vibrojax.analyses.rop_law.friction import fit_friction as fit_friction
from vibrojax.analyses.rop_law.joint import fit_joint as fit_joint
from vibrojax.analyses.rop_law.least_squares import REASONS as REASONS
from vibrojax.analyses.rop_law.results import law_facts as law_facts
from vibrojax.analyses.rop_law.results import law_table as law_table
from vibrojax.analyses.rop_law.results import verdict as verdict
from vibrojax.analyses.rop_law.rop import FORMS as FORMS
from vibrojax.analyses.rop_law.rop import fit_rop as fit_rop
