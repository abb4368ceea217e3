"""Click's commands, derived from the fields of verbs."""

import gc
import json
import shlex
import sys
from collections.abc import Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from types import MappingProxyType
from typing import Any

import click
from click.core import ParameterSource
from click.shell_completion import CompletionItem

from maidenflight import cache, compiler, events, results, terminal
from maidenflight.cli.interruption import resumable
from maidenflight.cli.project import FILE, read_project, settings_for
from maidenflight.errors import InputError
from maidenflight.inputs import StrPath
from maidenflight.registry import VERBS
from maidenflight.settings import REQUIRED, Setting, similar
from maidenflight.verb import Result, Verb, find_verb

_KEYWORDS = ("from", "for")
_PLAIN = "Output"
"""Heading of the options that every verb has."""


class _Values(click.ParamType):
    """The values of a setting as Click reads them."""

    name = "value"

    def __init__(self, setting: Setting) -> None:
        self.values = setting.values

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        """Reads one word of the command line."""
        with suppress(ValueError, TypeError, OverflowError):
            read = self.values.parse(value)
            if self.values.accepts([read] if self.values.repeats else read):
                return read
        hint = similar(str(value), self.values.choices)
        self.fail(f"{value!r}; {hint}expected {self.values.expected}.", param, ctx)

    def shell_complete(
        self, ctx: click.Context, param: click.Parameter, incomplete: str
    ) -> list[CompletionItem]:
        """Completes names in a shell, and paths where there are none."""
        words = [word for word in self.values.choices if word.startswith(incomplete)]
        if words:
            return [CompletionItem(word) for word in words]
        return [CompletionItem(incomplete, type="file")]


class VerbCommand(click.Command):
    """A verb as a command: its options by group, those that are rare only by `--help-all`."""

    def __init__(self, verb: type[Verb], project: Mapping[str, Any] = MappingProxyType({})) -> None:
        self.verb, self.declared = verb, {k: v for k, (_, v) in verb.settings().items()}
        rare = any(setting.rare for setting in self.declared.values())
        self.project = settings_for(verb, project)
        own = [
            _parameter(name, setting, name in self.project)
            for name, setting in self.declared.items()
        ]
        params = [*own, *_common_options(verb, rare)]
        super().__init__(verb.name, params=params, callback=self._run, help=verb.__doc__)
        self.allow_extra_args = True

    def parse_args(self, ctx: click.Context, args: list[str]) -> list[str]:
        """Reads the words; a pattern that the shell made many logs of has its cure."""
        super().parse_args(ctx, args)
        if ctx.args:
            words = " ".join(ctx.args[:2]) + (" ..." if len(ctx.args) > 2 else "")
            message = f"Got unexpected extra arguments ({words})."
            if "logs" in self.declared:
                message += " LOGS is one log or a folder: put several into a folder."
            ctx.fail(message)
        return ctx.args

    def format_options(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """Writes the options of each group below its heading."""
        every = ctx.meta.get("every_option", False)
        groups: dict[str, list[tuple[str, str]]] = {}
        hidden = False
        for parameter in self.get_params(ctx):
            setting = self.declared.get((parameter.name or "").rstrip("_"))
            if setting is not None and setting.rare and not every:
                hidden = True
            elif not isinstance(parameter, click.Argument) and (
                row := parameter.get_help_record(ctx)
            ):
                groups.setdefault(setting.group if setting else _PLAIN, []).append(row)
        common = groups.pop(_PLAIN, [])
        for title, rows in {**groups, _PLAIN: common}.items():
            with formatter.section(title):
                formatter.write_dl(rows, col_max=26)
        if hidden:
            formatter.write_paragraph()
            formatter.write_text(f"More options: {ctx.command_path} --help-all")

    def _run(
        self, output: str | None, as_json: bool, overwrite: bool = False, **words: Any
    ) -> None:
        context = click.get_current_context()
        options = {
            name.rstrip("_"): value
            for name, value in words.items()
            if context.get_parameter_source(name) is not ParameterSource.DEFAULT
        }
        options = {name: value for name, value in options.items() if value not in ((), None)}
        known = {name: value for name, value in self.project.items() if name not in options}
        if known:
            click.echo(f"{FILE}: {', '.join(known)}", err=True)
        run_verb(self.verb.from_settings({**known, **options}), output, as_json, overwrite)


def _parameter(name: str, setting: Setting, known: bool = False) -> click.Parameter:
    """Returns a setting as an argument or an option; not required where the folder has it."""
    values = setting.values
    variable = f"{name}_" if name in _KEYWORDS else name
    required = setting.default is REQUIRED and not known
    if setting.argument:
        many = -1 if values.repeats else 1
        metavar = f"{name.upper()}..." if values.repeats else name.upper()
        return click.Argument(
            [variable], type=_Values(setting), nargs=many, required=required, metavar=metavar
        )
    option = f"--{name.replace('_', '-')}"
    if isinstance(setting.default, bool):
        return click.Option([variable, option], is_flag=True, help=setting.help)
    words = setting.default_text
    return click.Option(
        [variable, option],
        type=_Values(setting),
        required=required,
        multiple=values.repeats,
        metavar=values.metavar,
        help=f"{setting.help} [default: {words}]" if words else setting.help,
    )


def _common_options(verb: type[Verb], rare: bool) -> list[click.Parameter]:
    def show_every_option(context: click.Context, _: click.Parameter, requested: bool) -> None:
        if requested:
            context.meta["every_option"] = True
            click.echo(context.get_help(), color=context.color)
            context.exit()

    default_text = f" [default: {verb.output.default}]" if verb.output.default else ""
    help = f"{verb.output.help}{default_text}"
    options: list[click.Parameter] = [
        click.Option(
            ["-o", "--output"], type=click.Path(), metavar="PATH", help=help, hidden=not help
        )
    ]
    help = "Print one JSON object, and nothing else, on standard output."
    options.append(click.Option(["as_json", "--json"], is_flag=True, help=help))
    if verb.replaces:
        help = "Replace results of an earlier run."
        options.append(click.Option(["--overwrite"], is_flag=True, help=help))
    if rare:
        shown: Any = {"is_flag": True, "is_eager": True, "expose_value": False}
        help = "Show all options and exit."
        options.append(click.Option(["--help-all"], **shown, callback=show_every_option, help=help))
    return options


class Commands(click.Group):
    """All verbs, each imported at its first use."""

    def list_commands(self, ctx: click.Context) -> list[str]:
        """Returns the names of the verbs in the order of the flow."""
        return list(VERBS.own)

    def resolve_command(
        self, ctx: click.Context, args: list[str]
    ) -> tuple[str | None, click.Command | None, list[str]]:
        """Finds the command of a name; of one that is none, the error says what may be meant."""
        if args and args[0] not in VERBS and not args[0].startswith("-"):
            hint = similar(args[0], VERBS.own).capitalize()
            ctx.fail(f"No such command {args[0]!r}. {hint}".rstrip())
        return super().resolve_command(ctx, args)

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        """Returns a verb's command."""
        if ctx.obj is None:
            ctx.obj = read_project()
        return VerbCommand(find_verb(cmd_name), ctx.obj) if cmd_name in VERBS else None


def run_verb(verb: Verb, output: str | None, as_json: bool, overwrite: bool) -> None:
    """Runs a verb as a command: claims its places, shows how far it is, prints the result.

    Raises:
        InputError: a place is taken, or see `Verb.run`.
    """
    verb.check_early()
    destination, resume = verb.choose_output(output), getattr(verb, "resume", None)
    for each in [] if destination is None else verb.places(destination):
        claim(each, overwrite or verb.may_replace(each), resume)
    if overwrite:
        verb.discard(destination)
    state = None
    if destination is not None and verb.resumable_from is not None:
        state = Path(destination, verb.resumable_from)
    with (
        terminal.Bar(verb.name, remaining=verb.steady) as bar,
        resumable(state, "" if resume is None else "--resume"),
    ):
        _set_up_jax(verb)
        result = verb.run(destination, bar)
    for note in result.notes:
        bar.note(note)
    _print(result, as_json)
    if result.error:
        sys.stdout.flush()
        raise InputError(result.error)
    if result.exit_code:
        sys.exit(result.exit_code)


def _set_up_jax(verb: Verb) -> None:
    """Sets how JAX compiles and runs, before anything imports it."""
    compiler.set_flags(compiler.FUSED if verb.fused else compiler.QUICK)
    cache.keep_compiled()
    # JAX traces a program in some hundred thousand objects, and to look for cycles among them as
    # often as Python does by itself takes a fifth of the time.
    gc.set_threshold(100_000)
    if verb.parallel:
        compiler.as_devices()


def claim(path: Path, overwrite: bool, resume: bool | None) -> None:
    """Refuses a path where something is or another process writes, and locks it for this one.

    Args:
        path: where the command is to write.
        overwrite: whether it may replace what is there.
        resume: whether it is to go on with what is there; None for a verb that cannot.

    Raises:
        InputError: something is there, or another process writes there.
    """
    click.get_current_context().call_on_close(results.claim(path))
    # What a killed run leaves of a file that it was writing is nothing to keep.
    leftovers = set(results.leftovers(path))
    occupied = set(path.iterdir()) > leftovers if path.is_dir() else path.exists()
    if occupied and not (overwrite or resume):
        ways = ["Choose another place with -o", "or allow it with --overwrite"]
        if resume is not None:
            ways.insert(1, "go on with what was interrupted there by --resume")
        raise InputError(f"{path}: already there. {', '.join(ways)}.")


def _print(result: Result, as_json: bool) -> None:
    """Prints the result as JSON, or as text with the command that comes next."""
    if as_json:
        print(json.dumps(result.content))
        return
    summary = [entry if isinstance(entry, str) else _as_event(entry) for entry in result.summary]
    if events.tell(summary=summary, next=[*map(str, result.next)]):
        return
    terminal.show(*result.summary)
    if result.written:
        names = map(_name, filter(None, result.written.values()))
        terminal.show(f"written: {', '.join(names)}")
    if result.next and not result.error:
        command = shlex.join(["maidenflight", *map(str, result.next)])
        print(f"next: {command}{f'  ({result.next_remark})' if result.next_remark else ''}")


def _as_event(table: terminal.Table) -> dict[str, Any]:
    return {"title": table.title, "columns": list(table.columns), "rows": table.cells}


def _name(files: Sequence[StrPath]) -> str:
    """Names files of a kind, of many the first and the last."""
    paths = [str(path) for path in files]
    if len(paths) > 2:
        paths = [f"{paths[0]} .. {Path(paths[-1]).name} ({len(paths)} files)"]
    return ", ".join(paths)
