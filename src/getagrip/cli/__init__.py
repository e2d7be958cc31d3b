"""The command line: the table of commands, ``getagrip --help``, and the entry point with its exit statuses.

Each command has a file with its options and body.
"""

from __future__ import annotations

import os
import re
import sys
from collections.abc import Collection, Iterable, Sequence
from difflib import get_close_matches
from functools import reduce
from inspect import cleandoc
from io import TextIOWrapper
from operator import or_
from shutil import get_terminal_size
from textwrap import wrap
from typing import Annotated, Any, get_args, get_origin

import tyro
from tyro.conf import OmitArgPrefixes, subcommand

from getagrip import __version__
from getagrip.cli.annotate import Annotate
from getagrip.cli.bench import Benches, move_source_first
from getagrip.cli.command import Command, print_error
from getagrip.cli.demo import Demo
from getagrip.cli.doctor import Doctor
from getagrip.cli.draft import Draft
from getagrip.cli.epic_candidates import EpicCandidates
from getagrip.cli.evaluate import Evaluate
from getagrip.cli.export import Export, ReplayResults
from getagrip.cli.label import Label
from getagrip.cli.learn_poses import LearnPoses
from getagrip.cli.new_clip import NewClip
from getagrip.cli.reconstruct import Reconstruct
from getagrip.cli.refine import Refine
from getagrip.cli.report import Report, Status, ViewResults
from getagrip.cli.reproduce.arctic_grasps import ReproduceArctic
from getagrip.cli.reproduce.epic_grasps import ReproduceEpic
from getagrip.cli.segment import Segment
from getagrip.cli.study import Stats, Study
from getagrip.cli.synthesise import Synthesise
from getagrip.errors import GetagripError, escape_unprintable, unknown_choice_error
from getagrip.io import processes
from getagrip.io.options import PATH_REGISTRY, explain_all

# Commands share their work between processes, one for each core. numpy reads this once, when it is loaded.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

PROGRAM_DESCRIPTION = (
    "Reconstruct where an object is in the hand that holds it, in every frame of a video, from hand poses, masks and "
    "the object's mesh. --version prints the version."
)

BENCH_DESCRIPTION = "Compare methods on a dataset, or on a folder of clips: the paper's tables, with intervals."
FIGURE_DESCRIPTION = "Draw figures of results, as the paper has them."
IMPORT_DESCRIPTION = "Import datasets; or hands, masks, depth, cameras or segments into clips."
HELP_INDENT = 27
"""Column of the explanations in ``--help``."""


def command_groups(imports: Any, figures: Any) -> dict[str, tuple[Any, ...]]:
    """Make all commands, by the headings of ``--help``; ``imports`` and ``figures`` are unions of subcommands."""
    return {
        "Start": (
            Annotated[Demo, subcommand("demo")],
            Annotated[Doctor, subcommand("doctor")],
            Annotated[Synthesise, subcommand("synthesise")],
        ),
        "Video": (
            Annotated[Draft, subcommand("draft")],
            Annotated[Label, subcommand("label")],
            Annotated[Annotate, subcommand("annotate")],
            Annotated[NewClip, subcommand("clip new")],
            Annotated[imports, subcommand("import", description=IMPORT_DESCRIPTION)],
        ),
        "Solve": (
            Annotated[Reconstruct, subcommand("reconstruct")],
            Annotated[Refine, subcommand("refine")],
            Annotated[Status, subcommand("status")],
        ),
        "Look": (
            Annotated[ViewResults, subcommand("view")],
            Annotated[Report, subcommand("report")],
            Annotated[figures, subcommand("figure", description=FIGURE_DESCRIPTION)],
        ),
        "Use": (Annotated[Export, subcommand("export")], Annotated[ReplayResults, subcommand("replay")]),
        "Measure": (
            Annotated[Evaluate, subcommand("evaluate")],
            Annotated[Benches, subcommand("bench", description=BENCH_DESCRIPTION)],
            Annotated[ReproduceEpic, subcommand("reproduce epic-grasps")],
            Annotated[ReproduceArctic, subcommand("reproduce arctic-grasps")],
            Annotated[Segment, subcommand("segment")],
            Annotated[Study, subcommand("study")],
            Annotated[Stats, subcommand("stats")],
            Annotated[LearnPoses, subcommand("init learn")],
            Annotated[EpicCandidates, subcommand("epic candidates")],
        ),
    }


def command_union(imports: Any, figures: Any) -> Any:
    """Make the union of all commands."""
    return reduce(or_, (command for group in command_groups(imports, figures).values() for command in group))


def overview() -> str:
    """Write the text of ``getagrip --help``: the commands under their headings."""
    width = get_terminal_size().columns
    lines = ["usage: getagrip COMMAND [-h] ...", "", *wrap(PROGRAM_DESCRIPTION, width)]
    for heading, group in command_groups(Command, Command).items():
        lines += ["", heading]
        for kind, about in map(get_args, group):
            sentence = re.split(r"(?<=\.)\s", cleandoc(about.description or kind.__doc__), maxsplit=1)[0]
            name = f"  {about.name}  ".ljust(HELP_INDENT)
            lines += wrap(" ".join(sentence.split()), width, initial_indent=name, subsequent_indent=" " * HELP_INDENT)
    return "\n".join([*lines, "", "getagrip COMMAND --help lists a command's options."])


def main(args: Sequence[str] | None = None) -> int:
    """Run a command. Returns 0 if all is done, 1 if part of it failed, 2 for wrong arguments."""
    _open_closed_output()
    try:
        status = _run_command(sys.argv[1:] if args is None else args)
        sys.stdout.flush()
        return status
    except BrokenPipeError:  # the reader of the output has ended, as with `| head`
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 141  # as for a process that SIGPIPE ends


def _open_closed_output() -> None:
    """Discard output to a closed stream (``>&-``); else printing fails, or goes to the next file that is opened.

    Letters that an output cannot encode, such as a Windows console's, are written as escapes.
    """
    for name in ("stdout", "stderr"):
        stream = getattr(sys, name)
        if stream is None:
            setattr(sys, name, os.fdopen(os.open(os.devnull, os.O_WRONLY), "w"))
        elif isinstance(stream, TextIOWrapper) and stream.errors == "strict":
            stream.reconfigure(errors="backslashreplace")


def _run_command(args: Sequence[str]) -> int:
    try:
        command = _parse_command(args)
        processes.raise_on_interrupt()
        return command.run_checked()
    except BrokenPipeError:
        raise
    except KeyboardInterrupt:
        print("interrupted; what was finished is kept", file=sys.stderr)
        return processes.INTERRUPT_EXIT_STATUS
    except (GetagripError, OSError) as error:
        return print_error(error, "--debug" in args)


def _parse_command(args: Sequence[str]) -> Command:
    """Parse the arguments of a call. Ends the process after ``--help``, and for arguments that fit no command."""
    imports: Any = Command
    figures: Any = Command
    if args and args[0] == "import":  # its options are declared with the readers, which take longer to load
        from getagrip.cli.datasets import subcommands

        imports = subcommands(*args[1:2])
    elif args and args[0] == "figure":  # likewise
        from getagrip.cli.figure import Figures

        figures = Figures
    if list(args) == ["--version"]:
        print(f"getagrip {__version__}")
        sys.exit(0)
    if not args or args[0] in {"-h", "--help"}:
        print(overview(), file=sys.stdout if args else sys.stderr)
        sys.exit(0 if args else 2)
    known: Any = command_union(imports, figures)
    program, description = "getagrip", PROGRAM_DESCRIPTION
    while parts := _subcommands_by_name(known):  # parsing only the command's own options is several times as quick
        if program == "getagrip bench":
            args = move_source_first(args, parts)
        args = join_command_words(args, parts, f"{program} ".removeprefix("getagrip "))
        if not args or args[0] not in parts:
            break
        known, args, program = parts[args[0]], args[1:], f"{program} {args[0]}"
        description = known.__metadata__[0].description
    if {"-h", "--help"} & {*args}:
        explain_all(known)
    with PATH_REGISTRY:
        command: Command = tyro.cli(known, prog=program, description=description, args=args, config=(OmitArgPrefixes,))
    return command


def _subcommands_by_name(choice: Any) -> dict[str, Any]:
    """Return the commands of a union by name; none for a command without subcommands."""
    union = get_args(choice)[0] if get_origin(choice) is Annotated else choice
    return {one.__metadata__[0].name: one for one in get_args(union) if get_origin(one) is Annotated}


def join_command_words(words: Sequence[str], names: Collection[str], before: str = "") -> list[str]:
    """Join the words that name a command into one; end the process for an unknown command.

    ``names`` are the commands, of one word or two, and ``before`` is the command whose subcommands they are. Commands
    are checked before options, which would otherwise all be reported as unknown.
    """
    if not words or words[0].startswith("-"):
        return list(words)
    for length in (2, 1):
        if (name := " ".join(words[:length])) in names:
            return [name, *words[length:]]
    begun = [name for name in names if name.split()[0] == words[0]]
    asked = bool({"-h", "--help"} & {*words})
    if asked and len(begun) == 1:
        return [begun[0], "--help"]
    alike = [before + name for name in begun or _similar_names(words[0], names)]
    if begun and (asked or len(words) == 1):
        print(f"getagrip: incomplete command {words[0]!r}; choose from {', '.join(alike)}", file=sys.stderr)
    else:
        value = before + (" ".join(words[:2]) if begun else words[0])
        error = unknown_choice_error("command", value, alike or names)
        print(f"getagrip: {escape_unprintable(str(error))}", file=sys.stderr)
    sys.exit(2)


def _similar_names(word: str, names: Iterable[str]) -> list[str]:
    """Return the names that begin with a word or, without any, the most similar one."""
    spelt = {spelling: name for name in names for spelling in (name, name.split()[0])}
    alike = [name for name in spelt if name.startswith(word)] or get_close_matches(word, spelt, n=1)
    return [*dict.fromkeys(spelt[name] for name in alike)]
