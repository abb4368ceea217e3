__all__: list[str]

from .controllers.control import Controller as Controller
from .controllers.control import attitude as attitude
from .controllers.control import attitude_rate as attitude_rate
from .controllers.control import driven as driven
from .controllers.control import pwm as pwm
from .controllers.interface import ControlInterface as ControlInterface
from .environment import Environment as Environment
from .environment import observation as observation
from .environment import reset as reset
from .physics.sensors import Measurement as Measurement
from .randomization import randomize as randomize
from .randomization import relative_box as relative_box
from .randomization import wide_box as wide_box
from .realities.reality import Reality as Reality
from .realities.reality import Truth as Truth
from .realities.virtual_drone import VirtualDrone as VirtualDrone
from .rollouts import rollout as rollout
from .stepping import step as step
from .tasks.look_ahead import LookAhead as LookAhead
from .tasks.tasks import Task as Task
from .tasks.tasks import circle as circle
from .tasks.tasks import figure_eight as figure_eight
from .tasks.tasks import hover as hover
from .tasks.tasks import paper_circle as paper_circle
from .tasks.tasks import take_off as take_off
from .tasks.tasks import tracking as tracking
