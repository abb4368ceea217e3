"""What users name and the core does not import: log formats, realities, exporters and others.

A name stands for a text, MODULE:ATTRIBUTE, which is imported when it is used. An installed package
adds names by entry points in the group of a registry (docs/extending.md).
"""

import sys
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any

from maidenflight.errors import InputError

if TYPE_CHECKING:
    from importlib.metadata import EntryPoints


@dataclass(frozen=True, eq=False)
class Registry:
    """Parts of one kind by name."""

    kind: str
    """What one is called, for errors."""
    group: str
    """Of the entry points by which installed packages add some."""
    own: dict[str, Any]
    """Ours by name: MODULE:ATTRIBUTE, or the part itself. No package replaces one."""

    def __iter__(self) -> Iterator[str]:
        """Gives the names: ours, then, once these are through, those of installed packages."""
        yield from self.own
        yield from sorted(_installed(self.group).names - self.own.keys())

    def __contains__(self, name: object) -> bool:
        """Returns whether a name is known; installed packages are searched where it is not ours."""
        return name in self.own or name in _installed(self.group).names

    def __getitem__(self, name: str) -> Any:
        """Imports what a name stands for.

        Raises:
            InputError: no such name, two packages have it, or its package is damaged.
        """
        if name in self.own:
            part = self.own[name]
            if not isinstance(part, str):
                return part
            module, _, attribute = part.partition(":")
            return getattr(import_module(module), attribute)
        entries = list(_installed(self.group).select(name=name))
        packages = sorted({entry.dist.name for entry in entries if entry.dist is not None})
        if not entries:
            raise InputError(f"{name!r}: no such {self.kind}. Expected one of {', '.join(self)}.")
        if len(entries) > 1:
            raise InputError(
                f"{self.kind} {name!r}: of several packages, {', '.join(packages)}. Uninstall all "
                "but one."
            )
        (entry,), (package,) = entries, packages
        try:
            return entry.load()
        except Exception as error:  # whatever a module of others raises
            raise InputError(
                f"{self.kind} {name!r}: {entry.value} of the package {package} cannot be imported "
                f"({type(error).__name__}: {error}). Mend or uninstall {package}."
            ) from error


def import_part(name: str, kind: str) -> Any:
    """Imports `MODULE:NAME`, from an installed module or one in the working folder.

    Args:
        name: as above.
        kind: what it is to be, for errors.

    Raises:
        InputError: there is no such module, or nothing of that name in it.
    """
    module, _, attribute = name.partition(":")
    # The folder of a script is on the path; that of a command is not.
    if str(Path.cwd()) not in sys.path:
        sys.path.insert(0, str(Path.cwd()))
    try:
        imported = import_module(module)
    except (ImportError, TypeError, ValueError) as error:
        raise InputError(
            f"{name}: cannot be imported ({error}). Expected MODULE:NAME of a {kind}, in a Python "
            f"module that is installed or lies in {Path.cwd()}."
        ) from error
    if not hasattr(imported, attribute):
        raise InputError(
            f"{name}: {module} has no {kind} {attribute!r}. It has "
            f"{', '.join(member for member in vars(imported) if not member.startswith('_'))}."
        )
    return getattr(imported, attribute)


def _installed(group: str) -> "EntryPoints":
    return _installed_on(group, tuple(sys.path))


@cache
def _installed_on(group: str, path: tuple[str, ...]) -> "EntryPoints":
    from importlib.metadata import entry_points

    try:
        return entry_points(group=group)
    except Exception as error:  # whatever parsing what others wrote raises
        raise InputError(
            f"the entry points of an installed package cannot be read ({type(error).__name__}: "
            f"{error}), so neither can those of {group}. Mend or uninstall it; pip check may tell "
            "which."
        ) from error


_RING = "maidenflight.integrations"

VERBS = Registry(
    "verb",
    "maidenflight.verbs",
    {
        "log": "maidenflight.verbs.log:Log",
        "plan": "maidenflight.verbs.plan:Plan",
        "record": "maidenflight.verbs.record:Record",
        "fly": f"{_RING}.radio.fly:Fly",
        "drone": "maidenflight.verbs.drone:Drone",
        "identify": "maidenflight.verbs.identify:Identify",
        "match": "maidenflight.verbs.match:Match",
        "validate": "maidenflight.verbs.validate:Validate",
        "train": "maidenflight.verbs.train:Train",
        "transfer": "maidenflight.verbs.transfer:Transfer",
        "predict": "maidenflight.verbs.predict:Predict",
        "envelope": "maidenflight.verbs.envelope:Envelope",
        "sweep": "maidenflight.verbs.sweep:Sweep",
        "export": "maidenflight.verbs.export:Export",
        "report": "maidenflight.verbs.report:Report",
        "app": f"{_RING}.app.app:App",
        "demo": "maidenflight.verbs.demo:Demo",
        "doctor": "maidenflight.verbs.doctor:Doctor",
    },
)
"""Each a `verb.Verb`, in the order of the flow."""

LOG_FORMATS = Registry(
    "log format",
    "maidenflight.log_formats",
    {
        "maidenflight": "maidenflight.flights.formats:OWN",
        "gronauer": f"{_RING}.logs.authors:FORMAT",
        "nanobench": f"{_RING}.logs.nanobench:FORMAT",
        "crazyflie": f"{_RING}.logs.cflib:FORMAT",
        "crazyflie-card": f"{_RING}.logs.usddeck:FORMAT",
        "crazyflie-card-2019": f"{_RING}.logs.usddeck:FORMAT_2019",
        "px4": f"{_RING}.logs.ulog:FORMAT",
        "ardupilot": f"{_RING}.logs.dataflash:FORMAT",
        "ardupilot_text": f"{_RING}.logs.dataflash:TEXT",
        "betaflight": f"{_RING}.logs.blackbox:FORMAT",
        "mcap": f"{_RING}.logs.rosbag:MCAP",
        "rosbag2": f"{_RING}.logs.rosbag:SQLITE",
    },
)
"""Each a `flights.formats.LogFormat`; the first that knows a file reads it."""
REALITIES = Registry(
    "reality",
    "maidenflight.realities",
    {
        "pybullet": f"{_RING}.simulators.bullet:named_drone",
        "l2f": f"{_RING}.simulators.l2f:L2F",
        "crazyflow": f"{_RING}.simulators.crazyflow:Crazyflow",
        "mujoco": f"{_RING}.simulators.mujoco:MuJoCo",
    },
)
"""Each makes a `realities.reality.Reality`, or a virtual drone, of the text behind `NAME:`."""
POLICIES = Registry(
    "policy by others",
    "maidenflight.policies",
    {
        "raptor": f"{_RING}.raptor.foundation_policy:Raptor",
        "pid": f"{_RING}.policies.firmware:FirmwareController",
        "mellinger": f"{_RING}.policies.firmware:FirmwareController",
        ".zip": f"{_RING}.policies.environment_policy:EnvironmentPolicy",
    },
)
"""Each makes a `ForeignPolicy` of a name, all of it, or of a file with such an ending."""
POLICY_FORMATS = Registry(
    "format of policy files",
    "maidenflight.policy_formats",
    {"gronauer": f"{_RING}.policies.authors_policy:FORMAT"},
)
"""Each a `policy_file.PolicyFormat`, beside our own."""
POLICY_FORMS = Registry(
    "form of policies",
    "maidenflight.policy_forms",
    {"raptor": f"{_RING}.raptor.form:FORM", "px4": f"{_RING}.px4_network.form:FORM"},
)
"""Each a `simulator.policy_spec.PolicyForm`, beside `INSTANTS`."""
EXPORTERS = Registry(
    "exporter",
    "maidenflight.exporters",
    {
        "c": "maidenflight.deployment.c:export_c",
        "onnx": f"{_RING}.exporters.onnx:export_onnx",
        "authors": f"{_RING}.exporters.authors_json:export_authors_json",
        "crazyflie": f"{_RING}.exporters.crazyflie_app:export_crazyflie",
        "raptor": f"{_RING}.raptor.export:export_raptor",
        "px4": f"{_RING}.px4_network.export:export_px4",
    },
)
"""Each writes a policy to a folder; see `deployment.export`."""
DRONE_FORMATS = Registry(
    "format of drones",
    "maidenflight.drone_formats",
    {
        "mjcf": f"{_RING}.drones.mjcf:FORMAT",
        "urdf": f"{_RING}.drones.urdf:FORMAT",
        "sdf": f"{_RING}.drones.sdf:FORMAT",
        "rotorpy": f"{_RING}.drones.rotorpy:FORMAT",
        "crazyflow": f"{_RING}.drones.crazyflow:FORMAT",
        "isaac-lab": f"{_RING}.drones.isaac_lab:FORMAT",
        "l2f": f"{_RING}.drones.l2f:FORMAT",
        "px4": f"{_RING}.drones.px4:FORMAT",
        "ardupilot": f"{_RING}.drones.ardupilot:FORMAT",
        "betaflight": f"{_RING}.drones.betaflight:FORMAT",
    },
)
"""Each a `deployment.drone_format.DroneFormat`: a drone as another program reads it."""
ENGINES = Registry(
    "engine",
    "maidenflight.engines",
    {
        "local": "maidenflight.studies.local:Local",
        "ray": f"{_RING}.clusters.on_ray:OnRay",
        "slurm": f"{_RING}.clusters.slurm:Slurm",
    },
)
"""Each makes a `studies.engine.Engine` of `Resources` and the text behind `NAME:`."""
LOGGERS = Registry(
    "logger",
    "maidenflight.loggers",
    {
        "tensorboard": f"{_RING}.monitoring.tensorboard:tensorboard",
        "wandb": f"{_RING}.monitoring.wandb:wandb",
    },
)
"""Each a `training.loggers.Logger`."""
PLOTS = Registry(
    "plot",
    "maidenflight.plots",
    {
        name: f"maidenflight.reporting.figures.plots:plot_{name}"
        for name in ("flight", "identification", "policy", "posterior")
    },
)
"""Pictures of what stages return, for notebooks."""
