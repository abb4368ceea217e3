__all__: list[str]

from .control import attitude as attitude
from .control import attitude_rate as attitude_rate
from .control import pwm as pwm
from .environment import Environment as Environment
from .environment import reset as reset
from .look_ahead import LookAhead as LookAhead
from .randomization import randomize as randomize
from .randomization import relative_box as relative_box
from .randomization import wide_box as wide_box
from .reality import Reality as Reality
from .rollouts import rollout as rollout
from .stepping import step as step
from .tasks import circle as circle
from .tasks import figure_eight as figure_eight
from .tasks import hover as hover
from .tasks import take_off as take_off
from .tasks import tracking as tracking
from .virtual_drone import VirtualDrone as VirtualDrone
