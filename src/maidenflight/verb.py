"""`Verb`, a stage of the pipeline: its settings declared once, and `run`, which does it.

The command line, studies, the demo and Python call the same object. A verb is one class in one
file, and a line in `registry.VERBS`: its name and `MODULE:CLASS`. `settings.setting` declares a
field with its help and check; the class's docstring is the command's help.
"""

import dataclasses
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, ClassVar, dataclass_transform

from maidenflight import manifest, results
from maidenflight.errors import InputError
from maidenflight.inputs import StrPath
from maidenflight.registry import VERBS, import_part
from maidenflight.settings import PENDING, Setting, plain
from maidenflight.terminal import Progress, Table

Row = dict[str, Any]
"""A row of a study's table: numbers and texts by column."""


SILENT = Progress()


@dataclass(frozen=True)
class Result:
    """What a verb computed and wrote."""

    content: Mapping[str, Any] = field(default_factory=dict)
    """Plain values, for `--json`."""
    summary: Sequence[Table | str] = ()
    """Tables and lines, for people."""
    written: manifest.Files = field(default_factory=dict)
    """The files, by kind, for the manifest of the run folder."""
    read: manifest.Files = field(default_factory=dict)
    """The files that they were made from, likewise."""
    record: Mapping[str, Any] = field(default_factory=dict)
    """How they were made; see `results.record`."""
    rows: Sequence[Row] = ()
    """Of a study's table."""
    notes: Sequence[str] = ()
    """What the user should know of it."""
    next: Sequence[object] = ()
    """The words of the command that comes next."""
    next_remark: str = ""
    """What they should know of that command."""
    value: Any = None
    """What Python works on with, such as policies."""
    error: str = ""
    """Why a part of it failed, for the last line of a command that then exits with 2."""
    exit_code: int = 0


@dataclass(frozen=True)
class Output:
    """Where a verb writes."""

    default: str | None
    """Path by default; `None`: nothing is written, or the verb chooses."""
    help: str
    """Nothing where the choice is not shown."""


@dataclass_transform(kw_only_default=True, frozen_default=True)
class Verb:
    """A stage of the pipeline; its fields are settings, declared by `setting`.

    A verb of your own, such as `MODULE:NAME` in a study, is a subclass with `compute`.
    """

    output: ClassVar[Output] = Output("output", "Folder for the results.")
    name: ClassVar[str]
    """Of its command; the class's own in lower case by default."""
    fused: ClassVar[bool] = False
    """Whether its programs are compiled by `compiler.FUSED`: those that train or identify are."""
    parallel: ClassVar[bool] = False
    """Whether JAX lays its drones over all cores."""
    steady: ClassVar[bool] = True
    """Whether a part of the work tells how long the rest takes."""
    resumable_from: ClassVar[str | None] = None
    """The file in its output, "." for the output itself, by which `--resume` goes on."""
    replaces: ClassVar[bool] = True
    """Whether `--overwrite` means anything: some only add to what is there."""
    in_studies: ClassVar[bool] = True
    """Whether it may be a task of a study."""
    version: ClassVar[str] = ""
    """Of a verb of your own; a study computes results of another version again."""
    counted: ClassVar[str] = ""
    """The setting that says how many policies it trains, for a study's pace."""

    def __init_subclass__(cls, **keywords: Any) -> None:
        super().__init_subclass__(**keywords)
        dataclass(frozen=True, kw_only=True)(cls)
        cls.name = cls.__dict__.get("name", cls.__name__.lower())

    def __post_init__(self) -> None:
        for name, (attribute, setting) in self.settings().items():
            value = setting.check(getattr(self, attribute), name)
            object.__setattr__(self, attribute, value)

    @classmethod
    def settings(cls) -> dict[str, tuple[str, Setting]]:
        """Returns the settings by the names that users write, each with its field's name."""
        settings: dict[str, tuple[str, Setting]] = {}
        group = "Options"
        for member in dataclasses.fields(cls):  # type: ignore[arg-type]
            declared: Setting = member.metadata["setting"]
            group = declared.group or group
            settings[declared.name or member.name] = (member.name, replace(declared, group=group))
        return settings

    @classmethod
    def from_settings(cls, settings: Mapping[str, Any]) -> "Verb":
        """Makes the verb from settings by the names that users write.

        Raises:
            InputError: a setting is unknown, missing or out of its range.
        """
        known_settings = cls.settings()
        for name in settings:
            if name not in known_settings:
                expected = ", ".join(known_settings)
                raise InputError(f"{name} is no setting of {cls.name}. Expected {expected}.")
        return cls(**{known_settings[name][0]: value for name, value in settings.items()})

    @property
    def key(self) -> Any:
        """Returns JAX's random key of the seed."""
        import jax

        return jax.random.key(getattr(self, "seed"))  # noqa: B009

    def get(self, attribute: str) -> Any:
        """Returns a setting's value; None where another task of a study has yet to make it."""
        value = getattr(self, attribute)
        return None if value is PENDING else value

    def check(self) -> None:
        """Refuses settings that do not go together or name what is not there.

        Raises:
            InputError: as above.
        """

    def check_early(self) -> None:
        """Refuses what can be refused before anything heavy is imported.

        Raises:
            InputError: as of `check`, before which it is called.
        """

    def choose_output(self, output: StrPath | None) -> Any:
        """Returns where to write: a path, or an address such as s3://BUCKET; None: nowhere."""
        path = self.output.default if output is None else output
        return path if path is None or "://" in str(path) else Path(path)

    def places(self, output: Path) -> list[Path]:
        """Returns the files and folders that are written, the output first."""
        return [output]

    def discard(self, output: Any) -> None:
        """Removes results of an earlier run that would not be computed again."""

    def may_replace(self, path: Path) -> bool:
        """Returns whether what is there may be replaced unasked."""
        return False

    def compute(self, output: Any, progress: Progress) -> Result:
        """Does the stage and writes its files.

        Args:
            output: what `choose_output` returned.
            progress: called with its progress.
        """
        raise NotImplementedError

    def discard_state(self, output: Path) -> None:
        """Removes what only `--resume` needs: a study resumes by tasks."""

    def run(self, output: StrPath | None = None, progress: Progress = SILENT) -> Result:
        """Does the stage: checks the settings, computes, and writes the files.

        Args:
            output: where to write; the verb's own default by default.
            progress: called with its progress.

        Raises:
            InputError: the settings do not go together, or an input is wrong.
            WriteError: a file cannot be written.
        """
        # Each run has a copy, in which a verb may keep what it has read.
        verb = object.__new__(type(self))
        vars(verb).update((name, getattr(self, name)) for name, _ in self.settings().values())
        verb.check_early()
        verb.check()
        destination = verb.choose_output(output)
        result = verb.compute(destination, progress)
        if result.written:
            manifest.append(destination, verb.name, result.written, result.record, result.read)
        return result

    def make_record(self, inputs: Sequence[StrPath] = (), **more: Any) -> dict[str, Any]:
        """Returns how a result is made, for its files; see `results.record`.

        Settings are the fields, without folders, and without those that take no part in the result.

        Args:
            inputs: files that are read.
            more: further settings, or others in place of the fields' own.
        """
        settings: dict[str, Any] = {}
        for name, (attribute, setting) in self.settings().items():
            if setting.recorded and name != "seed":
                value = getattr(self, attribute)
                settings[name] = _without_folders(value) if setting.files else plain(value)
        values = {name: value for name, value in (settings | more).items() if value not in ([], {})}
        return results.record(seed=getattr(self, "seed", None), inputs=inputs, settings=values)


def _without_folders(value: Any) -> Any:
    """Returns names of files; results are the same wherever these are."""
    if isinstance(value, list | tuple):
        return [_without_folders(entry) for entry in value]
    return None if value is None else Path(value).name


def find_verb(name: str) -> type[Verb]:
    """Returns the verb of a name, one of `registry.VERBS` or `MODULE:NAME`.

    Raises:
        InputError: there is no such verb.
    """
    if ":" not in name:
        return VERBS[name]
    verb = import_part(name, "Verb")
    if not (isinstance(verb, type) and issubclass(verb, Verb)):
        raise InputError(f"{name}: is a {type(verb).__name__}; expected a maidenflight.verb.Verb.")
    return verb
