"""The public names, as editors and type checkers read them; `__init__.py` imports each when it is first used."""

from vibrojax.accuracy import run_accuracy as run_accuracy
from vibrojax.errors import InputError as InputError
from vibrojax.input.plausible import UnusualValue as UnusualValue
from vibrojax.input.read import read_sweep as read_sweep
from vibrojax.laws import fit_friction as fit_friction
from vibrojax.laws import fit_joint as fit_joint
from vibrojax.laws import fit_rop as fit_rop
from vibrojax.laws import refit_frequency as refit_frequency
from vibrojax.measure import Gauge as Gauge
from vibrojax.physics import contact as contact
from vibrojax.physics import elementary as elementary
from vibrojax.physics import friction as friction
from vibrojax.physics import modes as modes
from vibrojax.physics import parameters as parameters
from vibrojax.physics.friction import FRICTION_LAWS as FRICTION_LAWS
from vibrojax.physics.friction import FrictionLaw as FrictionLaw
from vibrojax.plot import picture as picture
from vibrojax.plot import save_picture as save_picture
from vibrojax.reference import list_parameters as list_parameters
from vibrojax.reference import list_scenes as list_scenes
from vibrojax.reference import list_settings as list_settings
from vibrojax.reference import list_variables as list_variables
from vibrojax.reproduce import run_reproduction as run_reproduction
from vibrojax.reproduce import write_reproduction as write_reproduction
from vibrojax.scenes import SCENES as SCENES
from vibrojax.scenes import Driven as Driven
from vibrojax.scenes import Guard as Guard
from vibrojax.scenes import HasContact as HasContact
from vibrojax.scenes import HasFriction as HasFriction
from vibrojax.scenes import HasRock as HasRock
from vibrojax.scenes import Marker as Marker
from vibrojax.scenes import Mode as Mode
from vibrojax.scenes import Scene as Scene
from vibrojax.scenes import Section as Section
from vibrojax.scenes import State as State
from vibrojax.scenes import Swing as Swing
from vibrojax.sensitivity import derivatives as derivatives
from vibrojax.simulation import simulate as simulate
from vibrojax.stepping import Located as Located
from vibrojax.stepping import Smoothed as Smoothed
from vibrojax.stepping import Stepper as Stepper
from vibrojax.store.dataset import open_dataset as open_dataset
from vibrojax.store.dataset import write_dataset as write_dataset
from vibrojax.sweep import run_sweep as run_sweep

__version__: str
